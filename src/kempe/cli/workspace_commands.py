"""Commands for workspaces: compute a map, look points up in a map."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer

from kempe.arguments import call_until_interrupt
from kempe.cli.app import OPEN, Output, Scheduler, Threads, TimeLimit, make_option, register_command
from kempe.cli.table_files import parse_finite_numbers
from kempe.cli.terminal import print_json
from kempe.errors import InputError
from kempe.words import DEGREE, format_count

if TYPE_CHECKING:
    from kempe.system import System


def _parse_orientation(text: str, what: str, deg: bool) -> Any:
    """Return an angle, several angles, or roll, pitch and yaw, from text.

    Errors: `InputError`.

    Errors: `InputError`.
    """
    angles = [x * DEGREE if deg else x for x in parse_finite_numbers(text, what)]
    return angles[0] if len(angles) == 1 else angles


@register_command(OPEN, "plot deg json")
def run_workspace(
    system: System,
    output: Output,
    frame: Annotated[str, make_option("--frame", "Body or frame whose places are wanted.", "NAME")],
    n: Annotated[
        float | None, make_option("-n,--samples", "How many samples are drawn: 1e8 (1e7).", "N")
    ] = None,
    cells: Annotated[
        str | None,
        make_option("--cells", "Cells along the longest edge, or along each: 64 or 64,64,32.", "N"),
    ] = None,
    box: Annotated[
        str | None,
        make_option("--box", "The box in metres: xmin,xmax,ymin,ymax[,zmin,zmax].", "NUMBERS"),
    ] = None,
    kind: Annotated[
        str | None,
        make_option(
            "--kind",
            "Which places: reachable, constant-orientation, dexterous; or orientation.",
            "KIND",
        ),
    ] = None,
    orientation: Annotated[
        str | None,
        make_option(
            "--orientation",
            "The orientation that counts: roll,pitch,yaw; in the plane angles.",
            "ANGLES",
        ),
    ] = None,
    at: Annotated[
        str | None,
        make_option("--at", "The place x,y[,z] at which orientations are wanted.", "POINT"),
    ] = None,
    out: Annotated[
        Path | None, make_option("-o,--out", "The map to write or to go on with (Zarr).", "MAP")
    ] = None,
    scheduler: Scheduler = None,
    rng: Annotated[
        int | None, make_option("--rng", "Number that fixes the samples (0).", "N")
    ] = None,
    threads: Threads = None,
    time_limit: TimeLimit = None,
) -> None:
    """Show what a frame reaches, by any number of random configurations, or in one orientation or
    all of them.

    Ctrl-C or the time limit ends it with what was done; with -o the same command goes on from
    there.

    Example: kempe workspace panda --frame tool -n 1e8 -o map.zarr --plot map.png
    """
    from kempe.budget import Budget
    from kempe.cli import progress

    deg = output.deg
    along: Any = (
        None
        if cells is None
        else [int(x) if x == int(x) else x for x in parse_finite_numbers(cells, "--cells")]
    )
    ends = None if box is None else parse_finite_numbers(box, "--box")
    if ends is not None and len(ends) % 2:
        raise InputError(
            f"--box has {format_count(len(ends), 'number')}; it needs two for each axis"
        )
    with progress.show_progress("samples") as report:
        answer = call_until_interrupt(
            system.workspace,
            frame,
            kind=kind,
            orientation=None
            if orientation is None
            else _parse_orientation(orientation, "--orientation", deg),
            at=None if at is None else parse_finite_numbers(at, "--at"),
            n=n,
            cells=along[0] if along is not None and len(along) == 1 else along,
            box=None if ends is None else np.reshape(ends, (-1, 2)),
            client=scheduler,
            path=out,
            budget=Budget(rng=rng, threads=threads, time_limit=time_limit, progress=report),
        )
    if out is not None and out.exists():
        output.written.append(out)
    output.draw_configurations(system, None, answer.plot)
    output.finish_command(answer)


@register_command(OPEN, "deg json", context_settings={"ignore_unknown_options": True})
def run_query(
    output: Output,
    path: Annotated[
        Path, typer.Argument(metavar="MAP", help="A map that 'kempe workspace' wrote.")
    ],
    points: Annotated[
        list[str],
        typer.Argument(metavar="POINT...", help="Points x,y[,z] in metres, in the ground frame."),
    ],
) -> None:
    """Say whether points are reached, and how far they are from the boundary.

    The exact boundary decides where it is known, else the map where all cells around have samples,
    else the inverse model. Of a map of orientations points are orientations: angles of the plane,
    or roll,pitch,yaw.

    Example: kempe query map.zarr 0.3,0.2,0.5 0.9,0,0
    """
    from kempe.workspace.answer import open_workspace
    from kempe.workspace.kinds import read_rotations

    space = open_workspace(path)
    turned = space.kind == "orientation"
    dim = space.system.dim
    wanted = 1 if turned and dim == 2 else dim
    rows = [parse_finite_numbers(p, "a point") for p in points]
    if any(len(row) != wanted for row in rows):
        raise InputError(f"points must have {format_count(wanted, 'number')}, separated by commas")
    if turned:
        inside = [
            bool(space.contains(read_rotations(_parse_orientation(p, "a point", output.deg), dim)))
            for p in points
        ]
        far: Any = [None] * len(rows)
    else:
        inside = space.contains(rows).tolist()
        far = space.distance(rows).tolist()
    off = 0.0 if space.exact is not None else space.resolution
    if output.json:
        found = [
            {"point": p, "reached": i, "distance": f}
            for p, i, f in zip(rows, inside, far, strict=True)
        ]
        print_json({"frame": space.frame, "kind": space.kind, "resolution": off, "points": found})
        return
    edge = "the exact boundary" if not off else f"the boundary of the map (+- {off:.2g} m)"
    for p, i, f in zip(points, inside, far, strict=True):
        beside = "" if turned else f", {abs(f):.4g} m {'inside' if f >= 0 else 'outside'} {edge}"
        print(f"{p}: {'reached' if i else 'not reached'}{beside}")
