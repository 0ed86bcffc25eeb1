"""Interrupts from the keyboard at any line of some modules, as they may come."""

import sys


class Interrupt:
    """Raises KeyboardInterrupt before line number `at` of those that the calling thread runs in these modules.

    With 0 it raises none, and `lines` counts them. `came` says whether it was raised: how many lines the calling thread
    runs depends on how often it wakes while it waits for others.
    """

    def __init__(self, at, *modules):
        self.at, self.lines, self.came, self.files = at, 0, False, {x.__file__ for x in modules}

    def __enter__(self):
        sys.settrace(lambda frame, *_: self._line if frame.f_code.co_filename in self.files else None)
        return self

    def __exit__(self, kind, *_):
        sys.settrace(None)
        return kind is not None and issubclass(kind, KeyboardInterrupt)

    def _line(self, frame, event, arg):
        if event == "line":
            self.lines += 1
            if self.lines == self.at:
                sys.settrace(None)
                self.came = True
                raise KeyboardInterrupt
        return self._line
