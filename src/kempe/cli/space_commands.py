"""The command about the spaces of a system: configuration space, its components and samples, task
space, picture.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from kempe.arguments import until_interrupt
from kempe.budget import Budget
from kempe.cli.app import (
    CLOSED,
    File,
    Json,
    Out,
    Picture,
    Reading,
    TimeLimit,
    app,
    drawable,
    load,
    option,
    reads_file,
    results,
    save_picture,
    say_written,
)
from kempe.cli.terminal import INCOMPLETE, guarded, print_json
from kempe.errors import InputError


@app.command(rich_help_panel=CLOSED)
@guarded
@reads_file
def spaces(
    file: File,
    reading: Reading,
    frame: Annotated[
        str | None, option("--frame", "Frame whose task space is wanted.", "NAME")
    ] = None,
    task: Annotated[
        str | None,
        option(
            "--task", "What of the frame is drawn: xy, xz, yz or direction (of its z axis).", "NAME"
        ),
    ] = None,
    position_only: Annotated[
        bool, option("--position-only", "Only its position counts, not its pose.")
    ] = False,
    sample: Annotated[
        float | None,
        option("--sample", "So many random configurations, uniform in a stated measure.", "N"),
    ] = None,
    rng: Annotated[int, option("--rng", "Number that fixes what is random (0).", "N")] = 0,
    time_limit: TimeLimit = None,
    plot: Picture = None,
    out: Out = None,
    json: Json = False,
) -> None:
    """Say what the configuration space is: dimension, components, samples; and the task space of a
    frame.

    With --plot both spaces of a system with two freedoms are drawn beside one another (--frame says
    of what).

    Example: kempe spaces two_link --frame e --sample 1000 -o q.csv --plot spaces.png
    """
    if out is not None and sample is None:
        raise InputError(f"{out}: --sample says how many configurations are written")
    if plot is not None and frame is None:
        raise InputError(f"{plot}: --frame says whose task space is drawn")
    if task is not None and plot is None:
        raise InputError("--task says what --plot draws: give it a file")
    if position_only and frame is None:
        raise InputError("--position-only is about the task space of a frame: --frame names it")
    system = load(file, reading)
    results(out)
    drawable(plot)
    space = system.configuration_space
    budget = Budget(time_limit=time_limit)
    found: dict[str, Any] = {"configuration_space": space}
    found["components"] = until_interrupt(space.components, budget=budget)
    if frame is not None:
        found["task_space"] = system.task_space(frame, task="position" if position_only else "pose")
    if sample is not None:
        found["sample"] = until_interrupt(space.sample, sample, rng, budget=budget)
    written: list[Path] = []
    if plot is not None:
        from kempe.cli import progress

        with progress.paced(sys.stderr, "places") as said:
            spent = Budget(time_limit=time_limit, progress=said)
            axes = until_interrupt(system.plot_spaces, frame or "", task=task, budget=spent)
            save_picture(axes[0], plot)
        written.append(plot)
    if out is not None:
        from kempe.cli import table_files

        table_files.write_configurations(out, system, found["sample"].q)
        written.append(out)
    if json:
        print_json(
            {k: x.data() for k, x in found.items()} | {"written": [str(path) for path in written]}
        )
    else:
        for k, x in found.items():
            print(f"{k.replace('_', ' ')}: {x}")
        for path in written:
            say_written(path, False)
    if found["components"].late or not found.get("sample", space):
        raise typer.Exit(INCOMPLETE)
