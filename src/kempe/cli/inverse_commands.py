"""Commands for inverse kinematics: one or all configurations, and the method for a chain."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from kempe.answers.targets import choose_task
from kempe.arguments import call_until_interrupt
from kempe.budget import Budget
from kempe.cli.app import (
    OPEN,
    All,
    Axis,
    FrameOrTasks,
    Hold,
    Output,
    PathTargets,
    PathTolerance,
    PositionOnly,
    Prefer,
    Rng,
    Seed,
    TargetOrTasks,
    Task,
    Tasks,
    TimeLimit,
    Tolerance,
    make_option,
    register_command,
)
from kempe.cli.terminal import UsageError
from kempe.errors import InputError

if TYPE_CHECKING:
    from kempe.cli.task_file import FileTasks
    from kempe.system import System


@register_command(OPEN, "out plot gif html deg json")
def run_ik(
    system: System,
    output: Output,
    frame: FrameOrTasks = None,
    target: TargetOrTasks = None,
    tasks: Tasks = None,
    position_only: PositionOnly = False,
    seed: Seed = None,
    rng: Rng = None,
    tolerance: Tolerance = None,
    all: All = False,
    task: Task = None,
    axis: Axis = None,
    hold: Hold = None,
    prefer: Prefer = None,
) -> None:
    """Find a configuration that brings a frame to a pose, or all of them, or one that holds several
    tasks.

    Example: kempe ik panda.urdf --frame panda_hand_tcp --target 0.4,0.1,0.5,180,0,0 --deg
    """
    from kempe.cli import arguments

    if all and rng is not None:
        raise InputError("--rng is for a search: leave --all out")
    if hold is not None and not all:
        raise InputError("--hold is for all solutions: add --all")
    single = {"--frame": frame, "--target": target}
    more = {"--task": task, "--axis": axis, "--position-only": position_only, "--all": all}
    _refuse_frame_with_tasks(tasks, single, more)
    if prefer is not None and tasks is None:
        raise InputError(
            "--prefer is for --tasks: it says what is made least in what they leave free"
        )
    deg = output.deg
    if frame is not None:
        system.structure.frame_name(frame)  # a wrong name is reported before kernels are compiled
    options: dict[str, Any] = {}
    if frame is None or target is None:
        wanted: Any = _read_tasks(system, tasks, deg).tasks
        options["prefer"] = prefer
    else:
        wanted, position = arguments.read_target(system, target, deg)
        options["task"] = _choose_task(task, axis, position or position_only)
    start = (
        None if seed is None else arguments.read_configurations(system, seed, None, deg, start=True)
    )
    if all:
        answer: Any = system.ik_all(
            wanted,
            frame or "",
            start,
            fixed=arguments.parse_known_values(system, hold or [], deg, frames=False),
            tolerance=None if tolerance is None else arguments.parse_single_tolerance(tolerance),
            **options,
        )
    else:
        errors = arguments.parse_tolerance("1e-6" if tolerance is None else tolerance)
        spend = Budget(rng=rng)
        answer = system.ik(wanted, frame, start=start, tolerance=errors, budget=spend, **options)
    output.save_table(answer)
    output.draw_configurations(system, answer)
    output.finish_command(answer)


def _refuse_frame_with_tasks(
    tasks: Path | None, single: dict[str, Any], more: dict[str, Any]
) -> None:
    """Raise `UsageError` if the user gives both a frame with a target and a file of tasks."""
    if tasks is not None:
        wrong = [name for name, value in {**single, **more}.items() if value]
        if wrong:
            raise InputError(f"--tasks says all that is wanted: leave {wrong[0]} out")
        return
    missing = [name for name, value in single.items() if value is None]
    if missing:
        raise UsageError(f"Missing option '{missing[0]}', or '--tasks' in place of both.")


def _read_tasks(system: System, path: Path | None, deg: bool) -> FileTasks:
    """Return the tasks of a TOML file."""
    from kempe.cli import task_file

    assert path is not None
    return task_file.read_tasks(system, path, deg)


def _choose_task(task: str | None, axis: str | None, position: bool) -> Any:
    """Return which part of the target counts, with the tool's axis where the task points one.

    Where the target is a position, the position alone counts unless a task is given.

    Where the target is a position, the position alone counts unless a task is given.
    """
    choose_task(task, position, False)  # a wrong name is reported first
    if position and task not in (None, "position"):
        raise InputError(f"--task {task} needs a target with an orientation: x,y,z,roll,pitch,yaw")
    return make_task_argument("position" if position else task, axis)


def make_task_argument(task: str | None, axis: str | None) -> Any:
    """Return the argument `task` of the library: a task, perhaps with the tool's axis."""
    from kempe.cli import arguments

    if axis is None:
        return task
    if task not in ("direction", "position_axis"):
        raise InputError("--axis is for the tasks direction and position_axis")
    return task, arguments.parse_axis(axis)


