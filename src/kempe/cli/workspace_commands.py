"""Commands for workspaces: make a map, look points up in it."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from kempe.cli.app import (
    OPEN,
    Base,
    Dirs,
    File,
    Json,
    Lenient,
    Root,
    Scheduler,
    Threads,
    TimeLimit,
    Xacro,
    app,
    load,
    option,
    writable,
)
from kempe.errors import InputError
from kempe.views.terminal import guarded, leave, print_json, show

PICTURES = (".png", ".svg", ".pdf")


def _picture(path: Path | None) -> None:
    """Refuse a picture that cannot be written, before any work. Errors: `InputError`, `MissingExtraError`."""
    if path is not None:
        if path.suffix.lower() not in PICTURES:
            raise InputError(f"{path}: a picture ends with {', '.join(PICTURES)}")
        writable(path)
        import kempe.views.workspace_plot  # noqa: F401, without matplotlib it ends here


def _numbers(text: str, what: str) -> list[float]:
    """Numbers that are separated by commas. Errors: `InputError`."""
    try:
        return [float(part) for part in text.split(",")]
    except ValueError:
        raise InputError(f"{what} is {text!r}; it must be numbers, separated by commas") from None


@app.command(rich_help_panel=OPEN)
@guarded
def workspace(
    file: File, frame: Annotated[str, option("--frame", "Body or frame whose places are wanted.", "NAME")],
    n: Annotated[float | None, option("-n,--samples", "How many configurations are drawn: 1e8 (1e7).", "N")] = None,
    cells: Annotated[
        str | None, option("--cells", "Cells along the longest edge, or along each: 64 or 64,64,32.", "N")
    ] = None,
    box: Annotated[
        str | None, option("--box", "The box in metres: xmin,xmax,ymin,ymax[,zmin,zmax].", "NUMBERS")
    ] = None,
    out: Annotated[Path | None, option("-o,--out", "The map to write or to go on with (Zarr).", "MAP")] = None,
    plot: Annotated[Path | None, option("--plot", "Draw a .png, .svg or .pdf file (needs matplotlib).", "FILE")] = None,
    scheduler: Scheduler = None,
    rng: Annotated[int | None, option("--rng", "Number that fixes the samples (0).", "N")] = None,
    threads: Threads = None, time_limit: TimeLimit = None, json: Json = False, base: Base = None, root: Root = None,
    package_dir: Dirs = None, xacro: Xacro = False, lenient_limits: Lenient = False,
) -> None:  # fmt: skip
    """Show what a frame reaches, by any number of random configurations.

    Ctrl-C or the time limit ends it with what was done; with -o the same command goes on from there.

    Example: kempe workspace panda --frame tool -n 1e8 -o map.zarr --plot map.png
    """
    system = load(file, base, root, package_dir, xacro, lenient_limits)
    from kempe.budget import Budget
    from kempe.views import slices

    _picture(plot)
    along: Any = None if cells is None else [int(x) if x == int(x) else x for x in _numbers(cells, "--cells")]
    ends = None if box is None else _numbers(box, "--box")
    if ends is not None and len(ends) % 2:
        raise InputError(f"--box has {len(ends)} numbers; it needs two for each axis")
    with slices.paced(sys.stderr, "samples") as said:
        answer = system.workspace(
            frame, n=n, cells=along[0] if along is not None and len(along) == 1 else along,
            box=None if ends is None else np.reshape(ends, (-1, 2)), client=scheduler, path=out,
            budget=Budget(rng=rng, threads=threads, time_limit=time_limit, progress=said),
        )  # fmt: skip
    if plot is not None:
        axes = answer.plot()
        np.ravel(axes)[0].figure.savefig(plot, dpi=150, bbox_inches="tight")
    written = [str(p) for p in (out, plot) if p is not None and p.exists()]
    if json:
        print_json({**answer.data(), "written": written})
    else:
        show(str(answer))
        for path in written:
            print(f"written to {path}")
    leave(answer)


@app.command(rich_help_panel=OPEN, context_settings={"ignore_unknown_options": True})
@guarded
def query(
    path: Annotated[Path, typer.Argument(metavar="MAP", help="A map that 'kempe workspace' wrote.")],
    points: Annotated[list[str], typer.Argument(metavar="POINT...", help="Points x,y[,z] in the ground frame [m].")],
    json: Json = False,
) -> None:
    """Say whether points are reached, and how far they are from the boundary.

    The map decides where all cells around have samples, else the inverse model.

    Example: kempe query map.zarr 0.3,0.2,0.5 0.9,0,0
    """
    from kempe.analysis.spaces.workspace.workspace import open_workspace

    space = open_workspace(path)
    dim = space.system.dim
    rows = [_numbers(p, "a point") for p in points]
    if any(len(row) != dim for row in rows):
        raise InputError(f"points must have {dim} numbers, separated by commas")
    inside, far = space.contains(rows), space.distance(rows)
    if json:
        found = [{"point": p, "reached": bool(i), "distance": float(f)} for p, i, f in
                 zip(rows, inside, far, strict=True)]  # fmt: skip
        print_json({"frame": space.frame, "resolution": space.resolution, "points": found})
        return
    for p, i, f in zip(points, inside, far, strict=True):
        said = "reached" if i else "not reached"
        print(f"{p}: {said}, {abs(f):.4g} m {'inside' if f >= 0 else 'outside'} the boundary of the map "
              f"(+- {space.resolution:.2g} m)")  # fmt: skip
