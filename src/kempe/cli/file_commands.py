"""Command for files that are larger than the memory of the computer."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from kempe.arguments import call_until_interrupt
from kempe.cli.app import (
    OPEN,
    Axis,
    Output,
    Rng,
    Scheduler,
    Seed,
    Task,
    Threads,
    TimeLimit,
    Tolerance,
    make_option,
    register_command,
)
from kempe.errors import InputError

if TYPE_CHECKING:
    from kempe.system import System


@register_command(OPEN, "deg json")
def run_map(
    verb: Annotated[str, typer.Argument(metavar="VERB", help="fk, ik, ik_all or assemble.")],
    system: System,
    output: Output,
    rows: Annotated[
        Path,
        typer.Argument(
            metavar="ROWS", help="A .parquet, .npy or .csv file, or Zarr: a question a row."
        ),
    ],
    out: Annotated[
        Path, make_option("-o,--out", "The answers to write or to go on with (Zarr).", "ANSWERS")
    ],
    frame: Annotated[
        str | None, make_option("--frame", "Body or frame; of fk all bodies if not given.", "NAME")
    ] = None,
    columns: Annotated[
        str | None,
        make_option(
            "--columns", "Columns that count, or the names of columns that have none.", "A,B,..."
        ),
    ] = None,
    form: Annotated[
        str | None,
        make_option(
            "--form", "Of fk: matrix, 3x4, position or position_quat_wxyz (matrix).", "FORM"
        ),
    ] = None,
    float32: Annotated[bool, make_option("--float32", "Of fk: write numbers of 32 bits.")] = False,
    task: Task = None,
    axis: Axis = None,
    start: Seed = None,
    tolerance: Tolerance = None,
    scheduler: Scheduler = None,
    rng: Rng = None,
    threads: Threads = None,
    time_limit: TimeLimit = None,
) -> None:
    """Answer each row of a file of any size, in chunks, so that it can be stopped and gone on with.

    With --deg angles of ROWS are degrees; what is written is in radians. Ctrl-C or the time limit
    ends it with what was done; the same command goes on from there.

    Example: kempe map ik panda targets.parquet -o q.zarr --frame tool
    """
    import kempe
    from kempe.budget import Budget
    from kempe.cli import arguments, progress
    from kempe.cli.inverse_commands import make_task_argument

    deg = output.deg
    given: dict[str, Any] = {
        "form": form,
        "dtype": "float32" if float32 else None,
        "task": make_task_argument(task, axis),
    }
    given["start"] = (
        None
        if start is None
        else arguments.read_configurations(system, start, None, deg, start=True)
    )
    if tolerance is not None:
        errors = arguments.parse_tolerance(tolerance)
        if verb != "ik" and "," in tolerance:
            raise InputError(f"--tolerance is {tolerance!r}; of {verb} it is one number")
        given["tolerance"] = errors if verb == "ik" else errors[0]
    names = None if columns is None else [name.strip() for name in columns.split(",")]
    with progress.show_progress("rows") as report:
        answer = call_until_interrupt(
            kempe.map_file,
            system,
            verb,
            rows,
            out,
            frame,
            columns=names,
            degrees=deg,
            client=scheduler,
            options={name: value for name, value in given.items() if value is not None},
            budget=Budget(rng=rng, threads=threads, time_limit=time_limit, progress=report),
        )
    output.finish_command(answer)
