"""What a call may spend, and how exact it must be: one object each, for all verbs."""

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
    """How large errors may be: `linear` in metres and `angular` in radians. A plain pair of numbers
    says the same.
    """

    linear: float
    angular: float


@explain_init_errors
@dataclass(frozen=True)
class Budget:
    """How much work a call may do, how finely, and how: what is left out is as the verb does it by
    itself.

    A verb refuses what it does not read, and says what it reads.
    """

    starts: int | None = None
    """Starts of a search, at most."""
    iterations: int | None = None
    """Steps of one start, at most."""
    time_limit: float | None = None
    """Seconds for the whole call, after which it answers with what it has; `math.inf`: as long as
    it takes."""
    points: int | None = None
    """Points of a path or samples of a motion."""
    step: float | None = None
    """The longest step along a path, in radians and characteristic lengths."""
    rng: int | np.random.Generator | None = None
    """What random starts are drawn from: the same number draws the same ones."""
    threads: int | None = None
    """Threads of a batch; left out: as many as there are cores."""
    progress: Callable[..., Any] | None = None
    """Called now and then with how much is done."""


class TimeUp(Exception):
    """The time of a call is up: raised inside the call, and caught there."""


_thread = threading.local()


def list_checks() -> tuple[Callable[[], None], ...]:
    """What `check_for_stop` of this thread calls now."""
    return getattr(_thread, "checks", ())


class watched_by:
    """A block in which `check_for_stop` of this thread calls further functions; they raise where
    the work must end.
    """

    def __init__(self, *more: Callable[[], None]):
        self.more = more

    def __enter__(self) -> None:
        _thread.checks = (*self.more, *list_checks())

    def __exit__(self, *_: object) -> None:
        _thread.checks = list_checks()[len(self.more) :]


def check_for_stop() -> None:
    """Look whether the work of this thread must end: where the time of a call is up, `TimeUp` is
    raised.

    What may take long calls it between two pieces of about 0.1 s, on whichever layer it is: it
    knows no verb and no limit. Verbs set these by `TimeLimit` as a block; the innermost block is
    asked first.
    """
    for check in getattr(_thread, "checks", ()):
        check()


class Usual:
    """What a verb spends where nobody says otherwise; its keywords are the fields of a `Budget`
    that it reads.
    """

    def __init__(self, verb: str, **reads: Any):
        self.verb = verb
        self.reads = reads
        self.budget = _make_budget(reads)

    def complete_budget(self, budget: object) -> Budget:
        """The budget, completed; `time_limit` is None where there is none. Errors: `InputError`."""
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
