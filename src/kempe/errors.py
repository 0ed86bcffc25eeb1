"""The errors that Kempe raises: one base class and subclasses with the data of their messages."""

from __future__ import annotations

import inspect
import os
import reprlib
import tokenize
import warnings
from collections.abc import Iterable
from dataclasses import dataclass
from typing import NoReturn

PROBLEM_LIMIT = 20
"""Problems of one file that are collected before giving up."""

UNREADABLE = (
    OSError,
    ValueError,
    RuntimeError,
    LookupError,
    TypeError,
    EOFError,
    ArithmeticError,
    SyntaxError,
    tokenize.TokenError,
)
"""What libraries raise for a file that is not what it should be: numpy reads the header of a .npy
file as Python."""

_SHORT = reprlib.Repr()
_SHORT.maxstring = _SHORT.maxother = _SHORT.maxlong = 100


@dataclass(frozen=True)
class Where:
    """A place in a file: its name, line and column (counted from 1), and the text of the line."""

    file: str
    line: int = 0
    column: int = 0
    text: str = ""

    def __str__(self) -> str:
        return f"{self.file}:{self.line}" if self.line else self.file


@dataclass(frozen=True)
class Fault:
    """One error in a description: its place, its subject, what is wrong, and what is allowed."""

    message: str
    subject: str = ""
    where: Where | None = None
    allowed: str = ""

    def __str__(self) -> str:
        head = f"{self.where}: " if self.where else ""
        subject = f"{self.subject}: " if self.subject else ""
        allowed = f"; {self.allowed}" if self.allowed else ""
        return f"{head}{subject}{self.message}{allowed}"

    def caret(self) -> str:
        """Return the line of the file with a caret under the fault; '' if the place is unknown."""
        if self.where is None or not self.where.text:
            return ""
        text = self.where.text.rstrip("\n").replace("\t", " ")
        column = max(self.where.column, 1)
        start = max(0, column - 60)
        return f"    {text[start : start + 100]}\n    {' ' * (column - 1 - start)}^"


LONGEST = 1000
"""Characters of a line of a message at most: it may echo what was given, of any length."""


def shorten_lines(message: object) -> object:
    """Shorten the long lines of a message by leaving out their middle."""
    if not isinstance(message, str) or len(message) <= LONGEST:
        return message
    head = LONGEST // 2
    tail = LONGEST // 2 - 40
    lines = (
        line
        if len(line) <= LONGEST
        else f"{line[:head]} ... ({len(line)} characters in all) ... {line[-tail:]}"
        for line in message.split("\n")
    )
    return "\n".join(lines)


class KempeError(Exception):
    """Base of all errors that Kempe raises on purpose."""

    def __init__(self, *args: object):
        super().__init__(*map(shorten_lines, args))

    def __str__(self) -> str:
        return self.args[0] if self.args else ""


class RoundedWarning(UserWarning):
    """Warning that rounded numbers were replaced by exact ones, such as a rotation with few digits."""


class DegreesWarning(UserWarning):
    """Warning that an angle, which is in radians, looks like one in degrees."""


class DescriptionError(KempeError, ValueError):
    """Error in the description of a mechanism (file or calls); `problems` lists the faults."""

    def __init__(self, problems: Fault | Iterable[Fault]):
        self.problems = (problems,) if isinstance(problems, Fault) else tuple(problems)
        more = len(self.problems) - PROBLEM_LIMIT
        lines = [str(problem) for problem in self.problems[:PROBLEM_LIMIT]]
        if more > 0:
            lines.append(f"... and {more} more")
        super().__init__("\n".join(lines))

    def __reduce__(self):
        return (type(self), (self.problems,))


class UnknownNameError(KempeError, KeyError):
    """Error of an unknown name, with the fields `name`, `kind` and the `allowed` names."""

    def __init__(self, kind: str, name: object, allowed: Iterable[str], owner: str = ""):
        self.kind = kind
        self.name = name
        self.allowed = tuple(allowed)
        self.owner = owner
        super().__init__(
            f"{owner + ' has ' if owner else ''}no {kind} "
            f"{format_value(name)}{hint(name, self.allowed)}"
        )

    def __reduce__(self):
        return (type(self), (self.kind, self.name, self.allowed, self.owner))


class InputError(KempeError, ValueError):
    """Error of an argument with a wrong shape, a wrong count, or NaN where a number is needed."""


INSTEAD = {
    ("assemble", "constraints"): "they are given as 'also'",
    ("ik_all", "q"): "start=q sorts the solutions by nearness to a configuration q",
    ("ik_all", "prefer"): "start=q sorts the solutions by nearness to a configuration q",
    ("ik_all", "hold"): "joints are held by fixed={'name': value}",
    ("trace", "frames"): "give them to table, save or plot of the path",
}
"""What is said of options that a function does not have, by function and name."""


