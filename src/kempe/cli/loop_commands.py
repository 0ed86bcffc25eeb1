"""Commands for systems with loops: freedoms, assembly, motions, drawings."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Annotated, Any, NoReturn

import numpy as np
import typer

from kempe.arguments import until_interrupt
from kempe.budget import Budget
from kempe.cli.app import (
    CLOSED,
    Deg,
    File,
    Film,
    InPlace,
    Json,
    Out,
    Page,
    Picture,
    Posture,
    Reading,
    TimeLimit,
    app,
    drawable,
    drawn,
    load,
    option,
    reads_file,
    remark,
    results,
    save_picture,
    say_drawn,
    say_written,
    written_to,
)
from kempe.cli.terminal import INCOMPLETE, guarded, leave, print_json, show
from kempe.errors import InputError

if TYPE_CHECKING:
    from kempe.assemble.answer import Assembly
    from kempe.motion.path import Path as Motion
    from kempe.system import System

BESIDE = 6
"""Assembly modes up to which each is drawn beside the others."""

Known = Annotated[
    list[str] | None,
    typer.Argument(
        metavar="NAME=VALUE",
        help=(
            "Known coordinates; or places of frames: tip=x,y[,z]; or a .csv file whose first line "
            "names coordinates."
        ),
    ),
]
At = Annotated[
    str | None,
    option(
        "--q", "name=value,... (the loops are closed around these), or all of q as a,b,c.", "VALUES"
    ),
]
Where = Annotated[
    list[str] | None,
    option(
        "--where",
        "An equation that holds, too, in radians and metres: 'A = 2*B'. May be repeated.",
        "EQUATION",
    ),
]
Near = Annotated[
    str | None,
    option(
        "--start,--near", "Where the search starts: a posture or values, as --q of fk.", "START"
    ),
]
Curves = Annotated[
    list[str] | None, option("--frame", "Frame whose curve is wanted; can be repeated.", "NAME")
]
Marks = Annotated[
    list[str] | None,
    option("--frame", "Body or frame whose axes are drawn; can be repeated.", "NAME"),
]
Tolerance = Annotated[
    str | None,
    option(
        "--tolerance",
        "What dimensions may be off by, in metres and radians, or 'measured'.",
        "NUMBER",
    ),
]
NoLimits = Annotated[bool, option("--no-limits", "Leave joint limits out.")]


@app.command(rich_help_panel=CLOSED)
@guarded
@reads_file
def dof(
    file: File,
    reading: Reading,
    q: At = None,
    posture: Posture = None,
    actuated: Annotated[
        str | None,
        option(
            "--actuated", "Driven joints: do they control it? Default: as FILE says.", "A,B,..."
        ),
    ] = None,
    fast: Annotated[
        bool, option("--fast", "Counting and rank only, not the true local dimension.")
    ] = False,
    plot: Picture = None,
    html: Page = None,
    deg: Deg = False,
    json: Json = False,
    tolerance: Tolerance = None,
) -> None:
    """Count the degrees of freedom: by formula, by rank and truly.

    Example: kempe dof bennett
    """
    system = _within(load(file, reading), tolerance)
    from kempe.cli import arguments, loop_report

    driven = None if actuated is None else [a.strip() for a in actuated.split(",") if a.strip()]
    if driven == []:
        raise InputError(f"--actuated names no joint; there are: {', '.join(system.joint_names)}")
    drawable(plot, None, html)
    at, closing = arguments.configuration(system, q, posture, deg)
    if closing is not None and not closing:
        _open(closing, deg, json)
    answer = system.mobility(at, driven, local=not fast)
    print_json(loop_report.report_facts(system, answer, deg)) if json else show(
        loop_report.mobility(answer)
    )
    say_drawn(drawn(system, answer.q, plot, None, html, motion=True))
    if not answer.closed:
        raise typer.Exit(INCOMPLETE)


def _within(system: System, tolerance: str | None) -> System:
    """The system with this tolerance. Errors: `InputError`."""
    if tolerance is None:
        return system
    from kempe.assemble.nearest_exact import MEASURED, tolerance_of

    mechanism = system.mechanism
    try:
        mechanism.tolerance = tolerance if tolerance == MEASURED else float(tolerance)
    except ValueError:
        raise InputError(
            f"--tolerance is {tolerance!r}; it must be a number or {MEASURED!r}"
        ) from None
    tolerance_of(system, mechanism.tolerance)
    return mechanism.build()


def _under(system: System, equations: list[str]) -> System:
    """The system under further equations, which are called as they are written."""
    if not equations:
        return system
    mechanism = system.mechanism
    for text in dict.fromkeys(equations):
        # 'A' alone would be called as the joint
        mechanism.equation(text if "=" in text else f"{text} = 0", text)
    return mechanism.build()


@app.command(rich_help_panel=CLOSED)
@guarded
@reads_file
def classify(
    file: File,
    reading: Reading,
    q: At = None,
    posture: Posture = None,
    project: Annotated[
        bool, option("--project", "Where q is not closed, take the nearest that is.")
    ] = False,
    plot: Picture = None,
    html: Page = None,
    deg: Deg = False,
    json: Json = False,
    tolerance: Tolerance = None,
) -> None:
    """Say which kind each constraint is, and how far motions reach.

    Example: kempe classify car
    """
    system = _within(load(file, reading), tolerance)
    from kempe.cli import arguments, loop_report

    drawable(plot, None, html)
    at, closing = arguments.configuration(system, q, posture, deg)
    if closing is not None and not closing:
        _open(closing, deg, json)
    answer = system.classify(at, project=project)
    print_json(loop_report.report_facts(system, answer, deg)) if json else show(
        loop_report.classify(answer)
    )
    say_drawn(drawn(system, answer.q, plot, None, html, motion=True))


@app.command(rich_help_panel=CLOSED)
@guarded
@reads_file
def assemble(
    file: File,
    reading: Reading,
    known: Known = None,
    near: Near = None,
    where: Where = None,
    branch: Annotated[
        str | None,
        option("--branch", "A branch by its signs (see --modes), or a posture.", "+-..."),
    ] = None,
    modes: Annotated[
        bool, option("--modes", "All assembly modes, not only the one near the start.")
    ] = False,
    nearest: Annotated[
        bool, option("--nearest", "Where freedoms are left: the nearest to the start.")
    ] = False,
    continuous: Annotated[
        bool, option("--continuous", "Rows of a file: each starts where the last two lead.")
    ] = False,
    no_limits: NoLimits = False,
    time_limit: TimeLimit = None,
    plot: Picture = None,
    gif: Film = None,
    html: Page = None,
    out: Out = None,
    deg: Deg = False,
    json: Json = False,
    tolerance: Tolerance = None,
) -> None:
    """Close all loops: known coordinates in, all others out; with --where, under further equations.

    Example: kempe assemble four_bar A=30 --deg
    """
    if modes and (branch is not None or nearest or continuous):
        raise InputError(
            "--modes gives all branches: leave --branch, --nearest and --continuous out"
        )
    if time_limit is not None and not modes:
        raise InputError("--time-limit is for --modes: one assembly takes milliseconds")
    system = _under(_within(load(file, reading), tolerance), where or [])
    from kempe.cli import arguments, as_json, loop_report

    results(out, *known or ())
    drawable(plot, gif, html)
    values = arguments.known(system, known or [], deg)
    start = arguments.start(system, near, deg)
    answer: Any
    if modes:
        answer = until_interrupt(
            system.assembly_modes,
            values,
            start,
            limits=not no_limits,
            budget=Budget(time_limit=time_limit),
        )
    else:
        if nearest and continuous:
            raise InputError("--nearest and --continuous are two ways to choose; give one of them")
        answer = system.assemble(
            values,
            start,
            branch=arguments.branch(system, values, branch),
            limits=not no_limits,
            prefer="nearest" if nearest else "continuous" if continuous else None,
        )
        if plot is not None and np.ndim(answer.success):
            raise InputError(
                f"{plot}: one configuration is drawn, and the file of known values has several"
            )
    written = drawn(
        system, answer, plot, gif, html, side_by_side=modes and 1 < len(answer) <= BESIDE
    )
    if out is not None and (answer or np.any(getattr(answer, "success", False))):
        from kempe.cli import table_files

        table_files.write_configurations(
            out, system, answer.q if modes else loop_report.closed_only(answer), deg
        )
        written.append(out)
    if json:
        data = as_json.answer_facts(answer, deg)
        _say(data, None, written)
    else:
        _say(
            None,
            loop_report.modes(answer, deg) if modes else loop_report.assembly(answer, deg, values),
            written,
        )
    _not_written(out, written)
    if modes and answer.late:
        raise typer.Exit(INCOMPLETE)
    leave(answer)


@app.command(rich_help_panel=CLOSED)
@guarded
@reads_file
def trace(
    file: File,
    reading: Reading,
    driver: Annotated[
        str | None, option("--driver", "Coordinate that counts as the input.", "NAME")
    ] = None,
    frame: Curves = None,
    start: Annotated[
        str | None,
        option(
            "--start,--near", "Where it starts: a posture, name=value,... or all of q.", "START"
        ),
    ] = None,
    hold: Annotated[
        list[str] | None, option("--hold", "Hold a coordinate; can be repeated.", "NAME=VALUE")
    ] = None,
    branches: Annotated[
        bool, option("--branches", "Trace the branches met at bifurcations, too.")
    ] = False,
    points: Annotated[
        int | None,
        option("--points", "Write this many points, at equal distances of arc length.", "N"),
    ] = None,
    no_limits: NoLimits = False,
    time_limit: TimeLimit = None,
    out: Out = None,
    plot: Picture = None,
    gif: Film = None,
    html: Page = None,
    deg: Deg = False,
    json: Json = False,
    tolerance: Tolerance = None,
) -> None:
    """Follow a mechanism with one freedom through its whole motion.

    Files get arc length, all coordinates, and x, y (and z) of the frames. Ctrl-C ends
    the work with the part that was done, as a time limit does (120 s, unless another is given).

    Example: kempe trace jansen --driver O --frame foot -o foot.csv --plot foot.png --gif foot.gif
    """
    if points is not None and points < 2:
        raise InputError(f"--points is {points}; it must be at least 2")
    system = _within(load(file, reading), tolerance)
    from kempe.cli import arguments, loop_report, progress

    results(out)
    drawable(plot, gif, html)
    names = [system.structure.frame_name(f) for f in frame or ()]
    held = arguments.known(system, hold or [], deg, frames=False)
    begin, closing = arguments.first(system, start, held, deg)
    if closing is not None and not closing:
        _open(closing, deg, json)
    with progress.progress(sys.stderr, None, "points traced") as said:
        path = until_interrupt(
            system.trace,
            driver,
            begin,
            hold=held,
            limits=not no_limits,
            ways="branches" if branches else "both",
            budget=Budget(time_limit=time_limit, progress=said),
        )
    path = replace(
        path, frames=names, others=tuple(replace(other, frames=names) for other in path.others)
    )
    shown = path
    if points is not None:
        with progress.progress(sys.stderr, points, "points") as said:
            shown = _resampled(path, points, Budget(time_limit=time_limit, progress=said))
    written: list[Path] = []
    if out is not None and (path or path.interrupted or path.late):
        loop_report.write_path(out, shown, deg, branches)
        written.append(out)
    written += drawn(
        system, shown, plot, gif, html, draw=lambda: _drawing(system, shown, names), frames=names
    )
    if json:
        _say(loop_report.path_facts(shown, deg), None, written)
    else:
        _say(None, loop_report.path(path if shown else shown, deg), written)
    _not_written(out, written)
    leave(shown if path else path)


@app.command(rich_help_panel=CLOSED)
@guarded
@reads_file
def plot(
    file: File,
    reading: Reading,
    out: Annotated[
        Path | None,
        typer.Argument(metavar="OUT", help="Picture to write: .png, .svg or .pdf; or -o FILE."),
    ] = None,
    output: InPlace = None,
    q: At = None,
    posture: Posture = None,
    frame: Marks = None,
    labels: Annotated[
        str | None,
        option("--labels", "joints, frames, bodies, coordinates, parameters; or all.", "A,B,..."),
    ] = None,
    axes: Annotated[
        list[str] | None, option("--axes", "Draw and name its axes; or all; repeated.", "NAME")
    ] = None,
    angles: Annotated[
        bool, option("--angles", "Arcs of the coordinates, from where they are measured.")
    ] = False,
    dimensions: Annotated[bool, option("--dimensions", "Lengths of the links.")] = False,
    motion: Annotated[bool, option("--motion", "Arrows for the freedoms of the joints.")] = False,
    workspace: Annotated[
        str | None, option("--workspace", "Shade what this frame reaches.", "NAME")
    ] = None,
    tree: Annotated[
        bool, option("--tree", "In place of that the tree of bodies and joints.")
    ] = False,
    deg: Deg = False,
    json: Json = False,
) -> None:
    """Draw a system at a configuration, or its tree.

    Example: kempe plot two_link -o arm.png --q 30,50 --deg --axes all --angles --dimensions
    """
    out = written_to(out, output)
    system = load(file, reading)
    from kempe.cli import arguments

    names = [system.structure.frame_name(f) for f in frame or ()]
    drawable(out)
    at, closing = (None, None) if tree else arguments.configuration(system, q, posture, deg)
    save_picture(
        system.plot_tree()
        if tree
        else system.plot(
            at,
            frames=names,
            labels=True if labels is None else "all" if labels == "all" else labels.split(","),
            axes="all" if axes == ["all"] else axes or (),
            angles=angles,
            dimensions=dimensions,
            motion=motion,
            workspace=workspace,
        ),
        out,
    )
    say_written(out, json)
    if closing is not None and not closing:
        remark(str(closing.status))
        raise typer.Exit(INCOMPLETE)


# ---- pictures and messages


def _open(closing: Assembly, deg: bool, json: bool) -> NoReturn:
    """Say that the loops do not close with what is given, and end the command."""
    from kempe.cli import as_json, loop_report

    print_json(as_json.answer_facts(closing, deg)) if json else show(
        loop_report.assembly(closing, deg)
    )
    raise typer.Exit(INCOMPLETE)


def _resampled(path: Motion, points: int, budget: Budget) -> Motion:
    """The path and its other branches, with points at equal distances."""
    if len(path) < 2:
        return path
    found = until_interrupt(path.resample, points, budget=budget)
    if not found and path:  # broken off
        return found
    return replace(found, others=tuple(_resampled(other, points, budget) for other in path.others))


def _drawing(system: System, path: Motion, names: list[str]) -> Any:
    """The drawing of a path, with the curves of its other branches: a row of NaN lifts the pen
    between them.
    """
    gap = np.full((1, system.nq), np.nan)
    parts = [path.q, *(part for other in path.others for part in (gap, other.q))]
    all_of_it = SimpleNamespace(q=np.vstack(parts), driver=path.driver, frames=path.frames)
    return system.plot(path=all_of_it, frames=names, ghosts=0 if names or len(path) < 2 else 5)


def _say(data: dict[str, Any] | None, report: Any, written: list[Path]) -> None:
    """Print an answer, as data or else as a report, and which files were written."""
    if data is not None:
        print_json({**data, "written": [str(path) for path in written]})
        return
    show(report)
    for path in written:
        say_written(path, False)


def _not_written(out: Path | None, written: list[Path]) -> None:
    """Say of a file that was requested why there is none."""
    if out is not None and out not in written:
        remark(f"{out} is not written: nothing is closed")
