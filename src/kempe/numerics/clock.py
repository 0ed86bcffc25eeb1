"""Time limits of calls: for loops in Python, and for kernels."""

from __future__ import annotations

import contextlib
import functools
import math
import threading
import time
from collections.abc import Callable, Generator
from functools import cache
from typing import Any, TypeVar

from kempe.arguments import compute_deadline
from kempe.budget import Budget, TimeUp, Usual, check_for_stop, list_checks, watched_by
from kempe.errors import TimeLimitError
from kempe.model.kernel_functions import KernelFunction

Function = TypeVar("Function", bound=Callable[..., Any])

SHORT = 30.0
"""Seconds that a single call may take which usually takes less than a second."""
TIME_LIMIT = 120.0
"""Seconds that a call may take whose work nobody can tell beforehand, unless the caller says
otherwise."""
LONG = 600.0
"""The same where samples or targets say how much work there is."""
LEAST = 1e-3
"""Seconds that are left, at least."""
SHARE = 0.8
"""Part of the time after which what was found is put in order: that takes the rest."""


class TimeLimit(watched_by):
    """Time limit of one call [s], None for no limit. Errors: `InputError`.

    As a block: what is done in it ends with `TimeUp` at the next `check_for_stop`, on whichever
    layer that is. It comes once in each thread, so that what was done can be put in order by
    whoever catches
    it; `spent` says that it came.
    """

    def __init__(self, limit: Any):
        self.limit = limit
        self.end = compute_deadline(limit)
        self._told: set[int] = set()
        self.soon = self.end - (1.0 - SHARE) * (limit or 0.0)
        super().__init__(*(() if limit is None else (self._raise_time_up,)))

    @property
    def spent(self) -> bool:
        """Whether `TimeUp` was raised."""
        return bool(self._told)

    def _raise_time_up(self) -> None:
        """Raise `TimeUp` if the time is up, once in each thread."""
        thread = threading.get_ident()
        if thread not in self._told and time.monotonic() >= self.soon:
            self._told.add(thread)
            raise TimeUp

    @property
    def remaining_seconds(self) -> float | None:
        """Remaining time [s], at least `LEAST`; None without a limit."""
        return None if self.limit is None else max(self.end - time.monotonic(), LEAST)

    def check_time(self) -> None:
        """Raise `TimeUp` if the time of the call is up, or that of the verb that called it."""
        check_for_stop()
        if self.limit is not None and time.monotonic() >= self.soon:
            self._told.add(threading.get_ident())
            raise TimeUp

    def release_reserved_time(self) -> None:
        """Allow the call to use the time that was reserved for putting its result in order."""
        self.soon = self.end

    def describe_end_reason(self, error: BaseException) -> str:
        """Describe what ended the computation: the interrupt, or the time limit."""
        if not isinstance(error, TimeUp):
            return "the interrupt"
        return "the time limit" if self.limit is None else f"the time limit of {self.limit:g} s"


ENDLESS = TimeLimit(None)
"""No time limit."""


def limit_time(
    usual: Usual, otherwise: Callable[..., Any] | None = None
) -> Callable[[Function], Function]:
    """Make a decorator that applies the time limit of a verb to all that it calls.

    Verbs say themselves what was done by then. Where the time is up before anything is, `otherwise`
    answers, from the `TimeLimit` and the arguments of the verb; without it `TimeLimitError` is
    raised. A verb that another one asks, without a time limit of its own, has the time of that one.
    """

    def decorate_verb(verb: Function) -> Function:
        @functools.wraps(verb)
        def call_verb(*args: Any, **options: Any) -> Any:
            budget = options.get("budget")
            outer = getattr(_running, "call", None)
            limit = usual.complete_budget(budget).time_limit
            if list_checks() and (budget is None or budget.time_limit is None):
                limit = None
            time = TimeLimit(limit)
            _running.call = usual, time
            try:
                with time:
                    return verb(*args, **options)
            except TimeUp:
                if not time.spent:
                    raise  # that of a verb which called this one
            finally:
                _running.call = outer
            if otherwise is None:
                raise TimeLimitError(usual.verb, time.limit)
            return otherwise(time, *args, **options)

        return call_verb  # type: ignore[return-value]

    return decorate_verb


@contextlib.contextmanager
def limit_preparation_time(usual: Usual, time: TimeLimit) -> Generator[None]:
    """Limit the time of a block in which a verb prepares its work.

    Errors: `TimeLimitError` where the time is up in it.

    For verbs that keep what was done by then once the work has begun: before that there is nothing
    to keep.
    """
    try:
        with time:
            yield
    except TimeUp:
        if not time.spent:
            raise  # that of a verb which called this one
        raise TimeLimitError(usual.verb, time.limit) from None


_running = threading.local()


def find_time_limit(usual: Usual, budget: Budget | None = None) -> TimeLimit:
    """Find the time limit of the running verb; without one, make that of the budget."""
    verb, time = getattr(_running, "call", None) or (None, ENDLESS)
    return time if verb is usual else TimeLimit(usual.complete_budget(budget).time_limit)


class EndReached(TimeUp):
    """A kernel came to the end that its caller set by `make_end_check`.

    The kernel says itself what it ended.
    """


def make_end_check(end: float) -> Callable[[], None]:
    """Make a check for `watched_by` that raises `EndReached` from the time `end` on.

    `end` is a value of `time.monotonic`.
    """

    def check_end() -> None:
        if end < math.inf and time.monotonic() >= end:
            raise EndReached

    return check_end


BROKEN_OFF = (KeyboardInterrupt, TimeUp)
"""What ends long work early; what was done by then is the answer."""


def describe_early_end(interrupted: bool, late: bool) -> str:
    """Describe why a computation ended early, as the end of a sentence; '' if it did not."""
    why = "interrupted" if interrupted else "stopped by the time limit"
    return f" ({why}: this is the part that was done)" if interrupted or late else ""


class Clock:
    """Clock that kernels look at: it writes 1 where the work must end.

    What it raises is kept for the thread until `take_error` takes it after the kernel.
    """

    def __init__(self):
        def write_flag(_q: Any, out: Any, _columns: Any, _flag: int) -> None:
            out[0] = 1.0  # what stays where it raises, and until the error is taken
            if getattr(self._thread, "error", None) is None:
                check_for_stop()
                out[0] = 0.0

        self._thread = threading.local()
        self._called = KernelFunction(write_flag, self._keep_error)

    @property
    def address(self) -> int:
        """Address at which kernels call the clock."""
        return self._called.address

    def _keep_error(self, error: BaseException) -> None:
        """Keep the error of this thread until `take_error` takes it."""
        self._thread.error = error

    def take_error(self) -> TimeUp | None:
        """Return and forget the `TimeUp` that a kernel met; raise other errors."""
        error = getattr(self._thread, "error", None)
        self._thread.error = None
        if error is None or isinstance(error, TimeUp):
            return error
        raise error


@cache
def get_clock() -> Clock:
    """Return the clock that all kernels share."""
    return Clock()
