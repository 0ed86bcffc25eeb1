"""Commands for inverse models: one configuration, all of them, and how these are found."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from kempe.arguments import until_interrupt
from kempe.budget import Budget
from kempe.cli.app import (
    OPEN,
    All,
    Axis,
    Deg,
    File,
    Film,
    FrameOrTasks,
    Hold,
    Json,
    Out,
    Page,
    PathTargets,
    PathTolerance,
    Picture,
    PositionOnly,
    Prefer,
    Reading,
    Rng,
    Seed,
    TargetOrTasks,
    Task,
    Tasks,
    TimeLimit,
    Tolerance,
    app,
    drawable,
    drawn,
    load,
    option,
    reads_file,
    results,
    say_written,
)
from kempe.cli.terminal import INCOMPLETE, UsageError, guarded, leave, print_json, show
from kempe.errors import InputError

if TYPE_CHECKING:
    from kempe.assemble.modes import Modes
    from kempe.cli.arguments import FileTasks
    from kempe.system import System

SLICE = 4096
TASK_SLICE = 256
"""Targets that are solved at once: between them the work shows how far it is, and can be
stopped."""


@app.command(rich_help_panel=OPEN)
@guarded
@reads_file
def ik(
    file: File,
    reading: Reading,
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
    deg: Deg = False,
    out: Out = None,
    plot: Picture = None,
    gif: Film = None,
    html: Page = None,
    json: Json = False,
) -> None:
    """Find a configuration that brings a frame to a pose, or all of them, or one that holds several
    tasks.

    Targets of a file are solved in slices; Ctrl-C ends the work with what was done.

    Example: kempe ik panda.urdf --frame panda_hand_tcp --target 0.4,0.1,0.5,180,0,0 --deg
    """
    given = {"--hold": hold} if not all else {"--rng": rng}
    wrong = [name for name, value in given.items() if value is not None]
    if wrong:
        raise InputError(
            f"{wrong[0]} is for "
            f"{'all solutions: add --all' if not all else 'a search: leave --all out'}"
        )
    single = {"--frame": frame, "--target": target}
    _one_way(
        tasks,
        single,
        {"--task": task, "--axis": axis, "--position-only": position_only, "--all": all},
    )
    if prefer is not None and tasks is None:
        raise InputError(
            "--prefer is for --tasks: it says what is made least in what they leave free"
        )
    system = load(file, reading)
    from kempe.cli import table_files

    results(out, target)
    drawable(plot, gif, html)
    errors = (
        (0.0, 0.0) if all else table_files.tolerance("1e-6" if tolerance is None else tolerance)
    )

    def draw(answer: Any) -> list[Path]:
        return drawn(system, answer, plot, gif, html)

    if frame is None or target is None:
        read = _read_tasks(system, tasks, deg)
        start = (
            None if seed is None else table_files.configuration(system, seed, None, deg, start=True)
        )
        _answer(
            system,
            read.count,
            TASK_SLICE,
            lambda i, j: system.ik(
                read.tasks(i, j),
                start=_part(start, i, j),
                tolerance=errors,
                prefer=prefer,
                budget=Budget(rng=rng),
            ),
            deg,
            out,
            draw,
            json,
        )
        return
    system.structure.frame_name(frame)  # a wrong name is reported before kernels are compiled
    X, position = table_files.target(system, target, deg)
    start = None if seed is None else table_files.configuration(system, seed, None, deg, start=True)
    position = position or position_only
    task = _task(task, position)
    if all:
        _all(system, X, frame, task, axis, hold, start, tolerance, deg, out, draw, json)
        return
    wanted: dict[str, Any] = {
        "tolerance": errors,
        "budget": Budget(rng=rng),
        "task": task_argument(task, axis),
    }
    _answer(
        system,
        len(X) if X.ndim > 2 else None,
        SLICE,
        lambda i, j: system.ik(
            X[i:j] if X.ndim > 2 else X, frame, start=_part(start, i, j), **wanted
        ),
        deg,
        out,
        draw,
        json,
    )


def _one_way(tasks: Path | None, single: dict[str, Any], more: dict[str, Any]) -> None:
    """Refuse what does not go together: a frame with its target, or a file of tasks."""
    if tasks is not None:
        wrong = [name for name, value in {**single, **more}.items() if value]
        if wrong:
            raise InputError(f"--tasks says all that is wanted: leave {wrong[0]} out")
        return
    missing = [name for name, value in single.items() if value is None]
    if missing:
        raise UsageError(f"Missing option '{missing[0]}', or '--tasks' in place of both.")


def _read_tasks(system: System, path: Path | None, deg: bool) -> FileTasks:
    from kempe.cli import arguments

    assert path is not None
    return arguments.read(system, path, deg)


def _part(seed: Any, i: int, j: int | None) -> Any:
    """The seeds of targets i to j."""
    return seed[i:j] if seed is not None and seed.ndim > 1 else seed


def _answer(
    system: System,
    count: int | None,
    size: int,
    solve: Callable[[int, int | None], Any],
    deg: bool,
    out: Path | None,
    draw: Callable[[Any], list[Path]],
    json: bool,
) -> None:
    """Solve, for one target or `count` of them, and print or write the answer."""
    from kempe.cli import as_json, progress, report, table_files

    if count is None or count <= size:
        answer = solve(0, count)
    else:
        with progress.progress(sys.stderr, count) as said:
            answer = progress.in_slices(system, count, size, solve, said)
    if out is not None:
        table_files.write_configurations(out, system, answer.q, deg)
    pictures = draw(answer)
    if json:
        print_json(as_json.answer_facts(answer, deg))
    else:
        show(report.solution(system, answer, deg) if out is None else report.outcome(answer))
        _say_all(out, pictures)
    leave(answer)


def _say_all(out: Path | None, pictures: list[Path]) -> None:
    """Say which files were written."""
    for path in ([] if out is None else [out]) + pictures:
        say_written(path, False)


@app.command(rich_help_panel=OPEN)
@guarded
@reads_file
def path(
    file: File,
    reading: Reading,
    frame: FrameOrTasks = None,
    target: PathTargets = None,
    tasks: Tasks = None,
    seed: Seed = None,
    position_only: PositionOnly = False,
    max_step: Annotated[
        float | None,
        option("--max-step", "Largest step, radians and characteristic lengths (0.5).", "X"),
    ] = None,
    restart: Annotated[bool, option("--restart", "Where the path stops, go on by a jump.")] = False,
    branches: Annotated[
        bool, option("--branches", "Try several starts; the best path is the answer.")
    ] = False,
    rng: Rng = None,
    tolerance: PathTolerance = None,
    time_limit: TimeLimit = None,
    deg: Deg = False,
    out: Out = None,
    plot: Picture = None,
    gif: Film = None,
    html: Page = None,
    json: Json = False,
) -> None:
    """Follow a sequence of targets without a jump, or say where and why that cannot be.

    Ctrl-C ends the work with what was done, as a time limit does (600 s, unless another is given).

    Example: kempe path panda.urdf --frame panda_hand_tcp --targets weld.csv -o q.csv
    """
    _one_way(tasks, {"--frame": frame, "--targets": target}, {"--position-only": position_only})
    system = load(file, reading)
    from kempe.cli import as_json, ik_report, progress, table_files

    results(out, target)
    drawable(plot, gif, html)
    start = None if seed is None else table_files.configuration(system, seed, None, deg, start=True)
    wanted: Any
    if frame is None or target is None:
        read = _read_tasks(system, tasks, deg)
        wanted = read.tasks()
        count = read.count
    else:
        system.structure.frame_name(frame)
        wanted, position = table_files.target(system, target, deg)
        count = len(wanted) if wanted.ndim > 2 else None
        wanted = wanted[..., :3, 3] if position or position_only else wanted
    if count is None:
        raise InputError("a path needs a .csv or .npy file of targets, one a row")
    options: dict[str, Any] = {"restart": restart, "branches": branches}
    options |= {} if max_step is None else {"max_step": max_step}
    options |= {} if tolerance is None else {"tolerance": table_files.tolerance(tolerance)}
    with progress.progress(sys.stderr, count) as said:
        spend = Budget(rng=rng, time_limit=time_limit, progress=said)
        answer = until_interrupt(system.ik_path, wanted, frame, start, **options, budget=spend)
    if out is not None:
        table_files.write_configurations(out, system, answer.q, deg)
    pictures = drawn(system, answer, plot, gif, html, frames=[] if frame is None else [frame])
    if json:
        written = ([] if out is None else [out]) + pictures
        print_json(
            {**as_json.answer_facts(answer, deg), "written": [str(path) for path in written]}
        )
    else:
        show(ik_report.path(answer, deg))
        _say_all(out, pictures)
    leave(answer)


def _task(task: str | None, position: bool) -> str | None:
    """The task, for which a target that is a position may be enough."""
    from kempe.answers.targets import task_of

    task_of(task, position, False)  # a wrong name is reported first
    if position and task not in (None, "position"):
        raise InputError(f"--task {task} needs a target with an orientation: x,y,z,roll,pitch,yaw")
    return "position" if position else task


def _all(
    system: System,
    X: Any,
    frame: str,
    task: str | None,
    axis: str | None,
    hold: list[str] | None,
    near: Any,
    tolerance: str | None,
    deg: bool,
    out: Path | None,
    draw: Callable[[Any], list[Path]],
    json: bool,
) -> None:
    """Print, write or draw all solutions."""
    from kempe.assemble.modes import Modes
    from kempe.cli import arguments, ik_report

    answer = system.ik_all(
        X,
        frame,
        near,
        task=task_argument(task, axis),
        fixed=_held(system, hold, deg),
        tolerance=None if tolerance is None else arguments.one_tolerance(tolerance),
    )
    pictures = draw(answer)
    if isinstance(answer, Modes):
        _modes(answer, deg, out, pictures, json)
        return
    if out is not None:
        ik_report.write(out, answer, deg)
    if json:
        print_json(ik_report.solutions_facts(answer, deg))
    else:
        show(ik_report.solutions(answer, deg))
        _say_all(out, pictures)
    if not (answer if answer.single else answer.inside.any(axis=-1).all()):
        raise typer.Exit(INCOMPLETE)


def _modes(answer: Modes, deg: bool, out: Path | None, pictures: list[Path], json: bool) -> None:
    """Print or write the configurations found for a frame of a mechanism with loops."""
    from kempe.cli import as_json, loop_report, table_files

    if out is not None:
        table_files.write_configurations(out, answer.system, answer.q, deg)
    if json:
        print_json(as_json.answer_facts(answer, deg))
    else:
        show(loop_report.modes(answer, deg))
        _say_all(out, pictures)
    if not answer:
        raise typer.Exit(INCOMPLETE)


def _held(system: System, hold: list[str] | None, deg: bool) -> dict[str, Any]:
    """Values of joints that are held, by name."""
    from kempe.cli import arguments

    return arguments.known(system, hold or [], deg, frames=False)


def task_argument(task: str | None, axis: str | None) -> Any:
    """What of the target counts: a task, or a task with the axis of the tool that it points."""
    from kempe.cli import arguments

    if axis is None:
        return task
    if task not in ("direction", "position_axis"):
        raise InputError("--axis is for the tasks direction and position_axis")
    return task, arguments.axis(axis)


@app.command(rich_help_panel=OPEN)
@guarded
@reads_file
def plan(
    file: File,
    reading: Reading,
    frame: Annotated[str, option("--frame", "Body or frame that shall reach targets.", "NAME")],
    task: Task = None,
    axis: Axis = None,
    hold: Annotated[
        list[str] | None,
        option("--hold", "Joint that is held, as for ik --all; can be repeated.", "NAME[=VALUE]"),
    ] = None,
    json: Json = False,
) -> None:
    """Say what a chain's axes have in common, and how all its configurations are found.

    Example: kempe plan panda.urdf --frame panda_hand_tcp
    """
    system = load(file, reading)
    from kempe.cli import ik_report
    from kempe.inverse.describe import ik_plan

    system.structure.frame_name(frame)
    words = [w if "=" in w else f"{w}=0" for w in hold or []]
    answer = ik_plan(system, frame, task_argument(task, axis), tuple(_held(system, words, False)))
    print_json(answer.data()) if json else show(ik_report.plan(answer))
