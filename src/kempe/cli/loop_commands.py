"""Commands for systems with loops: mobility, assembly, motions, configuration spaces, drawings."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer

from kempe.arguments import call_until_interrupt
from kempe.budget import Budget
from kempe.cli import options
from kempe.cli.app import (
    CLOSED,
    Output,
    check_picture_file,
    choose_output_file,
    register_command,
)
from kempe.cli.options import make_option
from kempe.cli.progress import run_verb
from kempe.cli.terminal import INCOMPLETE, end_incomplete_command, print_remark
from kempe.errors import InputError

if TYPE_CHECKING:
    from kempe.motion.path import Path as Motion
    from kempe.system import System

BESIDE = 6
"""Assembly modes up to which each is drawn beside the others."""


# ---- freedoms and kinds of constraints


@register_command(CLOSED, "plot html deg json")
def run_dof(
    system: System,
    output: Output,
    q: options.Values = None,
    posture: options.Posture = None,
    actuated: Annotated[
        str | None,
        make_option(
            "--actuated",
            "Driven joints, to test whether they control the system (default: those of FILE).",
            "A,B,...",
        ),
    ] = None,
    fast: Annotated[
        bool,
        make_option(
            "--fast", "Count and rank only; leave out the local dimension, which takes longer."
        ),
    ] = False,
    tolerance: options.Dimensions = None,
) -> None:
    """Compute the degrees of freedom: Grübler count, rank, and local dimension.

    Example: kempe dof bennett
    """
    from kempe.cli import arguments

    driven = arguments.parse_joint_names(system, "--actuated", actuated)
    system = _apply_tolerance(system, tolerance)
    there = _close_configuration(system, q, posture, output)
    answer = system.mobility(there, driven, local=not fast)
    output.draw_configurations(system, answer.q, motion=True)
    output.finish_command(answer)


@register_command(CLOSED, "plot html deg json")
def run_classify(
    system: System,
    output: Output,
    q: options.Values = None,
    posture: options.Posture = None,
    project: Annotated[
        bool,
        make_option(
            "--project", "If q does not close the loops, take the nearest configuration that does."
        ),
    ] = False,
    tolerance: options.Dimensions = None,
) -> None:
    """Classify each constraint as holonomic or nonholonomic, and count the dimensions that motions reach.

    Example: kempe classify car
    """
    system = _apply_tolerance(system, tolerance)
    answer = system.classify(_close_configuration(system, q, posture, output), project=project)
    output.draw_configurations(system, answer.q, motion=True)
    output.finish_command(answer)


def _close_configuration(system: System, q: str | None, posture: str | None, output: Output) -> Any:
    """Return the given configuration with closed loops.

    Where the loops do not close, the command ends with the answer that says so.
    """
    from kempe.cli import arguments

    there, closing = arguments.read_configuration(system, q, posture, output.deg)
    if closing is not None and not closing:
        output.finish_command(closing)
    return there


def _apply_tolerance(system: System, tolerance: str | None) -> System:
    """Return the system with this tolerance of its dimensions.

    Errors: `InputError`.
    """
    if tolerance is None:
        return system
    from kempe.assemble.nearest_exact import MEASURED, read_requested_tolerance

    mechanism = system.mechanism
    try:
        mechanism.tolerance = tolerance if tolerance == MEASURED else float(tolerance)
    except ValueError:
        raise InputError(
            f"--tolerance is {tolerance!r}; it must be a number or {MEASURED!r}"
        ) from None
    read_requested_tolerance(system, mechanism.tolerance)
    return mechanism.build()


# ---- assemblies and motions


@register_command(CLOSED, "out plot gif html deg json", "time_limit")
def run_assemble(
    system: System,
    output: Output,
    budget: Budget,
    known: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="NAME=VALUE",
            help=(
                "Known coordinates; or places of frames: tip=x,y[,z]; or a .csv file whose first "
                "line names coordinates."
            ),
        ),
    ] = None,
    start: options.Start = None,
    where: Annotated[
        list[str] | None,
        make_option(
            "--where",
            "Additional equation, angles in radians, such as 'A = 2*B'; can be repeated.",
            "EQUATION",
        ),
    ] = None,
    branch: Annotated[
        str | None,
        make_option("--branch", "A branch by its signs (see --modes), or a posture.", "+-..."),
    ] = None,
    modes: Annotated[
        bool, make_option("--modes", "All assembly modes, not only the one near the start.")
    ] = False,
    nearest: Annotated[
        bool,
        make_option("--nearest", "If freedoms are left, take the solution nearest to the start."),
    ] = False,
    continuous: Annotated[
        bool,
        make_option(
            "--continuous",
            "For the rows of a file: start each search at the extrapolation of the last two.",
        ),
    ] = False,
    no_limits: options.NoLimits = False,
    tolerance: options.Dimensions = None,
) -> None:
    """Close all loops: known coordinates in, all others out; with --where, under further equations.

    Example: kempe assemble four_bar A=30 --deg
    """
    from kempe.cli import arguments

    if modes and (branch is not None or nearest or continuous):
        raise InputError(
            "--modes gives all branches: leave --branch, --nearest and --continuous out"
        )
    if nearest and continuous:
        raise InputError("--nearest and --continuous are two ways to choose; give one of them")
    if budget.time_limit is not None and not modes:
        raise InputError("--time-limit is for --modes: one assembly takes milliseconds")
    system = _add_equations(_apply_tolerance(system, tolerance), where or [])
    values = arguments.parse_known_values(system, known or [], output.deg, frames=True)
    common: dict[str, Any] = {
        "start": arguments.read_start(system, start, output.deg),
        "limits": not no_limits,
    }
    answer: Any
    if modes:
        answer = call_until_interrupt(system.assembly_modes, values, budget=budget, **common)
    else:
        way = "nearest" if nearest else "continuous" if continuous else None
        answer = system.assemble(values, branch=branch, prefer=way, **common)
        if output.plot is not None and np.ndim(answer.success):
            raise InputError(
                f"{output.plot}: a picture shows one configuration, but the file of known values "
                "has several"
            )
    output.save_table(answer, found=bool(np.any(answer.success)))
    output.draw_configurations(system, answer, side_by_side=modes and 1 < len(answer) <= BESIDE)
    output.finish_command(answer)


def _add_equations(system: System, equations: list[str]) -> System:
    """Return the system with further equations, each named by its own text."""
    if not equations:
        return system
    mechanism = system.mechanism
    for text in dict.fromkeys(equations):
        # 'A' alone would be called as the joint
        mechanism.equation(text if "=" in text else f"{text} = 0", text)
    return mechanism.build()


@register_command(CLOSED, "out plot gif html deg json", "time_limit")
def run_trace(
    system: System,
    output: Output,
    budget: Budget,
    driver: Annotated[
        str | None, make_option("--driver", "Coordinate that drives the mechanism.", "NAME")
    ] = None,
    frame: options.Frames = None,
    start: options.Start = None,
    hold: options.Hold = None,
    branches: Annotated[
        bool, make_option("--branches", "Trace the branches met at bifurcations, too.")
    ] = False,
    points: Annotated[
        int | None,
        make_option("--points", "Write this many points, at equal distances of arc length.", "N"),
    ] = None,
    no_limits: options.NoLimits = False,
    clearance: options.Clearance = None,
    tolerance: options.Dimensions = None,
) -> None:
    """Follow a mechanism with one degree of freedom through its whole motion.

    With --clearance it ends before bodies come nearer. Files get arc length, all
    coordinates, and x, y (and z) of the frames. Ctrl-C or the time limit (120 s by default)
    ends the work with the part that was done.

    Example: kempe trace jansen --driver O --frame foot -o foot.csv --plot foot.png --gif foot.gif
    """
    from kempe.cli import arguments

    if points is not None and points < 2:
        raise InputError(f"--points is {points}; it must be at least 2")
    system = _apply_tolerance(system, tolerance)
    names = [system.structure.frame_name(f) for f in frame or ()]
    held = arguments.parse_known_values(system, hold or [], output.deg)
    begin, closing = arguments.find_motion_start(system, start, held, output.deg)
    if closing is not None and not closing:
        output.finish_command(closing)
    path: Motion = run_verb(
        "points traced",
        system.trace,
        driver,
        begin,
        hold=held,
        limits=not no_limits,
        clearance=arguments.make_clearance(clearance),
        ways="branches" if branches else "both",
        budget=budget,
    )
    others = tuple(replace(other, frames=names) for other in path.others)
    path = replace(path, frames=names, others=others)
    shown = path if points is None else _resample_path(path, points, budget)
    found = bool(path) or path.interrupted or path.late
    output.save_table(shown, found, branches=branches)
    output.draw_configurations(
        system, shown, lambda: _build_drawing(system, shown, names), frames=names
    )
    output.print_answers(shown)
    end_incomplete_command(shown if path else path)


def _resample_path(path: Motion, points: int, budget: Budget) -> Motion:
    """Return the path and its other branches with points at equal distances."""
    if len(path) < 2:
        return path
    found = run_verb("points", path.resample, points, budget=budget, count=points)
    if not found and path:  # broken off
        return found
    return replace(
        found, others=tuple(_resample_path(other, points, budget) for other in path.others)
    )


def _build_drawing(system: System, path: Motion, names: list[str]) -> Any:
    """Return the drawing of a path and its other branches; a row of NaN separates two curves."""
    gap = np.full((1, system.nq), np.nan)
    parts = [path.q, *(part for other in path.others for part in (gap, other.q))]
    all_of_it: Any = SimpleNamespace(q=np.vstack(parts), driver=path.driver, frames=path.frames)
    return system.plot(path=all_of_it, frames=names, ghosts=0 if names or len(path) < 2 else 5)


# ---- drawings and spaces


@register_command(CLOSED, "deg json")
def run_plot(
    system: System,
    output: Output,
    out: Annotated[
        Path | None,
        typer.Argument(metavar="OUT", help="Picture to write: .png, .svg or .pdf; or -o FILE."),
    ] = None,
    file_out: options.InPlace = None,
    q: options.Values = None,
    posture: options.Posture = None,
    frame: options.Frames = None,
    labels: Annotated[
        str | None,
        make_option(
            "--labels", "joints, frames, bodies, coordinates, parameters; or all.", "A,B,..."
        ),
    ] = None,
    axes: Annotated[
        list[str] | None,
        make_option(
            "--axes", "Frame whose axes are drawn and named, or all; can be repeated.", "NAME"
        ),
    ] = None,
    angles: Annotated[
        bool, make_option("--angles", "Draw each angle as an arc from its zero.")
    ] = False,
    dimensions: Annotated[bool, make_option("--dimensions", "Lengths of the links.")] = False,
    motion: Annotated[
        bool, make_option("--motion", "Arrows for the freedoms of the joints.")
    ] = False,
    workspace: Annotated[
        str | None, make_option("--workspace", "Shade the region that this frame reaches.", "NAME")
    ] = None,
    tree: Annotated[
        bool, make_option("--tree", "Draw the tree of bodies and joints instead.")
    ] = False,
) -> None:
    """Draw a system at a configuration, or its tree.

    Example: kempe plot two_link -o arm.png --q 30,50 --deg --axes all --angles --dimensions
    """
    from kempe.cli import arguments

    picture = choose_output_file(out, file_out)
    check_picture_file(picture)
    closing = None
    if tree:
        drawing = system.plot_tree()
    else:
        there, closing = arguments.read_configuration(system, q, posture, output.deg)
        drawing = system.plot(
            there,
            frames=frame or (),
            labels=True if labels is None else "all" if labels == "all" else labels.split(","),
            axes="all" if axes == ["all"] else axes or (),
            angles=angles,
            dimensions=dimensions,
            motion=motion,
            workspace=workspace,
        )
    output.save_picture(drawing, picture)
    output.print_answers()
    if closing is not None and not closing:
        print_remark(str(closing.status))
        raise typer.Exit(INCOMPLETE)


@register_command(CLOSED, "out plot deg json", "time_limit")
def run_spaces(
    system: System,
    output: Output,
    budget: Budget,
    frame: options.Frame = None,
    task: Annotated[
        str | None,
        make_option(
            "--task",
            "Task space to draw: xy, xz, yz, or direction (of the z axis of the frame).",
            "NAME",
        ),
    ] = None,
    position_only: options.PositionOnly = False,
    sample: Annotated[
        float | None,
        make_option(
            "--sample", "Number of random configurations to draw, uniform in a stated measure.", "N"
        ),
    ] = None,
    rng: options.Rng = None,
) -> None:
    """Describe the configuration space: dimension, components, samples; and the task space of a frame.

    With --plot both spaces of a system with two degrees of freedom are drawn beside one another;
    --frame names the frame of the task space.

    Example: kempe spaces two_link --frame e --sample 1000 -o q.csv --plot spaces.png
    """
    if output.out is not None and sample is None:
        raise InputError(f"{output.out}: --sample says how many configurations are written")
    if output.plot is not None and frame is None:
        raise InputError(f"{output.plot}: --frame says whose task space is drawn")
    if task is not None and output.plot is None:
        raise InputError("--task says what --plot draws: give it a file")
    if position_only and frame is None:
        raise InputError("--position-only is about the task space of a frame: --frame names it")
    space = system.configuration_space
    answers: dict[str, Any] = {"configuration_space": space}
    answers["components"] = call_until_interrupt(space.components, budget=budget)
    if frame is not None:
        answers["task_space"] = system.task_space(
            frame, task="position" if position_only else "pose"
        )
    if sample is not None:
        answers["sample"] = call_until_interrupt(space.sample, sample, rng or 0, budget=budget)
    if output.plot is not None:
        axes = run_verb("places", system.plot_spaces, frame, task=task, budget=budget)
        output.save_picture(axes, output.plot)
    if "sample" in answers:
        output.save_table(answers["sample"])
    output.print_answers(**answers)
    if answers["components"].late or not answers.get("sample", space):
        raise typer.Exit(INCOMPLETE)
