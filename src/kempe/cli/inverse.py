"""Commands for inverse models: one configuration, all of them, and how these are found."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from kempe.cli.app import (
    OPEN,
    All,
    Axis,
    Base,
    Deg,
    Dirs,
    File,
    Frame,
    Hold,
    Json,
    Out,
    PositionOnly,
    Rng,
    Root,
    Seed,
    Target,
    Task,
    Tolerance,
    Xacro,
    app,
    load,
    option,
    results,
    told,
)
from kempe.errors import InputError
from kempe.views.terminal import INCOMPLETE, guarded, print_json, show

if TYPE_CHECKING:
    from kempe.model.system import System


@app.command(rich_help_panel=OPEN)
@guarded
def ik(
    file: File, frame: Frame, target: Target, position_only: PositionOnly = False, seed: Seed = None,
    rng: Rng = None, tolerance: Tolerance = None, all: All = False, task: Task = None, axis: Axis = None,
    hold: Hold = None, deg: Deg = False, out: Out = None, json: Json = False,
    base: Base = None, root: Root = None, package_dir: Dirs = None, xacro: Xacro = False,
) -> None:  # fmt: skip
    """Find a configuration that brings a frame to a pose, or all of them (inverse model).

    Example: kempe ik panda.urdf --frame panda_hand_tcp --target 0.4,0.1,0.5,180,0,0 --deg
    """
    given = {"--hold": hold} if not all else {"--rng": rng}
    wrong = [name for name, value in given.items() if value is not None]
    if wrong:
        raise InputError(f"{wrong[0]} is for {'all solutions: add --all' if not all else 'a search: leave --all out'}")
    system = load(file, base, root, package_dir, xacro)
    from kempe.views import facts, report, rows

    system.frame_name(frame)  # a wrong name is told before kernels are compiled
    results(out)
    X, position = rows.target(system, target, deg)
    start = None if seed is None else rows.configuration(system, seed, None, deg)
    position = position or position_only
    task = _task(task, position)
    if all:
        _all(system, X, frame, task, axis, hold, start, tolerance, deg, out, json)
        return
    asked = _asked(task, axis)
    answer = system.ik(X, frame, seed=start, tolerance=rows.tolerance(tolerance or "1e-6"), rng=rng or 0, **asked)
    if out is not None:
        rows.write_configurations(out, system, answer.q, deg)
    if json:
        print_json(facts.solution_facts(system, answer, deg))
    else:
        show(report.solution(system, answer, deg) if out is None else report.outcome(answer))
        if out is not None:
            told(out, json)
    if not answer:
        raise typer.Exit(INCOMPLETE)


def _task(task: str | None, position: bool) -> str | None:
    """The task, for which a target that is a position may be enough."""
    from kempe.solvers.targets import task_of

    task_of(task, position, False)  # a wrong name is told first
    if position and task not in (None, "position"):
        raise InputError(f"--task {task} needs a target with an orientation: x,y,z,roll,pitch,yaw")
    return "position" if position else task


def _all(
    system: System, X: Any, frame: str, task: str | None, axis: str | None, hold: list[str] | None, near: Any,
    tolerance: str | None, deg: bool, out: Path | None, json: bool,
) -> None:  # fmt: skip
    """Print or write all solutions."""
    from kempe.views import ik_report

    more = {} if tolerance is None else {"tolerance": ik_report.tolerance(tolerance)}
    answer = system.ik_all(X, frame, near=near, **_held(system, hold, deg), **_asked(task, axis), **more)
    if out is not None:
        ik_report.write(out, answer, deg)
    if json:
        print_json(ik_report.solutions_facts(answer, deg))
    else:
        show(ik_report.solutions(answer, deg))
        if out is not None:
            told(out, json)
    if not (answer if answer.single else answer.inside.any(axis=-1).all()):
        raise typer.Exit(INCOMPLETE)


def _held(system: System, hold: list[str] | None, deg: bool) -> dict[str, Any]:
    """Joints that are held, as arguments for all solutions and for their plan."""
    from kempe.views import given

    return {"fixed": given.known(system, hold or [], deg, frames=False)}


def _asked(task: str | None, axis: str | None) -> dict[str, Any]:
    """What of the target counts, as arguments for inverse models."""
    from kempe.views import ik_report

    out: dict[str, Any] = {"task": task}
    if axis is not None:
        if task not in ("direction", "position_axis"):
            raise InputError("--axis is for the tasks direction and position_axis")
        out["axis"] = ik_report.axis(axis)
    return out


@app.command(rich_help_panel=OPEN)
@guarded
def plan(
    file: File, frame: Annotated[str, option("--frame", "Body or frame that shall reach targets.", "NAME")],
    task: Task = None, axis: Axis = None,
    hold: Annotated[
        list[str] | None, option("--hold", "Joint that is held, as for ik --all; can be repeated.", "NAME[=VALUE]")
    ] = None,
    json: Json = False, base: Base = None, root: Root = None, package_dir: Dirs = None, xacro: Xacro = False,
) -> None:  # fmt: skip
    """Say what a chain's axes have in common, and how all its configurations are found.

    Example: kempe plan panda.urdf --frame panda_hand_tcp
    """
    system = load(file, base, root, package_dir, xacro)
    from kempe.solvers.analytic.describe import ik_plan
    from kempe.views import ik_report

    system.frame_name(frame)
    words = [w if "=" in w else f"{w}=0" for w in hold or []]
    answer = ik_plan(system, frame, **_held(system, words, False), **_asked(task, axis))
    print_json(answer.data()) if json else show(ik_report.plan(answer))
