"""Commands that describe systems, convert files, and find positions."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from kempe.cli.app import (
    DESCRIBE,
    OPEN,
    Deg,
    File,
    Film,
    FrameOrAll,
    InPlace,
    Json,
    Out,
    Page,
    Picture,
    Posture,
    Reading,
    Values,
    app,
    drawable,
    drawn,
    load,
    option,
    reads_file,
    remark,
    results,
    say_drawn,
    say_written,
    written_to,
)
from kempe.cli.terminal import COMPLETE, INCOMPLETE, guarded, print_json, show
from kempe.description.formats import endings_written, named, read_by

# ---- describe and convert


@app.command(rich_help_panel=DESCRIBE)
@guarded
@reads_file
def info(
    file: File,
    reading: Reading,
    tree: Annotated[
        bool, option("--tree", "Only the tree of bodies and joints, and what closes loops.")
    ] = False,
    plot: Picture = None,
    html: Page = None,
    deg: Deg = False,
    json: Json = False,
) -> None:
    """Say what a system is: bodies, joints, loops, limits, frames; or draw it, or its tree.

    Example: kempe info panda.urdf
    """
    system = load(file, reading)
    from kempe.cli import as_json, report

    drawable(plot, None, html)
    if json:
        print_json(as_json.system_facts(system, deg))
    elif tree:
        show(report.tree(system))
    else:
        show(report.info(system, deg))
    if plot is not None or html is not None:
        say_drawn(drawn(system, None, plot, None, html, draw=system.plot_tree if tree else None))


@app.command(rich_help_panel=DESCRIBE)
@guarded
@reads_file
def check(
    files: Annotated[
        list[str], typer.Argument(metavar="FILE...", help=f"Files in {named(read_by())}.")
    ],
    reading: Reading,
    json: Json = False,
) -> None:
    """List all problems of files, each with its line.

    Example: kempe check robots/*.urdf
    """
    from kempe.cli import as_json, report
    from kempe.description.read import check as check_

    found: list[dict[str, Any]] = []
    for file in files:
        problems, notes = check_(file, **reading)
        found.append(
            {
                "file": file,
                "ok": not problems,
                "problems": [as_json.problem_facts(p) for p in problems],
                "notes": list(notes),
            }
        )
        if not json:
            show(report.findings(file, problems, notes))
    if json:
        print_json(found)
    elif len(found) > 1:
        bad = sum(not r["ok"] for r in found)
        print(f"{len(found)} files: {len(found) - bad} good, {bad} with problems")
    raise typer.Exit(COMPLETE if all(r["ok"] for r in found) else INCOMPLETE)


@app.command(rich_help_panel=DESCRIBE)
@guarded
@reads_file
def convert(
    file: File,
    reading: Reading,
    out: Annotated[
        Path | None,
        typer.Argument(metavar="OUT", help=f"File to write: {endings_written()}; or -o FILE."),
    ] = None,
    output: InPlace = None,
    json: Json = False,
) -> None:
    """Write a system in another format, which the ending of OUT names.

    Example: kempe convert panda.urdf panda.toml
    """
    import kempe
    from kempe.description.read import write

    out = written_to(out, output)
    mechanism = kempe.read(file, **reading)
    mechanism.build()
    write(mechanism, out)
    if json:
        print_json({"written": str(out), "name": mechanism.name, "notes": list(mechanism.notes)})
    else:
        print(f"{mechanism.name} written to {out}")


# ---- forward model


@app.command(rich_help_panel=OPEN)
@guarded
@reads_file
def fk(
    file: File,
    reading: Reading,
    frame: FrameOrAll = None,
    q: Values = None,
    posture: Posture = None,
    deg: Deg = False,
    out: Out = None,
    plot: Picture = None,
    gif: Film = None,
    html: Page = None,
    json: Json = False,
) -> None:
    """Say where a frame is, or all bodies are (forward model).

    Example: kempe fk panda.urdf --frame panda_hand_tcp --q 0,-45,0,-135,0,90,45,0.04 --deg
    """
    system = load(file, reading)
    from kempe.cli import as_json, report, table_files

    if frame is not None:
        system.structure.frame_name(frame)  # a wrong name is reported before kernels are compiled
    results(out, q)
    drawable(plot, gif, html)
    values = table_files.configuration(system, q, posture, deg)
    X = system.fk(values, frame)
    say_drawn(drawn(system, values, plot, gif, html, frames=[] if frame is None else [frame]))
    if out is not None:
        table_files.write_poses(out, X, frame is None, deg)
        say_written(out, json)
    elif json:
        print_json(as_json.poses_facts(system, frame, X, deg))
    else:
        show(report.poses(system, frame, X, deg))
    bad = table_files.not_finite(values)
    if bad:
        remark(f"q is not finite in {report.rows_text(bad)}; poses there are NaN")
    gap = as_json.largest_gap(system, values)
    if gap:
        remark(f"loops are open here, {gap}: kempe assemble closes them")
    if bad:
        raise typer.Exit(INCOMPLETE)
