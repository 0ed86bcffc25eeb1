"""Interrupts from the keyboard at any line of some modules, as they may come, and the ends of
processes there.
"""

import os
import subprocess
import sys
from pathlib import Path


class Interrupt:
    """Raises KeyboardInterrupt before line number `at` of those that the calling thread runs in
    these modules.

    Or calls `act` there.

    With 0 it raises none, and `lines` counts them. `came` says whether it was raised: how many
    lines the calling thread runs depends on how often it wakes while it waits for others.
    """

    def __init__(self, at, *modules, act=None):
        self.at = at
        self.lines = 0
        self.came = False
        self.files = {x.__file__ for x in modules}
        self._act = act

    def __enter__(self):
        sys.settrace(
            lambda frame, *_: self._line if frame.f_code.co_filename in self.files else None
        )
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
                if self._act is None:
                    raise KeyboardInterrupt
                self._act()
        return self._line


def ended(ending, at, modules, code):
    """Run code in a process that sends itself a signal before line number `at` of those that it
    runs in modules.

    Returns the number of these lines up to its end; None where the signal has ended it at once.
    """
    script = f"""
import os, signal, sys
sys.path.insert(0, {str(Path(__file__).parent)!r})
from interrupts import Interrupt
import {", ".join(x.__name__ for x in modules)}
signal.signal(signal.SIGINT, signal.default_int_handler)
def work():
    {code}
with Interrupt({at}, {", ".join(x.__name__ for x in modules)}, act=lambda: os.kill(os.getpid(), {int(ending)})) as seen:
    work()
print(seen.lines)
"""
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(p for p in sys.path if p)}
    done = subprocess.run(
        [sys.executable, "-c", script], env=environment, capture_output=True, text=True
    )
    assert done.returncode in (0, -ending), done.stderr
    return int(done.stdout) if done.returncode == 0 else None
