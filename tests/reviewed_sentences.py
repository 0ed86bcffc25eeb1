"""General sentences of the pages that no test hunts, read by a person, with the reason why none is needed.

A sentence is known by its beginning. One that is reworded has to be read again: entries that fit no sentence fail.
"""

REVIEWED = {
    "mathematics": {
        "docs/dof.md": (
            "It is right for almost all lengths, and wrong for many",
            "The formula is not wrong about *almost all* linkages of four hinges.",
            "Along $q(t) = q_0 \\oplus (N s(t) + w(t))$ the normal part",
        ),
    },
    "says that it is no proof, or where one cannot be sure": {
        "docs/branches.md": ("The search ends when each mode has been found six times,",),
    },
    "title of a paper": {
        "docs/structure.md": ("Iteration methods for finding all zeros of a polynomial simultaneously.",),
    },
}
