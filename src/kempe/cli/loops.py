"""Commands for systems with closed loops: degrees of freedom, assembly, motion, drawings."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from kempe.cli.app import Base, Deg, Dirs, File, Json, Out, Posture, Root, Values, Xacro, app, load, option, told
from kempe.errors import InputError
from kempe.views.terminal import INCOMPLETE, guarded, print_json, show

Known = Annotated[
    list[str] | None,
    typer.Argument(metavar="[NAME=VALUE]...", help="Known coordinates, or frames: point=x,y[,z]."),
]
Near = Annotated[
    str | None, option("--near", "Configuration to start from: a posture, or as --q of fk.", "VALUES or POSTURE")
]
Picture = Annotated[Path | None, option("--plot", "Write a picture: .png, .svg or .pdf (needs matplotlib).", "FILE")]
Frames = Annotated[list[str] | None, option("--frame", "Frame whose curve is wanted; can be repeated.", "NAME")]


@app.command()
@guarded
def dof(
    file: File, q: Values = None, posture: Posture = None,
    actuated: Annotated[
        str | None, option("--actuated", "Driven joints: do they control it? Default: as FILE says.", "A,B,...")
    ] = None,
    fast: Annotated[bool, option("--fast", "Counting and rank only, not the true local dimension.")] = False,
    deg: Deg = False, json: Json = False, base: Base = None, root: Root = None, package_dir: Dirs = None,
    xacro: Xacro = False,
) -> None:  # fmt: skip
    """Count the degrees of freedom: by formula, by rank and truly.

    Example: kempe dof bennett
    """
    system = load(file, base, root, package_dir, xacro)
    from kempe.views import rows

    at = rows.configuration(system, q, posture, deg) if q or posture else None
    driven = None if actuated is None else [a.strip() for a in actuated.split(",") if a.strip()]
    answer = system.mobility(at, driven, local=not fast)
    print_json(answer.data()) if json else print(answer)
    if not answer.closed:
        raise typer.Exit(INCOMPLETE)


@app.command()
@guarded
def assemble(
    file: File, known: Known = None, near: Near = None,
    branch: Annotated[str | None, option("--branch", "A branch by its signs, or a posture.", "+-...")] = None,
    modes: Annotated[bool, option("--modes", "All assembly modes, not only the one near the start.")] = False,
    plot: Picture = None, out: Out = None, deg: Deg = False, json: Json = False, base: Base = None, root: Root = None,
    package_dir: Dirs = None, xacro: Xacro = False,
) -> None:  # fmt: skip
    """Close all loops: known coordinates in, all others out.

    Example: kempe assemble four_bar A=30 --deg
    """
    system = load(file, base, root, package_dir, xacro)
    from kempe.views import loop_report, rows

    rows.output(out)
    _picture(plot)
    given = loop_report.known(system, known or [], deg)
    start = loop_report.start(system, near, deg)
    if modes:
        if branch is not None:
            raise InputError("--modes gives all branches: leave --branch out")
        answer: Any = system.assembly_modes(given, start)
    else:
        answer = system.assemble(given, start, branch=branch)
    if plot is not None:
        _save(system.plot(answer.q[0] if modes and len(answer) else None if modes else answer.q), plot)
    if out is not None:
        rows.write_configurations(out, system, answer.q, deg)
    if json:
        print_json(loop_report.modes_facts(answer, deg) if modes else loop_report.assembly_facts(answer, deg))
    else:
        show(loop_report.modes(answer, deg) if modes else loop_report.assembly(answer, deg))
        for written in (out, plot):
            if written is not None:
                told(written, json)
    if not answer:
        raise typer.Exit(INCOMPLETE)


@app.command()
@guarded
def trace(
    file: File,
    driver: Annotated[str | None, option("--driver", "Coordinate that counts as the input.", "NAME")] = None,
    frame: Frames = None, start: Near = None,
    hold: Annotated[list[str] | None, option("--hold", "Hold a coordinate; can be repeated.", "NAME=VALUE")] = None,
    branches: Annotated[bool, option("--branches", "Trace the branches met at bifurcations, too.")] = False,
    points: Annotated[int | None, option("--points", "Write this many points at equal distances.", "N")] = None,
    no_limits: Annotated[bool, option("--no-limits", "Leave joint limits out.")] = False,
    out: Annotated[
        Path | None, option("-o,--out", "Write arc length, coordinates and frames to a .csv or .npy file.", "FILE")
    ] = None,
    plot: Picture = None, deg: Deg = False, json: Json = False, base: Base = None, root: Root = None,
    package_dir: Dirs = None, xacro: Xacro = False,
) -> None:  # fmt: skip
    """Follow a mechanism with one freedom through its whole motion.

    Example: kempe trace jansen --driver O --frame foot -o foot.csv --plot foot.png
    """
    system = load(file, base, root, package_dir, xacro)
    from kempe.views import loop_report, rows

    rows.output(out)
    _picture(plot)
    names = [system.frame_name(f) for f in frame or ()]
    held = loop_report.known(system, hold or [], deg)
    with loop_report.progress(sys.stderr) as said:
        path = system.trace(
            driver, loop_report.start(system, start, deg), frames=names, hold=held, switch=branches,
            limits=not no_limits, progress=said,
        )  # fmt: skip
    shown = path if points is None or len(path) < 2 else path.resample(points)
    if out is not None:
        loop_report.write_path(out, shown, deg)
    if plot is not None:
        _save(system.plot(path=shown, frames=names, ghosts=0 if names else 5), plot)
    if json:
        print_json(loop_report.path_facts(path, deg))
    else:
        show(loop_report.path(path, deg))
        for written in (out, plot):
            if written is not None:
                told(written, json)
    if not path or path.interrupted:
        raise typer.Exit(INCOMPLETE)


@app.command()
@guarded
def plot(
    file: File, out: Annotated[Path, typer.Argument(metavar="OUT", help="Picture to write: .png, .svg or .pdf.")],
    q: Values = None, posture: Posture = None, frame: Frames = None, deg: Deg = False, json: Json = False,
    base: Base = None, root: Root = None, package_dir: Dirs = None, xacro: Xacro = False,
) -> None:  # fmt: skip
    """Draw a system at a configuration.

    Example: kempe plot peaucellier peaucellier.png
    """
    system = load(file, base, root, package_dir, xacro)
    from kempe.views import rows

    _picture(out)
    at = rows.configuration(system, q, posture, deg) if q or posture else None
    _save(system.plot(at, frames=frame or ()), out)
    told(out, json)


def _picture(path: Path | None) -> None:
    """Refuse an ending that no picture has, before any work."""
    if path is not None and path.suffix.lower() not in (".png", ".svg", ".pdf"):
        raise InputError(f"{path}: pictures are .png, .svg or .pdf files")


def _save(axes: Any, path: Path) -> None:
    axes.figure.savefig(path, dpi=200, bbox_inches="tight")
