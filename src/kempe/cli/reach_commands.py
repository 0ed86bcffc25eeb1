"""Commands about reachability: lists of poses, placement of the base, singular configurations."""

from __future__ import annotations

from collections.abc import Generator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Annotated

import numpy as np
import typer

from kempe.arguments import call_until_interrupt
from kempe.budget import Budget
from kempe.cli.app import (
    OPEN,
    NoLimits,
    Output,
    PositionOnly,
    Rng,
    TimeLimit,
    make_option,
    print_remark,
    register_command,
)
from kempe.cli.terminal import INCOMPLETE, end_incomplete_command
from kempe.errors import InputError
from kempe.words import DEGREE

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from kempe.spatial import Array
    from kempe.system import System

Poses = Annotated[
    str,
    typer.Argument(metavar="POSES", help="A .csv or .npy file, a pose a row, as targets of ik."),
]
Reaching = Annotated[
    str, make_option("--frame", "Body or frame that shall reach the poses.", "NAME")
]
Ranges = Annotated[
    list[str],
    make_option(
        "--box", "Where the base may be: x, y, z or yaw. Can be repeated.", "NAME=LOW,HIGH"
    ),
]
Cells = Annotated[int, make_option("--cells", "Values that are tried along each range (11).", "N")]
Frame = Annotated[
    str | None, make_option("--frame", "Body or frame that loses directions.", "NAME")
]
FrameTask = Annotated[
    str | None,
    make_option(
        "--task", "What counts: pose, position, orientation, xy, xz, yz or direction.", "TASK"
    ),
]
Inputs = Annotated[
    str | None,
    make_option("--inputs", "Driven coordinates of closed loops. Default: as FILE says.", "A,B"),
]
From = Annotated[
    list[str] | None,
    make_option(
        "--at", "Configuration from which the nearest is wanted; can be repeated.", "NAME=VALUE"
    ),
]
Starts = Annotated[int | None, make_option("--starts", "Random starts of the search (64).", "N")]


@register_command(OPEN, "out plot gif html deg json")
def run_singularities(
    system: System,
    output: Output,
    frame: Frame = None,
    task: FrameTask = None,
    inputs: Inputs = None,
    at: From = None,
    starts: Starts = None,
    rng: Rng = None,
    time_limit: TimeLimit = None,
    no_limits: NoLimits = False,
) -> None:
    """Find the singular configurations of a frame, or of closed loops, and how far the nearest is.

    --plot draws some, with the directions that the frame loses and gains there, and planar curves
    of them, as far as these are followed within the time limit or until Ctrl-C; --gif and --html
    show one of each set; -o writes all.

    Example: kempe singularities puma560 --frame tool --at q5=0.2
    """
    from kempe.cli import arguments
    from kempe.numerics.clock import TimeLimit

    time = TimeLimit(time_limit)
    driving = arguments.parse_joint_names(system, "--inputs", inputs)
    near, closing = arguments.read_configuration(
        system, ",".join(at) if at else None, None, output.deg
    )
    if closing is not None and not closing:
        raise InputError(f"--at cannot be closed: {closing.status}")
    with _make_budget(starts, rng, time_limit, "starts") as budget:
        answer = call_until_interrupt(
            system.singularities, frame, task, inputs=driving, limits=not no_limits, budget=budget
        )
    broken: list[str] = []

    def draw_curves() -> tuple[Axes, ...]:
        """Draw the singular curves of the frame."""
        from kempe.views.singular_plot import find_shown_curves, plot_singularities

        with _make_budget(None, None, time.remaining_seconds, "configurations of curves") as budget:
            curves = call_until_interrupt(find_shown_curves, answer, budget)
        if curves is not None and curves.broken:
            broken.append(curves.status)
        return plot_singularities(answer, curves)

    output.save_table(answer)
    each = np.reshape([s.q[0] for s in answer.sets], (-1, system.nq))
    output.draw_configurations(system, each, draw_curves)
    output.print_answers(answer, **({} if near is None else {"nearest": answer.nearest(near)}))
    for why in broken:
        print_remark(why)
    end_incomplete_command(answer)
    if broken:
        raise typer.Exit(INCOMPLETE)


