"""`save_html`: a page of a spatial system in motion, as one file without server or network."""

from __future__ import annotations

import html
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe.arguments import read_flag
from kempe.arrays import read_reals
from kempe.description.source import expand_path
from kempe.errors import InputError, format_value, warn
from kempe.views.viewer.overlays import iterate_rounds
from kempe.views.viewer.scene_nodes import Drawn, Nodes
from kempe.views.viewer.server import POLICY, PageServer, set_title, silence_action
from kempe.views.viewer.session import Session

if TYPE_CHECKING:
    from kempe.model.model import FrameLike, Model

FRAMES = 30.0
"""Frames a second of the motion."""
META = f'<meta http-equiv="Content-Security-Policy" content="{POLICY.format(connect="")}"/>'
"""What keeps a browser that shows the page from requests, whatever is in it."""
NOTE = (
    '<div style="position:fixed;left:1em;bottom:{bottom};z-index:9;font:13px system-ui,sans-serif;color:#59646e;'
    'pointer-events:none">'
    "{name}{more}: turn it with the mouse, zoom with the wheel. Sliders need the live page: system.show()</div>"
)
"""What is written on the page, above the player of a motion."""


def save_html(
    system: Model,
    file: Any,
    q: Any = None,
    *,
    path: Any = None,
    frame: FrameLike | None = None,
    labels: bool = False,
    seconds: float = 6.0,
) -> None:
    """Write an HTML file with the system in space; see `System.save_html`."""
    if said := write_page(system, file, q, path, frame, labels, seconds).lost_sentence:
        warn(said, UserWarning)


def write_page(
    system: Model,
    file: Any,
    q: Any = None,
    path: Any = None,
    frame: FrameLike | None = None,
    labels: bool = False,
    seconds: float = 6.0,
) -> Drawn:
    """Write a page as `save_html` does; return the drawing, which knows the missing meshes."""
    out = check_page_path(file)
    seconds = float(read_reals(seconds, "seconds"))
    if not 0.0 < seconds <= 600.0:
        raise InputError(f"seconds is {seconds:g}; it must be more than 0, and 600 at most")
    named = read_flag(labels, "labels")
    session = Session(system, q, frame, path)
    drawn = Drawn(session.system, session.q, None if session.motion is None else session.motion.q)
    out.write_text(_format_page(session, drawn, named, seconds), encoding="utf-8")
    return drawn


def check_page_path(file: Any) -> Path:
    """Check the path of a page. Errors: `InputError` for other endings and missing folders."""
    if not isinstance(file, (str, Path)):
        raise InputError(f"file is {format_value(file)}; it must be the name of a file")
    out = expand_path(file)
    if out.suffix.lower() not in (".html", ".htm"):
        raise InputError(f"{out}: a page ends in .html")
    if not out.parent.is_dir():
        raise InputError(f"{out}: there is no folder {str(out.parent)!r}")
    return out


def _format_page(session: Session, drawn: Drawn, named: bool, seconds: float) -> str:
    """Format the HTML of a page: the client of viser with the scene and its motion inside."""
    server = PageServer(port=0)
    try:
        server.scene.set_up_direction("+y" if session.system.dim == 2 else "+z")
        drawn.place_camera(server.initial_camera)
        nodes = Nodes(server.scene, drawn, session.q)
        nodes.show_names(named)
        if session.motion is not None:
            nodes.show_overlay("curve", next(iterate_rounds(session, "curve")))
        record = server.get_scene_serializer()
        if (motion := session.motion) is not None:
            count = max(2, round(seconds * FRAMES))
            for t in np.linspace(0.0, motion.duration, count):
                nodes.move_links(motion.find_configuration(t))
                record.insert_sleep(seconds / count)
        text = record.as_html()
    finally:
        silence_action(server.stop)
    more = (
        ""
        if motion is None
        else f" (lengths in {session.system.unit}; red: the curve of {session.frame})"
    )
    note = NOTE.format(
        bottom=".7em" if motion is None else "4em",
        name=html.escape(session.system.name),
        more=html.escape(more),
    )
    head, end, rest = set_title(text, session.system.name).rpartition("</body>")
    return (head + note + end + rest).replace("<head>", f"<head>{META}", 1)
