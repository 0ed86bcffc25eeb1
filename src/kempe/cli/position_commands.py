"""Commands about where frames are and what they reach: fk, ik, paths, workspaces, lists of poses."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, cast

import numpy as np
import typer

from kempe.budget import Budget
from kempe.cli import options
from kempe.cli.app import OPEN, Output, register_command
from kempe.cli.options import make_option
from kempe.cli.progress import run_verb
from kempe.cli.terminal import INCOMPLETE, UsageError, print_json, print_remark
from kempe.errors import InputError
from kempe.words import DEGREE, format_count, join_first_words, make_plural

if TYPE_CHECKING:
    from collections.abc import Mapping

    from matplotlib.axes import Axes

    from kempe.spatial import Array
    from kempe.system import System

# ---- forward and inverse model


@register_command(OPEN, "out plot gif html deg json")
def run_fk(
    system: System,
    output: Output,
    frame: options.FrameOrAll = None,
    q: options.Values = None,
    posture: options.Posture = None,
) -> None:
    """Compute the pose of a frame, or of all bodies (forward kinematics).

    Example: kempe fk panda.urdf --frame panda_hand_tcp --q 0,-45,0,-135,0,90,45,0.04 --deg
    """
    from kempe.cli import arguments
    from kempe.views import facts

    values = arguments.read_configurations(system, q, posture, output.deg)
    poses = facts.Poses(system, frame, system.fk(values, frame))
    output.save_table(poses)
    output.draw_configurations(system, values, frames=[] if frame is None else [frame])
    output.print_answers(poses)
    bad = np.flatnonzero(~np.isfinite(values).all(axis=-1)).tolist() if values.ndim > 1 else []
    if bad:
        rows = f"{make_plural(len(bad), 'row')} {join_first_words([str(i) for i in bad], 12)}"
        print_remark(f"q is not finite in {rows}; poses there are NaN")
    if gap := facts.describe_largest_gap(system, values):
        print_remark(f"loops are open here, {gap}: kempe assemble closes them")
    if bad:
        raise typer.Exit(INCOMPLETE)


@register_command(OPEN, "out deg json")
def run_clearance(
    system: System,
    output: Output,
    q: options.Values = None,
    posture: options.Posture = None,
) -> None:
    """Find the bodies that are nearest to one another, by their collision shapes.

    The exit code is 1 where two bodies overlap.

    Without --q and --posture the neutral configuration is taken, and a line says so.

    Example: kempe clearance panda.urdf --q 0,-45,0,-135,0,90,45,0.04 --deg
    """
    from kempe.cli import arguments
    from kempe.views import facts

    values = arguments.read_configurations(system, q, posture, output.deg)
    if q is None and posture is None:
        outside = facts.list_outside_limits(system, values)
        beyond = f", outside the limits of {join_first_words(outside, 6)}" if outside else ""
        print_remark(f"without --q: at the neutral configuration{beyond}")
    answer = system.geometry.nearest(values)
    output.save_table(answer)
    output.print_answers(answer)
    if (answer.distance <= 0.0).any():
        raise typer.Exit(INCOMPLETE)


@register_command(OPEN, "out plot gif html deg json")
def run_ik(
    system: System,
    output: Output,
    frame: options.Frame = None,
    target: options.Target = None,
    tasks: options.TaskFile = None,
    position_only: options.PositionOnly = False,
    start: options.Start = None,
    rng: options.Rng = None,
    tolerance: options.Tolerance = None,
    all: Annotated[
        bool,
        make_option(
            "--all", "All configurations that reach the target, in closed form or by elimination."
        ),
    ] = False,
    task: options.Task = None,
    axis: options.Axis = None,
    hold: options.Hold = None,
    prefer: Annotated[
        str | None,
        make_option(
            "--prefer",
            "Choice among the configurations that satisfy the tasks: 'nearest', 'mid' or 'manipulability'.",
            "WHAT",
        ),
    ] = None,
    clearance: options.Clearance = None,
) -> None:
    """Find a configuration that brings a frame to a pose, or with --all every one (of a redundant
    chain with some joints held, see --hold), or one that satisfies several tasks.

    With --clearance, bodies and obstacles keep a distance.

    Example: kempe ik panda.urdf --frame panda_hand_tcp --target 0.4,0.1,0.5,180,0,0 --deg
    """
    from kempe.cli import arguments
    from kempe.inverse.ik import make_frame_tasks

    if all and rng is not None:
        raise InputError("--rng is for a search: leave --all out")
    if hold is not None and not all:
        raise InputError("--hold is for all solutions: add --all")
    if prefer is not None and tasks is None:
        raise InputError(
            "--prefer needs --tasks: it chooses among the configurations that satisfy them"
        )
    only = {"--task": task, "--axis": axis, "--position-only": position_only, "--all": all}
    wanted, _ = _read_wanted(system, output.deg, frame, target, tasks, position_only, only)
    common: dict[str, Any] = {
        "start": arguments.read_start(system, start, output.deg),
        "tolerance": arguments.parse_single_or_several(tolerance, "tolerance"),
        "task": arguments.make_task_argument(task, axis),
    }
    keep: Any = arguments.make_clearance(clearance)
    if all:
        held = arguments.parse_known_values(system, hold or [], output.deg)
        answer: Any = system.ik_all(wanted, frame or "", fixed=held, clearance=keep, **common)
    elif keep is not None:
        task_of_frame = common.pop("task")
        tasks_held = (
            wanted if frame is None else make_frame_tasks(system, wanted, frame, task_of_frame)
        )
        answer = system.ik(
            [*tasks_held, keep],
            prefer=cast("Any", prefer),
            budget=Budget(rng=rng),
            **common,
        )
    else:
        answer = system.ik(
            wanted, frame, prefer=cast("Any", prefer), budget=Budget(rng=rng), **common
        )
    output.save_table(answer)
    output.draw_configurations(system, answer)
    output.finish_command(answer)


@register_command(OPEN, "out plot gif html deg json", "rng time_limit")
def run_path(
    system: System,
    output: Output,
    budget: Budget,
    frame: options.Frame = None,
    target: options.Target = None,
    tasks: options.TaskFile = None,
    start: options.Start = None,
    position_only: options.PositionOnly = False,
    max_step: Annotated[
        float | None,
        make_option("--max-step", "Largest step, radians and characteristic lengths (0.5).", "X"),
    ] = None,
    restart: Annotated[
        bool, make_option("--restart", "Where the path stops, go on by a jump.")
    ] = False,
    branches: Annotated[
        bool, make_option("--branches", "Try several starts; the best path is the answer.")
    ] = False,
    cost: Annotated[
        str,
        make_option(
            "--cost", "Cost that the best path minimises: motion, limits or singularities.", "WORD"
        ),
    ] = "motion",
    closed: Annotated[
        bool, make_option("--closed", "Return to the first configuration at the end of the path.")
    ] = False,
    tolerance: options.Tolerance = None,
    clearance: options.Clearance = None,
) -> None:
    """Follow a sequence of targets without a jump, or report where and why no continuous path exists.

    With --clearance, bodies keep a distance at the targets and between them.

    Ctrl-C or the time limit (600 s by default) ends the work with the part that was done.

    Example: kempe path panda.urdf --frame panda_hand_tcp --targets weld.csv -o q.csv
    """
    from kempe.cli import arguments

    only = {"--position-only": position_only}
    wanted, count = _read_wanted(system, output.deg, frame, target, tasks, position_only, only)
    if count is None:
        raise InputError("a path needs a .csv or .npy file of targets, one a row")
    answer = run_verb(
        "targets",
        system.ik_path,
        wanted,
        frame,
        arguments.read_start(system, start, output.deg),
        restart=restart,
        branches=branches,
        cost=cost,
        closed=closed,
        clearance=arguments.make_clearance(clearance),
        tolerance=arguments.parse_single_or_several(tolerance, "tolerance"),
        budget=budget,
        count=count,
        **({} if max_step is None else {"max_step": max_step}),
    )
    output.save_table(answer)
    output.draw_configurations(system, answer, frames=[] if frame is None else [frame])
    output.finish_command(answer)


def _read_wanted(
    system: System,
    degrees: bool,
    frame: str | None,
    target: str | None,
    tasks: Path | None,
    position_only: bool,
    only: Mapping[str, object],
) -> tuple[Any, int | None]:
    """Return the targets of a frame, or the tasks of a file, and their number if there are several.

    Errors: `UsageError` where neither is given; `InputError` where `tasks` and options `only` for a
    frame are.
    """
    from kempe.cli import arguments, task_file

    given = {"--frame": frame, "--target": target}
    if tasks is not None:
        if wrong := [name for name, value in {**given, **only}.items() if value]:
            raise InputError(f"--tasks says all that is wanted: leave {wrong[0]} out")
        return task_file.read_tasks(system, tasks, degrees)
    if missing := [name for name, value in given.items() if value is None]:
        raise UsageError(f"Missing option '{missing[0]}', or '--tasks' in place of both.")
    X, is_position = arguments.read_target(system, target or "", degrees)
    count = len(X) if X.ndim > 2 else None
    return X[..., : system.dim, 3] if is_position or position_only else X, count


@register_command(OPEN)
def run_plan(
    system: System,
    output: Output,
    frame: options.OneFrame,
    task: options.Task = None,
    axis: options.Axis = None,
    hold: options.Hold = None,
) -> None:
    """Describe how the axes of a chain lie, and the method that finds all its configurations.

    Example: kempe plan panda.urdf --frame panda_hand_tcp
    """
    from kempe.cli import arguments

    held = tuple(word.partition("=")[0] for word in hold or [])
    wanted = arguments.make_task_argument(task, axis)
    output.finish_command(system.inverse.plan(frame, wanted, held))


# ---- workspaces, and files larger than memory


@register_command(OPEN, "plot deg json", "rng threads time_limit")
def run_workspace(
    system: System,
    output: Output,
    budget: Budget,
    frame: options.OneFrame,
    n: Annotated[
        float | None,
        make_option("-n,--samples", "Number of samples, such as 1e8 (default 1e7).", "N"),
    ] = None,
    cells: Annotated[
        str | None,
        make_option("--cells", "Cells along the longest edge, or along each: 64 or 64,64,32.", "N"),
    ] = None,
    box: Annotated[
        str | None,
        make_option(
            "--box", "Box in the unit of FILE: xmin,xmax,ymin,ymax[,zmin,zmax].", "NUMBERS"
        ),
    ] = None,
    kind: Annotated[
        str | None,
        make_option(
            "--kind",
            "Kind of workspace: reachable, constant-orientation, dexterous or orientation.",
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
    scheduler: options.Scheduler = None,
) -> None:
    """Show what a frame reaches, by any number of random configurations, or in one orientation or
    all of them.

    Ctrl-C or the time limit ends it with what was done; with -o the same command goes on from
    there.

    Example: kempe workspace panda --frame tool -n 1e8 -o map.zarr --plot map.png
    """
    from kempe.cli.arguments import parse_finite_numbers

    along = None if cells is None else parse_finite_numbers(cells, "--cells")
    whole = [int(x) if x == int(x) else x for x in along or ()]
    ends = None if box is None else parse_finite_numbers(box, "--box")
    if ends is not None and len(ends) % 2:
        raise InputError(
            f"--box has {format_count(len(ends), 'number')}; it needs two for each axis"
        )
    answer = run_verb(
        "samples",
        system.workspace,
        frame,
        kind=kind,
        orientation=None
        if orientation is None
        else _parse_orientation(orientation, "--orientation", output.deg),
        at=None if at is None else parse_finite_numbers(at, "--at"),
        n=n,
        cells=None if along is None else whole[0] if len(whole) == 1 else whole,
        box=None if ends is None else np.reshape(ends, (-1, 2)),
        client=scheduler,
        path=out,
        budget=budget,
    )
    if out is not None and out.exists():
        output.written.append(out)
    output.draw_configurations(system, None, answer.plot)
    output.finish_command(answer)


def _parse_orientation(text: str, what: str, degrees: bool) -> Any:
    """Return an angle, several angles, or roll, pitch and yaw, from text.

    Errors: `InputError`.
    """
    from kempe.cli.arguments import parse_finite_numbers

    angles = [x * DEGREE if degrees else x for x in parse_finite_numbers(text, what)]
    return angles[0] if len(angles) == 1 else angles


@register_command(OPEN, "deg json", context_settings={"ignore_unknown_options": True})
def run_query(
    output: Output,
    path: Annotated[
        Path, typer.Argument(metavar="MAP", help="A map that 'kempe workspace' wrote.")
    ],
    points: Annotated[
        list[str],
        typer.Argument(
            metavar="POINT...", help="Points x,y[,z] in the unit of the map, in the ground frame."
        ),
    ],
) -> None:
    """Test whether points are reached, and measure how far they are from the boundary.

    The exact boundary decides if it is known, else the map if all cells around the point have
    samples, else inverse kinematics. Points of a map of orientations are orientations: an angle in
    the plane, roll,pitch,yaw in space.

    Example: kempe query map.zarr 0.3,0.2,0.5 0.9,0,0
    """
    from kempe.cli.arguments import parse_finite_numbers
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
        turns = [_parse_orientation(p, "a point", output.deg) for p in points]
        inside = [bool(space.contains(read_rotations(turn, dim))) for turn in turns]
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
    unit = space.system.unit
    edge = "the exact boundary" if not off else f"the boundary of the map (+- {off:.2g} {unit})"
    for p, i, f in zip(points, inside, far, strict=True):
        beside = (
            "" if turned else f", {abs(f):.4g} {unit} {'inside' if f >= 0 else 'outside'} {edge}"
        )
        print(f"{p}: {'reached' if i else 'not reached'}{beside}")


@register_command(OPEN, "deg json", "rng threads time_limit")
def run_map(
    verb: Annotated[str, typer.Argument(metavar="VERB", help="fk, ik, ik_all or assemble.")],
    system: System,
    output: Output,
    budget: Budget,
    rows: Annotated[
        Path,
        typer.Argument(
            metavar="ROWS", help="A .parquet, .npy or .csv file, or Zarr, with one problem a row."
        ),
    ],
    out: Annotated[
        Path, make_option("-o,--out", "The answers to write or to go on with (Zarr).", "ANSWERS")
    ],
    frame: options.FrameOrAll = None,
    columns: Annotated[
        str | None,
        make_option("--columns", "Columns to read, or names for columns without names.", "A,B,..."),
    ] = None,
    form: Annotated[
        str | None,
        make_option(
            "--form",
            "Form of the poses of fk: matrix (default), 3x4, position or position_quat_wxyz.",
            "FORM",
        ),
    ] = None,
    float32: Annotated[
        bool, make_option("--float32", "Write the poses of fk as 32-bit numbers.")
    ] = False,
    task: options.Task = None,
    axis: options.Axis = None,
    start: options.Start = None,
    tolerance: options.Tolerance = None,
    scheduler: options.Scheduler = None,
) -> None:
    """Answer each row of a file of any size, in chunks, so that it can be stopped and continued.

    With --deg angles of ROWS are degrees; what is written is in radians. Ctrl-C or the time limit
    ends it with what was done; the same command goes on from there.

    Example: kempe map ik panda targets.parquet -o q.zarr --frame tool
    """
    import kempe
    from kempe.cli import arguments

    errors = arguments.parse_single_or_several(tolerance, "tolerance")
    if verb != "ik" and isinstance(errors, list):
        raise InputError(f"--tolerance is {tolerance!r}; of {verb} it is one number")
    given = {
        "form": form,
        "dtype": "float32" if float32 else None,
        "task": arguments.make_task_argument(task, axis),
        "start": arguments.read_start(system, start, output.deg),
        "tolerance": errors,
    }
    answer = run_verb(
        "rows",
        kempe.map_file,
        system,
        verb,
        rows,
        out,
        frame,
        columns=None if columns is None else [name.strip() for name in columns.split(",")],
        degrees=output.deg,
        client=scheduler,
        options={name: value for name, value in given.items() if value is not None},
        budget=budget,
    )
    output.finish_command(answer)


# ---- singular configurations, lists of poses, placement of the base


@register_command(OPEN, "out plot gif html deg json", "starts rng time_limit")
def run_singularities(
    system: System,
    output: Output,
    budget: Budget,
    frame: options.Frame = None,
    task: Annotated[
        str | None,
        make_option(
            "--task",
            "Part of the motion of the frame: pose, position, orientation, xy, xz, yz or direction.",
            "TASK",
        ),
    ] = None,
    inputs: Annotated[
        str | None,
        make_option(
            "--inputs", "Driven coordinates of closed loops (default: those of FILE).", "A,B"
        ),
    ] = None,
    at: Annotated[
        list[str] | None,
        make_option(
            "--at",
            "Configuration to which the nearest singular one is sought; can be repeated.",
            "NAME=VALUE",
        ),
    ] = None,
    no_limits: options.NoLimits = False,
) -> None:
    """Find the singular configurations of a frame, or of closed loops, and how far the nearest is.

    --plot draws some, with the directions that the frame loses and gains there, and planar curves
    of them, as far as these are followed within the time limit or until Ctrl-C; --gif and --html
    show one of each set; -o writes all.

    Example: kempe singularities puma560 --frame tool --at q5=0.2
    """
    from kempe.cli import arguments
    from kempe.numerics.clock import TimeLimit

    time = TimeLimit(budget.time_limit)
    driving = arguments.parse_joint_names(system, "--inputs", inputs)
    near, closing = arguments.read_configuration(
        system, ",".join(at) if at else None, None, output.deg
    )
    if closing is not None and not closing:
        raise InputError(f"--at cannot be closed: {closing.status}")
    answer = run_verb(
        "starts",
        system.singularities,
        frame,
        task,
        inputs=driving,
        limits=not no_limits,
        budget=budget,
    )
    broken: list[str] = []

    def draw_curves() -> tuple[Axes, ...]:
        """Draw the singular curves of the frame."""
        from kempe.views.singular_plot import find_shown_curves, plot_singularities

        left = Budget(time_limit=time.remaining_seconds)
        curves = run_verb("configurations of curves", find_shown_curves, answer, budget=left)
        if curves is not None and curves.broken:
            broken.append(curves.status)
        return plot_singularities(answer, curves)

    output.save_table(answer)
    each = np.reshape([s.q[0] for s in answer.sets], (-1, system.nq))
    output.draw_configurations(system, each, draw_curves)
    for why in broken:
        print_remark(why)
    output.finish_command(answer, **({} if near is None else {"nearest": answer.nearest(near)}))
    if broken:
        raise typer.Exit(INCOMPLETE)


@register_command(OPEN, "out plot gif html deg json", "starts rng time_limit")
def run_reach(
    system: System,
    output: Output,
    budget: Budget,
    poses: options.Poses,
    frame: options.OneFrame,
    position_only: options.PositionOnly = False,
    clearance: options.Clearance = None,
) -> None:
    """Test which poses of a list are reached, how well, and what blocks the others.

    With --clearance, bodies must keep this distance there.

    Example: kempe reach ur5 weld.csv --frame tool
    """
    from kempe.cli.arguments import make_clearance

    X, task = _read_poses(system, poses, position_only, output.deg)
    keep = make_clearance(clearance)
    answer = run_verb(
        "poses", system.reach.poses, X, frame, task=task, clearance=keep, budget=budget
    )
    output.save_table(answer)
    output.draw_configurations(system, answer.q[answer.reached], answer.plot)
    output.finish_command(answer)


@register_command(OPEN, "plot deg json", "starts rng time_limit")
def run_place(
    system: System,
    output: Output,
    budget: Budget,
    poses: options.Poses,
    frame: options.OneFrame,
    box: Annotated[
        list[str],
        make_option(
            "--box",
            "Range of a coordinate of the base: x, y, z or yaw; can be repeated.",
            "NAME=LOW,HIGH",
        ),
    ],
    cells: Annotated[
        int, make_option("--cells", "Number of values tried in each range (11).", "N")
    ] = 11,
    position_only: options.PositionOnly = False,
) -> None:
    """Find where to put the base so that all poses of a list are reached.

    Example: kempe place ur5 weld.csv --frame tool --box x=-1,1 --box y=-1,1 --box z=0.2
    """
    from kempe.cli import arguments

    X, task = _read_poses(system, poses, position_only, output.deg)
    ranges: dict[str, Any] = {}
    for name, text in arguments.parse_assignments(box, "--box").items():
        factor = DEGREE if output.deg and name == "yaw" else 1.0
        numbers = [x * factor for x in arguments.parse_numbers(text, f"--box {name}")]
        ranges[name] = numbers[0] if len(numbers) == 1 else numbers
    answer = run_verb(
        "poses", system.reach.place, X, frame, ranges, cells, task=task, budget=budget
    )
    output.draw_configurations(system, None, answer.plot)
    output.finish_command(answer)


def _read_poses(
    system: System, text: str, position_only: bool, degrees: bool
) -> tuple[Array, str | None]:
    """Return the poses (n, 4, 4) of a file, and the task.

    Errors: `InputError`.
    """
    from kempe.cli import arguments

    if not arguments.is_table_file(text):
        raise InputError(f"POSES is {text!r}; it must be a .csv or .npy file of poses, one a row")
    X, is_position = arguments.read_target(system, text, degrees)
    return X.reshape(-1, 4, 4), "position" if is_position or position_only else None