BUDGET = "budget=kempe.Budget(starts=..., time_limit=...)"
OPTIONS_ELSEWHERE = {
    **dict.fromkeys(("atol", "eps", "tol"), "tolerance"),
    **dict.fromkeys(
        ("guess", "initial_guess", "initial_position", "init", "q0", "seed", "x0"), "start"
    ),
    **dict.fromkeys(("iterations", "max_iter", "max_iterations", "max_iters", "maxiter"), BUDGET),
    **dict.fromkeys(("max_time", "starts", "time_limit", "timeout"), BUDGET),
    **dict.fromkeys(("random_state", "rng"), "budget=kempe.Budget(rng=...)"),
    **dict.fromkeys(("end_effector", "link"), "frame"),
    **dict.fromkeys(("offset", "origin", "place", "pos", "xyz"), "at"),
}
"""Options of other libraries, and what is in their place here."""

MEMBERS_ELSEWHERE = {
    "fkine": "fk",
    "fkine_all": "fk",
    "forward": "fk",
    "forward_kinematics": "fk",
    "getTransform": "fk",
    "ikine": "ik",
    "ikine_LM": "ik",
    "inverseKinematics": "ik",
    "inverse_kinematics": "ik",
    "solve": "ik",
    "ikine_a": "ik_all",
    "jacob0": "jacobian",
    "jacobe": "jacobian",
    "jac": "jacobian",
    **dict.fromkeys(("dof", "gruebler", "grubler"), "mobility"),
    "n": "nq",
    "njoints": "joint_names",
    "links": "body_names",
    "qlim": "lower",
    "qz": "neutral",
    "random_q": "random",
    "randomConfiguration": "random",
    "homeConfiguration": "neutral",
    "close": "assemble",
    "step": "drive",
    "show_linkage": "plot",
    "viewer": "show",
    "tip": "frame_names",
    "velocity": "jacobian",
}
"""Members of other libraries' models, and those of a `System` in their place."""

DECLARATIONS_ELSEWHERE = {
    "add_body": "body",
    "add_link": "body",
    "link": "body",
    "add_joint": "joint",
    "hinge": "revolute",
    "pin": "revolute",
    "slide": "prismatic",
    "slider": "prismatic",
    "ball": "spherical",
}
"""Members of other libraries' descriptions, and those of a `Mechanism` in their place."""

NAMES_ELSEWHERE = {
    **dict.fromkeys(("DHRobot", "SerialLink"), "from_dh"),
    **dict.fromkeys(("ERobot", "Robot", "URDF", "buildModelFromUrdf", "importrobot"), "load"),
    **dict.fromkeys(("load_urdf", "loads", "open", "robot"), "load"),
    **dict.fromkeys(("degrees", "deg2rad", "radians"), "deg"),
    "rpy": "rpy_to_matrix",
}
"""Functions and classes of other libraries, and what a module of this one has in their place."""

MEMBERS_WITHIN = {
    "lock": "mechanism.lock({...}).build()",
    "manipulability": "reach.poses(targets, frame).manipulability",
}
"""What is looked for at a `System`, and where a part of it or an answer has it."""


class MissingMemberError(KempeError, AttributeError):
    """Error of an attribute or method that an object lacks; the text says what is meant."""

    def __init__(self, owner: str, member: str, said: str):
        self.owner = owner
        self.member = member
        self.said = said
        super().__init__(f"a {owner} has no {member!r}{said}")

    def __reduce__(self):
        return (type(self), (self.owner, self.member, self.said))


def raise_missing_member(owner: object, name: str, said: str = "") -> NoReturn:
    """Raise the error of a missing attribute, from `__getattr__`, with a hint or what is `said`.

    The error of a property that failed is raised itself.
    """
    kind = type(owner)
    if hasattr(kind, name):
        object.__getattribute__(owner, name)
    if name.startswith("_"):  # Python and IPython ask for many of these
        raise AttributeError(f"a {kind.__name__} has no {name!r}")
    said = said or hint(name, (n for n in dir(kind) if not n.startswith("_")))
    raise MissingMemberError(kind.__name__, name, said)


def raise_missing_name(module: str, name: str, allowed: Iterable[str]) -> NoReturn:
    """Raise the error of a name that a module lacks, from its `__getattr__`, with a hint."""
    said = ""
    if name[0] != "_":  # Python asks modules for many of these
        meant = NAMES_ELSEWHERE.get(name)
        allowed = list(allowed)
        said = f"; did you mean {meant!r}?" if meant in allowed else hint(name, allowed)
    raise AttributeError(f"module {module!r} has no {name!r}{said}")


class CallError(KempeError, TypeError):
    """Error of a call with an unknown argument, or without a required argument."""

    def __init__(self, function: str, name: str, allowed: Iterable[str] = ()):
        self.function = function
        self.name = name
        self.allowed = tuple(allowed)
        own = INSTEAD.get((function, name))
        meant = OPTIONS_ELSEWHERE.get(name, "")
        if not own and meant.partition("=")[0] in self.allowed:
            own = f"did you mean {meant!r}?" if meant in self.allowed else f"give {meant}"
        said = f"; {own}" if own else hint(name, self.allowed)
        wrong = f" has no option {name!r}{said}" if self.allowed else f": {name}"
        super().__init__(function + wrong)

    def __reduce__(self):
        return (type(self), (self.function, self.name, self.allowed))


