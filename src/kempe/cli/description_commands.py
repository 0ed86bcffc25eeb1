"""Commands that describe systems and files: info, check, convert, view."""

from __future__ import annotations

import sys
import webbrowser
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from kempe.cli import options
from kempe.cli.app import (
    DESCRIBE,
    Output,
    Reading,
    choose_output_file,
    load_system,
    register_command,
)
from kempe.cli.options import make_option
from kempe.cli.terminal import (
    COMPLETE,
    INCOMPLETE,
    clean_text,
    format_findings,
    list_problem_data,
    print_json,
    print_remark,
    print_text,
)
from kempe.description.formats import join_titles, list_readable_formats, list_writable_endings

if TYPE_CHECKING:
    from kempe.system import System


@register_command(DESCRIBE, "plot html deg json")
def run_info(
    system: System,
    output: Output,
    tree: Annotated[
        bool,
        make_option(
            "--tree", "Only the tree of bodies and joints, and the joints that close loops."
        ),
    ] = False,
) -> None:
    """Describe a system: bodies, joints, loops, limits, frames; or draw it, or its tree.

    Example: kempe info panda.urdf
    """
    from kempe.views.facts import SystemFacts

    output.draw_configurations(system, None, system.plot_tree if tree else None)
    if tree and not output.json:
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
    from kempe.description.read import check_description

    found: list[dict[str, Any]] = []
    reading.pop("unit", None)  # what a file says is checked in its own
    for file in files:
        problems, notes = check_description(file, **reading)
        found.append(
            {
                "file": file,
                "ok": not problems,
                "problems": [list_problem_data(p) for p in problems],
                "notes": list(notes),
            }
        )
        if not output.json:
            print_text(format_findings(file, problems, notes))
    bad = sum(not r["ok"] for r in found)
    if output.json:
        print_json(found)
    elif len(found) > 1:
        print(f"{len(found)} files: {len(found) - bad} good, {bad} with problems")
    raise typer.Exit(INCOMPLETE if bad else COMPLETE)


@register_command(DESCRIBE)
def run_convert(
    file: options.File,
    reading: Reading,
    output: Output,
    out: Annotated[
        Path | None,
        typer.Argument(
            metavar="OUT", help=f"File to write: {list_writable_endings()}; or -o FILE."
        ),
    ] = None,
    file_out: options.InPlace = None,
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


PagePath = Annotated[
    Path | None,
    make_option("-o,--html", "Write a page that opens from disk, without a server.", "FILE"),
]
Port = Annotated[
    int | None, make_option("--port", "Port of the page (8080, or the next that is free).", "N")
]
NoBrowser = Annotated[
    bool, make_option("--no-browser", "Open no browser, only print the address of the page.")
]


@register_command(DESCRIBE, "deg json")
def run_view(
    system: System,
    output: Output,
    frame: options.Frame = None,
    q: options.Values = None,
    posture: options.Posture = None,
    html: PagePath = None,
    port: Port = None,
    no_browser: NoBrowser = False,
) -> None:
    """Show a system in the browser: sliders, targets to drag, all solutions. Ctrl-C ends it.

    Example: kempe view panda.urdf --frame panda_hand_tcp
    """
    from kempe.cli import arguments

    if frame is not None:
        system.structure.frame_name(frame)  # a page from disk drags none
    is_given = q is not None or posture is not None
    start = arguments.read_configurations(system, q, posture, output.deg) if is_given else None
    if html is not None:
        from kempe.views.viewer.pages import write_page

        drawn = write_page(system, html, start)
        if output.json:
            print_json({"not_drawn": drawn.lost, "written": [str(html)]})
            return
        print(f"written to {html}")
        if drawn.lost:
            print_remark(drawn.lost_sentence)
        return
    from kempe.views.viewer.live import serve_viewer

    with serve_viewer(system, start, frame=frame, port=port, deg=output.deg) as viewer:
        if output.json:
            print_json({"system": system.name, "url": viewer.url, "not_drawn": viewer.drawn.lost})
        else:
            print(f"{system.name}: {viewer.url} (Ctrl-C ends it)")
            if viewer.drawn.lost:
                print_remark(viewer.drawn.lost_sentence)
        sys.stdout.flush()
        if not no_browser:
            webbrowser.open(viewer.url)
        viewer.wait()


@register_command(DESCRIBE, "json")
def run_draw(
    reading: Reading,
    output: Output,
    file: Annotated[
        str | None,
        typer.Argument(
            metavar="FILE", help="Planar mechanism to go on with: a file, or the name of a model."
        ),
    ] = None,
    port: Port = None,
    no_browser: NoBrowser = False,
) -> None:
    """Draw a planar mechanism in the browser by mouse: pins, bars, sliders, the ground, the crank.
    It is played there, copied as Python or TOML, and saved. Ctrl-C ends it.

    Example: kempe draw four_bar
    """
    from kempe.units import METRE, check_unit
    from kempe.views.sketch.reading import read_sketch
    from kempe.views.sketch.sketch import Sketch
    from kempe.views.viewer.board import Board
    from kempe.words import join_words

    sketch, lost = Sketch(unit=check_unit(reading.get("unit", METRE))), list[str]()
    if file is not None:
        sketch, lost = read_sketch(load_system(file, reading))
    if lost:
        print_remark(f"the drawing board does not keep {join_words(lost)}")
    with Board(sketch, port) as board:
        if output.json:
            print_json({"url": board.url, "not_kept": lost})
        else:
            print(f"drawing board: {board.url} (Ctrl-C ends it)")
        sys.stdout.flush()
        if not no_browser:
            webbrowser.open(board.url)
        board.wait()
