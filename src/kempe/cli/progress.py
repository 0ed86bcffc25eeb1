"""Long computations: a progress bar on standard error if that is a terminal, and Ctrl-C."""

from __future__ import annotations

import contextlib
import sys
import time
from collections.abc import Callable, Generator
from dataclasses import replace
from datetime import timedelta
from typing import Any

from kempe.arguments import call_until_interrupt
from kempe.budget import Budget


def run_verb(
    what: str,
    verb: Callable[..., Any],
    *arguments: Any,
    budget: Budget,
    count: int | None = None,
    **options: Any,
) -> Any:
    """Run a verb, show its progress, and return its answer; after Ctrl-C the part that was done.

    `what` is what the verb counts, `count` how many there are where that is known.
    """
    with show_progress(what, count) as report:
        spend = replace(budget, progress=report)
        return call_until_interrupt(verb, *arguments, budget=spend, **options)


@contextlib.contextmanager
def show_progress(
    what: str, count: int | None = None
) -> Generator[Callable[..., None] | None, None, None]:
    """Return a function that draws a progress bar; None where standard error is no terminal.

    Computations call the function with the amount that is done, and with the total number or an arc
    length.

    A bar with the pace and the time left where it is known of how many, else a line that counts.
    """
    if not sys.stderr.isatty():
        yield None
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn

    columns = TextColumn("{task.description}"), BarColumn(), TextColumn("{task.fields[pace]}")
    with Progress(*columns, console=Console(file=sys.stderr), transient=True) as bar:
        task = bar.add_task(what, total=count, pace="")
        begin = time.monotonic()
        first: list[float] = []  # what an earlier call did is not of this pace

        def report_progress(done: float, more: float | None = None) -> None:
            """Draw the bar for the amount that is done."""
            total = more if isinstance(more, int) else count
            first.append(done)
            rate = (done - first[0]) / max(time.monotonic() - begin, 1e-9)
            if total is None:
                pace = f"{done:.4g}" + ("" if more is None else f", arc length {more:.3g}")
            else:
                left = timedelta(seconds=round((total - done) / rate)) if rate > 0.0 else "?"
                pace = f"{done:.4g} of {total:.4g}, {rate:.3g}/s, {left} left"
            del first[1:]
            bar.update(task, completed=done, total=total, pace=pace)

        yield report_progress