class UnsupportedError(KempeError, NotImplementedError):
    """Error of a question that this version cannot answer; the text gives the reason."""


class NoSolutionError(KempeError, RuntimeError):
    """Error that `expect` raises for an answer without success; `solution` is that answer."""

    def __init__(self, solution: object):
        self.solution = solution
        super().__init__(str(solution))

    def __reduce__(self):
        return (type(self), (self.solution,))


class TimeLimitError(KempeError, TimeoutError):
    """Error of a verb whose time limit passed before the first result."""

    def __init__(self, verb: str, limit: float | None):
        self.verb = verb
        self.limit = limit
        super().__init__(
            f"{verb}: the time limit of {limit or 0.0:g} s was over before anything was known; "
            "allow more by kempe.Budget(time_limit=...)"
        )

    def __reduce__(self):
        return (type(self), (self.verb, self.limit))


class Interrupted(KeyboardInterrupt):
    """Interruption of a verb by Ctrl-C; `answer` is the partial answer, or None."""

    def __init__(self, answer: object = None):
        self.answer = answer
        super().__init__()

    def __reduce__(self):
        return (type(self), (self.answer,))

    def __str__(self) -> str:
        return (
            "interrupted"
            if self.answer is None
            else f"interrupted; what was done is in `answer`: {self.answer}"
        )


class MissingPackageError(KempeError, ImportError):
    """Error of a missing package that is no dependency of Kempe; the text says how to install it."""

    def __init__(self, package: str):
        self.package = package
        super().__init__(
            f"this needs the package {package!r}: install it with  pip install {package}"
        )

    def __reduce__(self):
        return (type(self), (self.package,))


class MissingExtraError(KempeError, ImportError):
    """Error of a missing optional dependency; the text says how to install it."""

    def __init__(self, package: str, extra: str):
        self.package = package
        self.extra = extra
        said = f"pip install '{requirement(package, extra)}'"
        super().__init__(
            f"this needs the package {package!r} (extra kempe[{extra}]): install it with  {said}"
        )

    def __reduce__(self):
        return (type(self), (self.package, self.extra))


def requirement(package: str, extra: str) -> str:
    """Return a package name, with the version bounds from an extra of Kempe if there are any."""
    from importlib import metadata

    try:
        needed = metadata.requires("kempe") or ()
    except metadata.PackageNotFoundError:
        needed = ()
    for text in needed:
        needs, _, marker = text.partition(";")
        name, _, versions = needs.strip().partition(">=")
        if name == package and versions and repr(extra) in marker.replace('"', "'"):
            return f"{name}>={versions}"
    return package


def warn(message: str, kind: type[Warning] = RoundedWarning) -> None:
    """Warn at the line that called Kempe; the default category is `RoundedWarning`."""
    level = 1
    frame = inspect.currentframe()
    while (
        frame and frame.f_back and frame.f_globals.get("__name__", "").partition(".")[0] == "kempe"
    ):
        level = level + 1
        frame = frame.f_back
    warnings.warn(message, kind, stacklevel=level)


def format_value(x: object) -> str:
    """Format a value of an argument as short text on one line."""
    try:
        text = " ".join(_SHORT.repr(x).split())
    except ValueError:  # a whole number of thousands of digits
        text = ""
    return text if 0 < len(text) <= 80 else f"{text[:60]}... ({type(x).__name__})"


HINTED = 200
COMPARED = 500
"""Characters of a name, and names, that are compared letter by letter: more take long."""


def _select_similar(given: str, names: Iterable[str]) -> list[str]:
    """Select the names that share the longest beginnings and ends with `given`, at most `COMPARED`."""
    names = list(names)
    if len(names) <= COMPARED:
        return names
    return sorted(
        names,
        key=lambda name: (
            -len(os.path.commonprefix((given, name)))
            - len(os.path.commonprefix((given[::-1], name[::-1])))
        ),
    )[:COMPARED]


def hint(name: object, allowed: Iterable[str]) -> str:
    """Return the end of a message about an unknown name: similar names, or all allowed names."""
    import difflib  # only here: most names are known

    allowed = list(dict.fromkeys(allowed))
    folded = {str(a)[:HINTED].casefold(): a for a in reversed(allowed)}
    given = (name if isinstance(name, str) else format_value(name))[:HINTED].casefold()
    near = difflib.get_close_matches(given, _select_similar(given, folded), n=3, cutoff=0.6)
    if near:
        return f"; did you mean {' or '.join(repr(folded[n]) for n in near)}?"
    if not allowed:
        return "; there are none"
    few = ", ".join(repr(a) for a in allowed[:12])
    return f"; there are: {few}{f', ... ({len(allowed)} in all)' if len(allowed) > 12 else ''}"


class DiskError(KempeError, OSError):
    """Error of a result that could not be written.

    The text says what is on disk, from which the same call continues.
    """


class DamagedError(KempeError, OSError):
    """Error of a file whose content differs from what was written."""


class KernelsError(KempeError, ImportError):
    """Error of missing compiled kernels that cannot be compiled on this machine."""