@register_command(OPEN, "out plot gif html deg json")
def run_path(
    system: System,
    output: Output,
    frame: FrameOrTasks = None,
    target: PathTargets = None,
    tasks: Tasks = None,
    seed: Seed = None,
    position_only: PositionOnly = False,
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
    rng: Rng = None,
    tolerance: PathTolerance = None,
    time_limit: TimeLimit = None,
) -> None:
    """Follow a sequence of targets without a jump, or say where and why that cannot be.

    Ctrl-C ends the work with what was done, as a time limit does (600 s, unless another is given).

    Example: kempe path panda.urdf --frame panda_hand_tcp --targets weld.csv -o q.csv
    """
    from kempe.cli import arguments, progress

    single = {"--frame": frame, "--targets": target}
    _refuse_frame_with_tasks(tasks, single, {"--position-only": position_only})
    deg = output.deg
    start = (
        None if seed is None else arguments.read_configurations(system, seed, None, deg, start=True)
    )
    wanted: Any
    if frame is None or target is None:
        read = _read_tasks(system, tasks, deg)
        wanted = read.tasks
        count = read.rows
    else:
        system.structure.frame_name(frame)
        wanted, position = arguments.read_target(system, target, deg)
        count = len(wanted) if wanted.ndim > 2 else None
        wanted = wanted[..., :3, 3] if position or position_only else wanted
    if count is None:
        raise InputError("a path needs a .csv or .npy file of targets, one a row")
    options: dict[str, Any] = {"restart": restart, "branches": branches}
    options |= {} if max_step is None else {"max_step": max_step}
    options |= {} if tolerance is None else {"tolerance": arguments.parse_tolerance(tolerance)}
    with progress.show_progress("targets", count) as report:
        spend = Budget(rng=rng, time_limit=time_limit, progress=report)
        answer = call_until_interrupt(system.ik_path, wanted, frame, start, **options, budget=spend)
    output.save_table(answer)
    output.draw_configurations(system, answer, frames=[] if frame is None else [frame])
    output.finish_command(answer)


@register_command(OPEN)
def run_plan(
    system: System,
    output: Output,
    frame: Annotated[
        str, make_option("--frame", "Body or frame that shall reach targets.", "NAME")
    ],
    task: Task = None,
    axis: Axis = None,
    hold: Annotated[
        list[str] | None,
        make_option(
            "--hold", "Joint that is held, as for ik --all; can be repeated.", "NAME[=VALUE]"
        ),
    ] = None,
) -> None:
    """Say what a chain's axes have in common, and how all its configurations are found.

    Example: kempe plan panda.urdf --frame panda_hand_tcp
    """
    from kempe.cli import arguments

    system.structure.frame_name(frame)
    words = [w if "=" in w else f"{w}=0" for w in hold or []]
    held = tuple(arguments.parse_known_values(system, words, False, frames=False))
    output.finish_command(system.inverse.plan(frame, make_task_argument(task, axis), held))
