"""Commands that describe systems, convert files, and find positions."""

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
    command,
    option,
    remark,
    written_to,
)
from kempe.cli.terminal import COMPLETE, INCOMPLETE, print_json
from kempe.description.formats import endings_written, named, read_by
from kempe.words import join_first_words, make_plural

if TYPE_CHECKING:
    from kempe.system import System

# ---- describe and convert


@command(DESCRIBE, "plot html deg json")
def info(
    system: System,
    output: Output,
    tree: Annotated[
        bool, option("--tree", "Only the tree of bodies and joints, and what closes loops.")
    ] = False,
) -> None:
    """Say what a system is: bodies, joints, loops, limits, frames; or draw it, or its tree.

    Example: kempe info panda.urdf
    """
    from kempe.cli.facts import SystemFacts

    output.draw(system, None, system.plot_tree if tree else None)
    if tree and not output.json:
        from kempe.cli.report import clean
        from kempe.views.overviews import tree_lines

        print(clean("\n".join(tree_lines(system))))
        output.show()
    else:
        output.show(SystemFacts(system))


@command(DESCRIBE)
def check(
    files: Annotated[
        list[str], typer.Argument(metavar="FILE...", help=f"Files in {named(read_by())}.")
    ],
    reading: Reading,
    output: Output,
) -> None:
    """List all problems of files, each with its line.

    Example: kempe check robots/*.urdf
    """
    from kempe.cli import facts, report
    from kempe.description.read import check as check_

    found: list[dict[str, Any]] = []
    for file in files:
        problems, notes = check_(file, **reading)
        found.append(
            {
                "file": file,
                "ok": not problems,
                "problems": [facts.problem_facts(p) for p in problems],
                "notes": list(notes),
            }
        )
        if not output.json:
            report.write(report.findings(file, problems, notes))
    if output.json:
        print_json(found)
    elif len(found) > 1:
        bad = sum(not r["ok"] for r in found)
        print(f"{len(found)} files: {len(found) - bad} good, {bad} with problems")
    raise typer.Exit(COMPLETE if all(r["ok"] for r in found) else INCOMPLETE)


@command(DESCRIBE)
def convert(
    file: File,
    reading: Reading,
    output: Output,
    out: Annotated[
        Path | None,
        typer.Argument(metavar="OUT", help=f"File to write: {endings_written()}; or -o FILE."),
    ] = None,
    file_out: InPlace = None,
) -> None:
    """Write a system in another format, which the ending of OUT names.

    Example: kempe convert panda.urdf panda.toml
    """
    import kempe
    from kempe.description.read import write

    out = written_to(out, file_out)
    mechanism = kempe.read(file, **reading)
    mechanism.build()
    write(mechanism, out)
    if output.json:
        notes = list(mechanism.notes)
        print_json({"name": mechanism.name, "notes": notes, "written": [str(out)]})
    else:
        print(f"{mechanism.name} written to {out}")


# ---- forward model


@command(OPEN, "out plot gif html deg json")
def fk(
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
    values = arguments.configurations(system, q, posture, output.deg)
    poses = facts.Poses(system, frame, system.fk(values, frame))
    output.save(poses)
    output.draw(system, values, frames=[] if frame is None else [frame])
    output.show(poses)
    bad = table_files.not_finite(values)
    if bad:
        rows = f"{make_plural(len(bad), 'row')} {join_first_words([str(i) for i in bad], 12)}"
        remark(f"q is not finite in {rows}; poses there are NaN")
    gap = facts.largest_gap(system, values)
    if gap:
        remark(f"loops are open here, {gap}: kempe assemble closes them")
    if bad:
        raise typer.Exit(INCOMPLETE)
