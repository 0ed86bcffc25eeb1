"""Commands about what is reached: singular configurations."""

from __future__ import annotations

from typing import Annotated

from kempe.budget import Budget
from kempe.cli.app import OPEN, Base, Deg, Dirs, File, Json, Lenient, Rng, Root, Xacro, app, load, option
from kempe.errors import InputError
from kempe.views.terminal import guarded, leave, print_json, show

Frame = Annotated[str | None, option("--frame", "Body or frame that loses directions.", "NAME")]
FrameTask = Annotated[str | None, option("--task", "What counts: pose, position or orientation.", "TASK")]
Inputs = Annotated[str | None, option("--inputs", "Driven coordinates of closed loops. Default: as FILE says.", "A,B")]
From = Annotated[
    list[str] | None,
    option("--at", "Configuration from which the nearest is wanted; can be repeated.", "NAME=VALUE"),
]
Starts = Annotated[int | None, option("--starts", "Random starts of the search (64).", "N")]
NoLimits = Annotated[bool, option("--no-limits", "Leave joint limits out.")]


@app.command(rich_help_panel=OPEN)
@guarded
def singularities(
    file: File, frame: Frame = None, task: FrameTask = None, inputs: Inputs = None, at: From = None,
    starts: Starts = None, rng: Rng = None, no_limits: NoLimits = False, deg: Deg = False, json: Json = False,
    base: Base = None, root: Root = None, package_dir: Dirs = None, xacro: Xacro = False,
    lenient_limits: Lenient = False,
) -> None:  # fmt: skip
    """Find the singular configurations of a frame, or of closed loops, and how far the nearest is.

    Example: kempe singularities puma560 --frame tool --at q5=0.2
    """
    system = load(file, base, root, package_dir, xacro, lenient_limits)
    from kempe.views.input import given

    driving = None if inputs is None else [name.strip() for name in inputs.split(",") if name.strip()]
    if driving == []:
        raise InputError(f"--inputs names no joint; there are: {', '.join(system.joint_names)}")
    q, closing = given.configuration(system, ",".join(at), None, deg) if at else (None, None)
    if closing is not None and not closing:
        raise InputError(f"--at cannot be closed: {closing.status}")
    answer = system.singularities(frame, task, inputs=driving, limits=not no_limits,
                                  budget=Budget(starts=starts, rng=rng))  # fmt: skip
    nearest = None if q is None else answer.nearest(q)
    if json:
        print_json(answer.data() | ({} if nearest is None else {"nearest": nearest.data()}))
    else:
        show(str(answer) if nearest is None else f"{answer}\n{nearest}")
    leave(answer)
