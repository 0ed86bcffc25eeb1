"""`system.show()`: a page on this machine in which a system is seen and moved, served by viser.

Importing it needs the extra [view]. Errors: `MissingExtraError` without viser or trimesh.
"""

from __future__ import annotations

import copy
import socket
import threading
import webbrowser
from functools import partial
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from kempe.calls import flag
from kempe.errors import InputError, warn
from kempe.reals import is_whole
from kempe.spatial import Array
from kempe.views.viewer.live_page import Page
from kempe.views.viewer.scene_nodes import Drawn
from kempe.views.viewer.server import HOST, PageServer, quiet
from kempe.views.viewer.session import Session

if TYPE_CHECKING:
    from kempe.model.system import FrameLike, System

PORT = 8080
"""The first port that is tried; of those that follow, the first that is free is taken."""
PANEL = 324
"""Pixels that the panel takes beside the picture when a page is opened."""
SHEET = 576
"""Pixels up to which a page is so narrow that viser lays the panel over the picture, from below, as
on phones."""
COVERED = 0.6
"""Part of the height that it covers there at most."""
SAME_VIEW = 1e-4
"""Parts of its distance by which a camera may be off the one that pages begin with, to count as
that."""


def show(
    system: System,
    q: Any = None,
    *,
    frame: FrameLike | None = None,
    path: Any = None,
    share: bool = False,
    port: int | None = None,
    browser: bool = True,
    deg: bool = False,
) -> Viewer:
    """A `Viewer`: the page at its `url`, on this machine only, where the system is seen and moved
    with the mouse.

    `q` (nq,) or dict: the configuration, by default as for `plot`; loops that are open there are
    closed from it. `frame`: the one that the gizmo drags (default: the last one declared). `path`:
    configurations (n, nq), or an answer that has them as `.q`, to play. Each page that is opened
    has a configuration of its own, with `share` all have one. `port`: that of the page, by default
    8080 or the next that is free. `browser`: open one. `deg`: pages begin with angles in degrees; a
    switch on the page changes that. The page is there until `close`, the end of a ``with``, or the
    end of Python. A `UserWarning` names the meshes that are not drawn. Errors: `InputError` for
    shapes and a port that is in use; `UnknownNameError` for a frame.
    """
    opened = flag(browser, "browser")
    viewer = serve(system, q, frame, path, share, port, deg)
    if said := viewer.drawn.lost_sentence:
        warn(said, UserWarning)
    if opened:
        webbrowser.open(viewer.url)
    return viewer


def serve(
    system: System,
    q: Any = None,
    frame: FrameLike | None = None,
    path: Any = None,
    share: bool = False,
    port: int | None = None,
    deg: bool = False,
) -> Viewer:
    """A `Viewer` as `show` makes it, without a browser and without a warning about meshes."""
    shared = flag(share, "share")
    degrees = flag(deg, "deg")
    return Viewer(Session(system, q, frame, path), shared, _checked(port), degrees)


class Viewer:
    """A page that is served: `url` is its address, `q` (nq,) the configuration of the page that was
    moved last.
    """

    def __init__(self, session: Session, share: bool, port: int, deg: bool = False):
        self.session = session
        self.share = share
        self.system = session.system
        self.deg = deg
        self.drawn = Drawn(
            session.system, session.q, None if session.motion is None else session.motion.q
        )
        self.pages: dict[int, Page] = {}
        self._last = session
        self._closed = threading.Event()
        self.server = PageServer(port, self.system.name)
        self.server.gui.main_panel.dock_right()
        self.server.scene.set_up_direction("+y" if self.system.dim == 2 else "+z")
        self.drawn.look_from(self.server.initial_camera)
        self.server.on_client_connect(self._connected)
        self.server.on_client_disconnect(self._gone)

    @property
    def url(self) -> str:
        """The address of the page; it has a token without which the page answers nothing."""
        return self.server.url

    @property
    def q(self) -> Array:
        """The configuration (nq,) of the page that was moved last."""
        return self._last.q.copy()

    @q.setter
    def q(self, q: Any) -> None:
        """Put all pages at a configuration (nq,) or dict. Errors: `InputError`."""
        for session in {
            id(s): s for s in (self.session, *(p.session for p in self.pages.values()))
        }.values():
            with session.lock:
                session.put(q)
                for page in (p for p in tuple(self.pages.values()) if p.session is session):
                    page.show()

    def moved(self, page: Page) -> None:
        """Show what a page did, on all pages that have the same configuration."""
        self._last = page.session
        for other in tuple(self.pages.values()):
            if other.session is page.session:
                other.show()

    def _connected(self, client: Any) -> None:
        session = self.session if self.share else copy.copy(self.session)
        session.lock = self.session.lock if self.share else threading.RLock()
        client.camera.max_orbit_distance = float("inf")
        client.camera.min_orbit_distance = self.drawn.near
        # later without the panel
        wide = client.camera.image_width
        high = client.camera.image_height
        below = COVERED if wide <= SHEET else 0.0  # a width of 575 may be reported as 576
        aspect = (wide if below else wide - PANEL) / high
        if below or aspect < 1.0:
            client.camera.on_update(partial(self._uncover, aspect=aspect, below=below))
            self.drawn.look_from(client.camera, aspect, below)
        self.pages[client.client_id] = Page(self, client, session, self.drawn)

    def _uncover(self, camera: Any, aspect: float, below: float) -> None:
        """Put a camera that is where pages begin, late or by "Reset View", past the panel."""
        begin = self.server.initial_camera
        off = np.linalg.norm([camera.position - begin.position, camera.look_at - begin.look_at])
        if off <= SAME_VIEW * np.linalg.norm(begin.position - begin.look_at):
            self.drawn.look_from(camera, aspect, below)

    def _gone(self, client: Any) -> None:
        page = self.pages.pop(client.client_id, None)
        if page is not None:
            page.close()

    def wait(self) -> None:
        """Hold the program until the page is closed; Ctrl-C closes it."""
        try:
            while not self._closed.wait(0.2):
                pass
        except KeyboardInterrupt:
            self.close()

    def close(self) -> None:
        """End the page."""
        if not self._closed.is_set():
            self._closed.set()
            for page in tuple(self.pages.values()):
                page.close()
            quiet(self.server.stop)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"Viewer of {self.system.name!r} at {self.url}" + (
            ", closed" if self._closed.is_set() else ""
        )


def _checked(port: Any) -> int:
    """A port that can be taken. Errors: `InputError`."""
    if port is None:
        return PORT
    if not is_whole(port) or not 0 <= port < 65536:
        raise InputError(f"port is {port!r}; it must be a whole number from 0 to 65535")
    with socket.socket() as trial:
        trial.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            trial.bind((HOST, int(port)))
        except OSError as error:
            free = "leave it out, and a free one is taken"
            raise InputError(f"port {port} cannot be used ({error.strerror}): {free}") from None
    return int(port)
