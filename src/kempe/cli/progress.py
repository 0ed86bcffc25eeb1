"""Batches of targets in slices: so that the work shows how far it is, and can be stopped with what
was done.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Generator
from datetime import timedelta
from functools import cached_property
from typing import TYPE_CHECKING, Any, TextIO, cast

import numpy as np

from kempe.answers.answer import Answer
from kempe.equations.judge import Judgement, judge
from kempe.spatial import Array
from kempe.words import counted, of_many, verb

if TYPE_CHECKING:
    from kempe.inverse.answer import Solution
    from kempe.system import System

FIELDS = (
    "q",
    "success",
    "code",
    "position_error",
    "orientation_error",
    "residual",
    "iterations",
    "starts",
)


class Slices(Answer):
    """The answers of slices of a batch, one after the other, with the fields of a `Solution`.

    `requested` is the number of targets; fewer are answered where the work was `interrupted`.
    """

    q: Array
    also = ("position_error", "orientation_error", "iterations", "starts")

    def __init__(self, answers: list[Solution], requested: int, system: System):
        self.answers = answers
        self.requested = requested
        self._system = system
        self.first = np.cumsum([0, *(len(a) for a in answers)])
        for name in FIELDS:
            empty = np.zeros(
                (0, system.nq) if name == "q" else 0, dtype=bool if name == "success" else float
            )
            setattr(
                self,
                name,
                np.concatenate([getattr(a, name) for a in answers]) if answers else empty,
            )

    @property
    def interrupted(self) -> bool:
        """Whether targets are left."""
        return len(self) < self.requested

    @property
    def system(self) -> System:
        """The system that was solved for."""
        return self._system

    @cached_property
    def judged(self) -> Judgement:
        """The judgements of all slices."""
        parts = [a.judged for a in self.answers] or [judge(self.system, self.q)]
        errors, allowed = (
            np.concatenate([getattr(p, n) for p in parts], axis=1) for n in ("errors", "allowed")
        )
        return Judgement(parts[0].names, errors, allowed)

    def _sentence(self, index: tuple[int, ...]) -> str:
        k = int(np.searchsorted(self.first, index[0], side="right")) - 1
        return self.answers[k].sentence((index[0] - int(self.first[k]),))

    def __bool__(self) -> bool:
        return super().__bool__() and not self.interrupted

    def __str__(self) -> str:
        what = self.answers[0].what if self.answers else "targets reached"
        more = self.requested - len(self)
        left = f" (interrupted: {counted(more, 'target')} {verb(more, 'was', 'were')} not solved)"
        return of_many(int(np.sum(self.success)), len(self), what) + left * self.interrupted


def in_slices(
    system: System,
    count: int,
    size: int,
    solve: Callable[[int, int], Solution],
    said: Callable[[int], None] | None = None,
) -> Slices:
    """The answers of `count` targets, `size` at a time; an interrupt (Ctrl-C) ends it with what was
    done.

    solve: answers targets from a first to before a last. said: receives how many are done.
    """
    answers: list[Solution] = []
    with contextlib.suppress(KeyboardInterrupt):
        for start in range(0, count, size):
            stop = min(start + size, count)
            answers.append(solve(start, stop))
            if said is not None:
                said(stop)
    return Slices(answers, count, system)


@contextlib.contextmanager
def progress(
    file: TextIO, count: int | None, what: str = "targets"
) -> Generator[Callable[..., None] | None, None, None]:
    """What long work calls with what is done, and perhaps an arc length; nothing where `file` is no
    terminal.

    A bar where it is known of how many, else a line that counts.
    """
    if not file.isatty():
        yield None
        return
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        SpinnerColumn,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    columns: Any = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
    )
    if count is None:
        columns = (SpinnerColumn("line"), TextColumn("{task.description}"), TimeElapsedColumn())
    with Progress(*columns, console=Console(file=file), transient=True) as bar:
        task = bar.add_task(what, total=count)

        def said(done: int, length: float | None = None) -> None:
            at = "" if length is None else f", arc length {length:.3g}"
            bar.update(task, completed=done, description=what if count else f"{done} {what}{at}")

        yield said


@contextlib.contextmanager
def paced(file: TextIO, what: str) -> Generator[Callable[..., None] | None, None, None]:
    """What work calls with how much is done, and of how much: a bar with how much a second, and the
    time left.

    Nothing where `file` is no terminal.
    """
    if not file.isatty():
        yield None
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn

    columns = TextColumn("{task.description}"), BarColumn(), TextColumn("{task.fields[pace]}")
    with Progress(*columns, console=Console(file=file), transient=True) as bar:
        task = bar.add_task(what, pace="")
        first = cast("tuple[int, float] | None", None)

        def said(done: int, total: int) -> None:
            nonlocal first
            # what an earlier call did is not of this pace
            first = first or (
                done,
                time.monotonic(),
            )
            rate = (done - first[0]) / max(time.monotonic() - first[1], 1e-9)
            left = str(timedelta(seconds=round((total - done) / rate))) if rate > 0.0 else "?"
            bar.update(
                task,
                completed=done,
                total=total,
                pace=f"{done:.4g} of {total:.4g}, {rate:.3g}/s, {left} left",
            )

        yield said
