"""Budget and tolerance of a call: how much work it may do, and how large errors may be."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import Any, NamedTuple

import numpy as np

from kempe.arguments import explain_init_errors
from kempe.errors import InputError, format_value


class Tolerance(NamedTuple):
    """Largest allowed errors.

    Parameters
    ----------
    linear
        Largest position error in metres.
    angular
        Largest rotation error in radians.

    Notes
    -----
    Verbs take a plain pair of numbers, too, or one number for both.

    Examples
    --------
    >>> import kempe
    >>> robot = kempe.load("puma560")
    >>> target = robot.fk(robot.mid, "tool")
    >>> bool(robot.ik(target, "tool", tolerance=kempe.Tolerance(1e-4, 1e-3)).success)
    True
    """

    linear: float
    angular: float


@explain_init_errors
@dataclass(frozen=True)
class Budget:
    """Limits of the work of a call. None stands for the default of the verb.

    Parameters
    ----------
    starts
        Largest number of starts of a search.
    iterations
        Largest number of steps of one start.
    time_limit
        Seconds for the whole call, after which it answers with what it has; `math.inf` for no
        limit.
    points
        Number of points of a path, or of samples of a motion.
    step
        Longest step along a path, in radians and characteristic lengths.
    rng
        Number or generator from which random starts are drawn: the same number draws the same
        starts.
    threads
        Number of threads of a batch (default: as many as there are cores).
    progress
        Function that is called now and then with how much is done.

    Raises
    ------
    InputError
        By a verb that is given a limit that it does not read; the message names those it reads.

    Examples
    --------
    >>> import kempe
    >>> robot = kempe.load("puma560")
    >>> target = robot.fk(robot.mid, "tool")
    >>> bool(robot.ik(target, "tool", budget=kempe.Budget(starts=20, rng=1)).success)
    True
    """

    starts: int | None = None
    iterations: int | None = None
    time_limit: float | None = None
    points: int | None = None
    step: float | None = None
    rng: int | np.random.Generator | None = None
    threads: int | None = None
    progress: Callable[..., object] | None = None


class TimeUp(Exception):
    """Raised and caught inside a call when its time limit has passed."""


_thread = threading.local()


def list_checks() -> tuple[Callable[[], None], ...]:
    """Return the functions that `check_for_stop` calls in this thread."""
    return getattr(_thread, "checks", ())


class watched_by:
    """Context in which `check_for_stop` of this thread calls further functions. They raise to end
    the work.
    """

    def __init__(self, *more: Callable[[], None]):
        self.more = more

    def __enter__(self) -> None:
        _thread.checks = (*self.more, *list_checks())

    def __exit__(self, *_: object) -> None:
        _thread.checks = list_checks()[len(self.more) :]


def check_for_stop() -> None:
    """Check whether the work of this thread must end; raise `TimeUp` if the time of the call is up.

    What may take long calls it between two pieces of about 0.1 s, on whichever layer it is: it
    knows no verb and no limit. Verbs set these by `TimeLimit` as a block; the innermost block is
    asked first.
    """
    for check in getattr(_thread, "checks", ()):
        check()


class Usual:
    """The default budget of a verb. Its keywords are the fields of `Budget` that the verb reads."""

    def __init__(self, verb: str, **reads: Any):
        self.verb = verb
        self.reads = reads
        self.budget = _make_budget(reads)

    def complete_budget(self, budget: object) -> Budget:
        """Fill in the verb's defaults in a budget; `time_limit` is None for no limit. Errors:
        `InputError`.
        """
        if budget is None:
            return self.budget
        if not isinstance(budget, Budget):
            raise InputError(
                f"budget is {format_value(budget)}; it must be a kempe.Budget, such as "
                f"Budget({self._describe_example()})"
            )
        if budget.progress is not None and not callable(budget.progress):
            raise InputError(
                f"progress is {format_value(budget.progress)}; it must be a function of how much "
                "is done"
            )
        given = {f.name: x for f in fields(Budget) if (x := getattr(budget, f.name)) is not None}
        for name in given:
            if name not in self.reads:
                read = ", ".join(self.reads)
                raise InputError(
                    f"budget has {name}, which {self.verb} does not read; it reads {read}"
                )
        return _make_budget({**self.reads, **given})

    def _describe_example(self) -> str:
        return next(
            (f"{name}={x}" for name, x in self.reads.items() if x is not None),
            f"{next(iter(self.reads))}=1",
        )


def _make_budget(values: dict[str, Any]) -> Budget:
    limit = values.get("time_limit")
    return Budget(**{**values, "time_limit": None if limit == math.inf else limit})
