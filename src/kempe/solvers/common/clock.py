"""Whether the time of a call is up: for loops, and a clock that kernels can look at."""

from __future__ import annotations

import ctypes
import math
import time
from typing import Any

from kempe.solvers.common.arguments import deadline

SHORT = 30.0
"""Seconds that a single call may take which usually takes less than a second."""
TIME_LIMIT = 120.0
"""Seconds that a call may take whose work nobody can tell beforehand, unless the caller says otherwise."""
LONG = 600.0
"""The same where samples or targets say how much work there is."""
LEAST = 1e-3
"""Seconds that are left, at least."""
SHARE = 0.8
"""Part of the time after which what was found is put in order: that takes the rest."""


class TimeUp(Exception):
    """The time of a call is up: raised inside the call, and caught there."""


class TimeLimit:
    """The time of one call [s], None for as long as it takes. Errors: `InputError`."""

    def __init__(self, limit: Any):
        self.limit, self.end = limit, deadline(limit)
        self.soon = self.end - (1.0 - SHARE) * (limit or 0.0)

    @property
    def left(self) -> float | None:
        """Seconds that are left, at least some for what ends at once; None where there is no limit."""
        return None if self.limit is None else max(self.end - time.monotonic(), LEAST)

    def check(self) -> None:
        """Raise `TimeUp` if the time of the call is spent."""
        if self.limit is not None and time.monotonic() >= self.soon:
            raise TimeUp

    def put_in_order(self) -> None:
        """Let the rest of the time be used, too."""
        self.soon = self.end

    def reason(self, error: BaseException) -> str:
        """What ended the computation, as text: the interrupt, or the time limit."""
        return f"the time limit of {self.limit:g} s" if isinstance(error, TimeUp) else "the interrupt"


BROKEN_OFF = (KeyboardInterrupt, TimeUp)
"""What ends long work early; what was done by then is the answer."""


def partial(interrupted: bool, late: bool) -> str:
    """End of a sentence about a computation that ended early; '' otherwise."""
    why = "interrupted" if interrupted else "stopped by the time limit"
    return f" ({why}: this is the part that was done)" if interrupted or late else ""


_NUMBER = ctypes.POINTER(ctypes.c_double)
_KIND = ctypes.CFUNCTYPE(None, _NUMBER, _NUMBER, _NUMBER, ctypes.c_int64)


class Clock:
    """A function, as kernels call it, that writes 1 from the time `end` of `time.monotonic` on; at no address if never.

    The object must live as long as it is called.
    """

    def __init__(self, end: float):
        self.address, self._kept = 0, None
        if end < math.inf:

            def work(_q: Any, out: Any, _columns: Any, _flag: int) -> None:
                out[0] = float(time.monotonic() >= end)

            self._kept = _KIND(work)
            self.address = int(ctypes.cast(self._kept, ctypes.c_void_p).value or 0)
