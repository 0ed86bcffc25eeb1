"""What is computed beside a page, which goes on meanwhile: searches, and what is laid over a
system.
"""

from __future__ import annotations

import threading
import traceback
from collections.abc import Callable, Iterator
from typing import Any

from kempe.errors import KempeError

DEFECTS = (
    ArithmeticError,
    AssertionError,
    AttributeError,
    LookupError,
    MemoryError,
    OSError,
    RuntimeError,
    TypeError,
    ValueError,
)
"""What a mistake in the code raises, or a machine that has no more room."""
Action = Callable[[], Any]
"""What the page does with what was found."""


class Job:
    """A computation in rounds, each of which gives an action for the page; `dropped` once nobody
    waits for it.
    """

    def __init__(self, key: str, work: Callable[[Callable[..., None]], Iterator[Action]]):
        self.key = key
        self.dropped = False
        self.rounds = work(self.check)

    def check(self, *done: object) -> None:
        """Raise `KeyboardInterrupt` if nobody waits: verbs whose progress this is then end with
        what they have.
        """
        if self.dropped:
            raise KeyboardInterrupt


class Beside:
    """A thread that does jobs round by round, in turn, those begun last first; actions are given to
    `post`.

    `post(key, action)` is called for each round, with a key of its own, and `failed(sentence)` is
    the action where a round raised a `KempeError`, or anything else, whose traceback is then
    printed.
    """

    def __init__(self, post: Callable[[str, Action], None], failed: Callable[[str], Any]):
        self.post = post
        self.failed = failed
        self.jobs = list[Job]()
        self.ready = threading.Condition()
        self.open = True
        threading.Thread(target=self._work, daemon=True).start()

    def start(self, key: str, work: Callable[[Callable[..., None]], Iterator[Action]]) -> None:
        """Begin a job in place of the one with the same key."""
        with self.ready:
            self.drop(key)
            self.jobs.insert(0, Job(key, work))
            self.ready.notify()

    def drop(self, key: str | None = None) -> None:
        """End the job of a key, or all."""
        with self.ready:
            for job in tuple(self.jobs):
                if key in (None, job.key):
                    job.dropped = True
                    self.jobs.remove(job)

    def close(self) -> None:
        """End the thread."""
        with self.ready:
            self.open = False
            self.drop()
            self.ready.notify()

    def _work(self) -> None:
        count = 0
        while True:
            with self.ready:
                while self.open and not self.jobs:
                    self.ready.wait()
                if not self.open:
                    return
                job = self.jobs[0]
            try:
                action = next(job.rounds, None)
            except KempeError as error:
                action = self._refused(job, str(error))
            except KeyboardInterrupt:
                action = None
            except DEFECTS as error:  # the page goes on, and the terminal has where it was
                traceback.print_exc()
                action = self._refused(
                    job, f"not done, by a defect of Kempe: {type(error).__name__}: {error}"
                )
            count += 1
            if action is not None:
                self.post(f"{job.key} {count}", self._if_wanted(job, action))
            with self.ready:
                if job in self.jobs:
                    self.jobs.remove(job)
                    if action is not None and not job.dropped:
                        self.jobs.append(job)

    def _refused(self, job: Job, text: str) -> Action:
        job.rounds = iter(())
        return lambda: self.failed(text)

    @staticmethod
    def _if_wanted(job: Job, action: Action) -> Action:
        return lambda: None if job.dropped else action()
