"""Commands that describe systems, convert files and compute poses."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from kempe.cli.app import (
    DESCRIBE,
    OPEN,
    File,
    FrameOrAll,
    InPlace,
    Output,
    Posture,
    Reading,
    Values,
    choose_output_file,
    make_option,
    print_remark,
    register_command,
)
from kempe.cli.terminal import COMPLETE, INCOMPLETE, print_json
from kempe.description.formats import join_titles, list_readable_formats, list_writable_endings
from kempe.words import join_first_words, make_plural

if TYPE_CHECKING:
    from kempe.system import System

# ---- describe and convert


@register_command(DESCRIBE, "plot html deg json")
def run_info(
    system: System,
    output: Output,
    tree: Annotated[
        bool, make_option("--tree", "Only the tree of bodies and joints, and what closes loops.")
    ] = False,
) -> None:
    """Say what a system is: bodies, joints, loops, limits, frames; or draw it, or its tree.

    Example: kempe info panda.urdf
    """
    from kempe.cli.facts import SystemFacts

    output.draw_configurations(system, None, system.plot_tree if tree else None)
    if tree and not output.json:
        from kempe.cli.report import clean_text
        from kempe.views.overviews import list_tree_lines

        print(clean_text("\n".join(list_tree_lines(system))))
        output.print_answers()
    else:
        output.print_answers(SystemFacts(system))


@register_command(DESCRIBE)
def run_check(
    files: Annotated[
        list[str],
        typer.Argument(metavar="FILE...", help=f"Files in {join_titles(list_readable_formats())}."),
    ],
    reading: Reading,
    output: Output,
) -> None:
    """List all problems of files, each with its line.

    Example: kempe check robots/*.urdf
    """
    from kempe.cli import facts, report
    from kempe.description.read import check_description as check_

    found: list[dict[str, Any]] = []
    for file in files:
        problems, notes = check_(file, **reading)
        found.append(
            {
                "file": file,
                "ok": not problems,
                "problems": [facts.make_problem_facts(p) for p in problems],
                "notes": list(notes),
            }
        )
        if not output.json:
            report.print_text(report.format_findings(file, problems, notes))
    if output.json:
        print_json(found)
    elif len(found) > 1:
        bad = sum(not r["ok"] for r in found)
        print(f"{len(found)} files: {len(found) - bad} good, {bad} with problems")
    raise typer.Exit(COMPLETE if all(r["ok"] for r in found) else INCOMPLETE)


@register_command(DESCRIBE)
def run_convert(
    file: File,
    reading: Reading,
    output: Output,
    out: Annotated[
        Path | None,
        typer.Argument(
            metavar="OUT", help=f"File to write: {list_writable_endings()}; or -o FILE."
        ),
    ] = None,
    file_out: InPlace = None,
) -> None:
    """Write a system in another format, which the ending of OUT names.

    Example: kempe convert panda.urdf panda.toml
    """
    import kempe
    from kempe.description.read import write_mechanism

    out = choose_output_file(out, file_out)
    mechanism = kempe.read(file, **reading)
    mechanism.build()
    write_mechanism(mechanism, out)
    if output.json:
        notes = list(mechanism.notes)
        print_json({"name": mechanism.name, "notes": notes, "written": [str(out)]})
    else:
        print(f"{mechanism.name} written to {out}")


# ---- forward model


@register_command(OPEN, "out plot gif html deg json")
def run_fk(
    system: System,
    output: Output,
    frame: FrameOrAll = None,
    q: Values = None,
    posture: Posture = None,
) -> None:
    """Say where a frame is, or all bodies are (forward model).

    Example: kempe fk panda.urdf --frame panda_hand_tcp --q 0,-45,0,-135,0,90,45,0.04 --deg
    """
    from kempe.cli import arguments, facts, table_files

    if frame is not None:
        system.structure.frame_name(frame)  # a wrong name is reported before kernels are compiled
    values = arguments.read_configurations(system, q, posture, output.deg)
    poses = facts.Poses(system, frame, system.fk(values, frame))
    output.save_table(poses)
    output.draw_configurations(system, values, frames=[] if frame is None else [frame])
    output.print_answers(poses)
    bad = table_files.find_nonfinite_rows(values)
    if bad:
        rows = f"{make_plural(len(bad), 'row')} {join_first_words([str(i) for i in bad], 12)}"
        print_remark(f"q is not finite in {rows}; poses there are NaN")
    gap = facts.describe_largest_gap(system, values)
    if gap:
        print_remark(f"loops are open here, {gap}: kempe assemble closes them")
    if bad:
        raise typer.Exit(INCOMPLETE)
