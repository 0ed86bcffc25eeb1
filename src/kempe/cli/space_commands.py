"""Command about the configuration space and the task space of a system."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

import typer

from kempe.arguments import call_until_interrupt
from kempe.budget import Budget
from kempe.cli.app import CLOSED, Output, TimeLimit, make_option, register_command, save_picture
from kempe.cli.terminal import INCOMPLETE
from kempe.errors import InputError

if TYPE_CHECKING:
    from kempe.system import System


@register_command(CLOSED, "out plot deg json")
def run_spaces(
    system: System,
    output: Output,
    frame: Annotated[
        str | None, make_option("--frame", "Frame whose task space is wanted.", "NAME")
    ] = None,
    task: Annotated[
        str | None,
        make_option(
            "--task", "What of the frame is drawn: xy, xz, yz or direction (of its z axis).", "NAME"
        ),
    ] = None,
    position_only: Annotated[
        bool, make_option("--position-only", "Only its position counts, not its pose.")
    ] = False,
    sample: Annotated[
        float | None,
        make_option("--sample", "So many random configurations, uniform in a stated measure.", "N"),
    ] = None,
    rng: Annotated[int, make_option("--rng", "Number that fixes what is random (0).", "N")] = 0,
    time_limit: TimeLimit = None,
) -> None:
    """Say what the configuration space is: dimension, components, samples; and the task space of a
    frame.

    With --plot both spaces of a system with two freedoms are drawn beside one another (--frame says
    of what).

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
    budget = Budget(time_limit=time_limit)
    answers: dict[str, Any] = {"configuration_space": space}
    answers["components"] = call_until_interrupt(space.components, budget=budget)
    if frame is not None:
        answers["task_space"] = system.task_space(
            frame, task="position" if position_only else "pose"
        )
    if sample is not None:
        answers["sample"] = call_until_interrupt(space.sample, sample, rng, budget=budget)
    if output.plot is not None:
        from kempe.cli import progress

        with progress.show_progress("places") as report:
            spent = Budget(time_limit=time_limit, progress=report)
            axes = call_until_interrupt(system.plot_spaces, frame or "", task=task, budget=spent)
            save_picture(axes, output.plot)
        output.written.append(output.plot)
    if "sample" in answers:
        output.save_table(answers["sample"])
    output.print_answers(**answers)
    if answers["components"].late or not answers.get("sample", space):
        raise typer.Exit(INCOMPLETE)
