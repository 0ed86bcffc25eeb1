"""A clock that kernels can look at: whether the time of a search is up."""

from __future__ import annotations

import ctypes
import math
import time
from typing import Any

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
