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
    "the summary of a model, whose claim the tests of the library hold": {
        "docs/gallery.md": (
            "The lecture's ball that cannot penetrate the ground",
            "The lecture's car in the plane: 3 DoF, though it cannot move sideways",
            "Two-link planar arm and a point p that it cannot reach",
        ),
    },
    "title of a paper": {
        "docs/structure.md": ("Iteration methods for finding all zeros of a polynomial simultaneously.",),
    },
}