@register_command(OPEN, "out plot gif html deg json")
def run_reach(
    system: System,
    output: Output,
    poses: Poses,
    frame: Reaching,
    position_only: PositionOnly = False,
    starts: Starts = None,
    rng: Rng = None,
    time_limit: TimeLimit = None,
) -> None:
    """Say which of a list of poses are reached, how well, and what blocks the others.

    Example: kempe reach ur5 weld.csv --frame tool
    """
    X, task = _read_poses(system, poses, frame, position_only, output.deg)
    with _make_budget(starts, rng, time_limit, "poses") as budget:
        answer = call_until_interrupt(system.reach.poses, X, frame, task=task, budget=budget)
    output.save_table(answer)
    output.draw_configurations(system, answer.q[answer.reached], answer.plot)
    output.finish_command(answer)


@register_command(OPEN, "plot deg json")
def run_place(
    system: System,
    output: Output,
    poses: Poses,
    frame: Reaching,
    box: Ranges,
    cells: Cells = 11,
    position_only: PositionOnly = False,
    starts: Starts = None,
    rng: Rng = None,
    time_limit: TimeLimit = None,
) -> None:
    """Find where to put the base so that all poses of a list are reached.

    Example: kempe place ur5 weld.csv --frame tool --box x=-1,1 --box y=-1,1 --box z=0.2
    """
    X, task = _read_poses(system, poses, frame, position_only, output.deg)
    ranges = _parse_ranges(box, output.deg)
    with _make_budget(starts, rng, time_limit, "poses") as budget:
        answer = call_until_interrupt(
            system.reach.place, X, frame, ranges, cells, task=task, budget=budget
        )
    output.draw_configurations(system, None, answer.plot)
    output.finish_command(answer)


@contextmanager
def _make_budget(
    starts: int | None, rng: int | None, time_limit: float | None, of: str
) -> Generator[Budget]:
    """Return the budget of a command; a terminal shows how many starts or points are done."""
    from kempe.cli import progress

    with progress.show_progress(of) as report:
        yield Budget(starts=starts, rng=rng, time_limit=time_limit, progress=report)


def _read_poses(
    system: System, text: str, frame: str, position_only: bool, deg: bool
) -> tuple[Array, str | None]:
    """Return the poses (n, 4, 4) of a file, and the task.

    Errors: `InputError`, `UnknownNameError`.

    Errors: `InputError`, `UnknownNameError`.
    """
    from kempe.cli import arguments, table_files

    system.structure.frame_name(frame)  # a wrong name is reported before any work
    if not table_files.is_table_file(text):
        raise InputError(f"POSES is {text!r}; it must be a .csv or .npy file of poses, one a row")
    X, position = arguments.read_target(system, text, deg)
    return X.reshape(-1, 4, 4), "position" if position or position_only else None


def _parse_ranges(words: list[str], deg: bool) -> dict[str, object]:
    """Return ranges by name: one number fixes a value, two numbers are a lower and an upper bound.

    Errors: `InputError`.

    Errors: `InputError`.
    """
    from kempe.cli import table_files

    out: dict[str, object] = {}
    for word in words:
        name, sign, value = word.partition("=")
        if not sign:
            raise InputError(f"--box {word!r} has no '='; write x=LOW,HIGH or x=VALUE")
        if name.strip() in out:
            raise InputError(f"--box gives {name.strip()!r} twice")
        factor = DEGREE if deg and name.strip() == "yaw" else 1.0
        numbers = [x * factor for x in table_files.parse_numbers(value, f"--box {name}")]
        out[name.strip()] = numbers[0] if len(numbers) == 1 else numbers
    return out
