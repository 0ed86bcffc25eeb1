"""Commands that show a system in a browser; each is a few lines over the library."""

from __future__ import annotations

import sys
import webbrowser
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from kempe.cli.app import (
    DESCRIBE,
    MODELS,
    Output,
    Posture,
    Values,
    make_option,
    print_remark,
    register_command,
)
from kempe.cli.terminal import print_json

if TYPE_CHECKING:
    from kempe.system import System

DEMO = "panda"
"""The model that `kempe demo` shows."""

Frame = Annotated[
    str | None,
    make_option("--frame", "Body or frame that is dragged (the last one declared).", "NAME"),
]
Port = Annotated[
    int | None, make_option("--port", "Port of the page (8080, or the next that is free).", "N")
]
NoBrowser = Annotated[
    bool, make_option("--no-browser", "Open no browser: only say where the page is.")
]
Html = Annotated[
    Path | None,
    make_option("-o,--html", "Write a page that opens from disk, and serve none.", "FILE"),
]


@register_command(DESCRIBE, "deg json")
def run_view(
    system: System,
    output: Output,
    frame: Frame = None,
    q: Values = None,
    posture: Posture = None,
    html: Html = None,
    port: Port = None,
    no_browser: NoBrowser = False,
) -> None:
    """Show a system in the browser: sliders, targets to drag, all solutions. Ctrl-C ends it.

    Example: kempe view panda.urdf --frame panda_hand_tcp
    """
    from kempe.cli import arguments

    if frame is not None:
        system.structure.frame_name(frame)
    start = (
        None
        if q is None and posture is None
        else arguments.read_configurations(system, q, posture, output.deg)
    )
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


@register_command(MODELS)
def run_demo(
    output: Output, html: Html = None, port: Port = None, no_browser: NoBrowser = False
) -> None:
    """Show a shipped arm in the browser.

    Example: kempe demo
    """
    run_view(file=DEMO, html=html, port=port, no_browser=no_browser, json=output.json)
