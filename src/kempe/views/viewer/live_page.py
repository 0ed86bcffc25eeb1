"""One page in a browser: the panel, the gizmo and the ghosts of a session, by viser. It only passes on."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe import spatial
from kempe.errors import KempeError
from kempe.views.drawing import style
from kempe.views.drawing.solids import rgb
from kempe.views.viewer.scene_nodes import Drawn, Nodes, poses_as
from kempe.views.viewer.session import Session, Slider

if TYPE_CHECKING:
    from kempe.views.viewer.live import Viewer

STEPS = 2000
"""Places of a slider."""
FRAMES = 30.0
"""Frames a second of a motion that is played."""
SLOW = 4.0
"""Seconds in which a path is played."""
SLIDE = 0.1
"""Seconds between two updates of sliders while something else is dragged."""
PAUSE = 0.25
"""Seconds of rest after which the slower sentences are said."""


class Page:
    """A page, its client in viser, and the session that it shows. Events are answered one after the other by a thread.

    Of events of the same control that wait, only the last is answered.
    """

    def __init__(self, viewer: Viewer, client: Any, session: Session, drawn: Drawn):
        self.viewer, self.client, self.session = viewer, client, session
        self.waiting: dict[str, Callable[[], Any]] = {}
        self.ready, self.open, self.playing, self.dragging = threading.Condition(), True, False, ""
        self.spent: list[float] = []
        self.revision = -1
        self.nodes = Nodes(client.scene, drawn, session.q)
        self.sliders: dict[str, Any] = {}
        self.arrived = self.slid = 0.0
        with client.atomic():
            self._panel(drawn)
            self._gizmo()
        threading.Thread(target=self._work, daemon=True).start()
        self.post("first", lambda: None)

    # ---- events

    def post(self, key: str, action: Callable[[], Any]) -> None:
        """Append an action to those that wait, in place of one with the same key."""
        with self.ready:
            if not self.waiting:
                self.arrived = time.perf_counter()
            self.waiting[key] = action
            self.ready.notify()

    def close(self) -> None:
        """End the thread of the page."""
        with self.ready:
            self.open = False
            self.ready.notify()

    def _work(self) -> None:
        slow = False
        while True:
            with self.ready:
                while self.open and not self.waiting:
                    if not self.ready.wait(PAUSE if slow else None) and not self.waiting:
                        break
                if not self.open:
                    return
                arrived = self.arrived
                action = self.waiting.pop(next(iter(self.waiting))) if self.waiting else None
                self.arrived = time.perf_counter()
            if action is None:
                slow = False
                with self.client.atomic():
                    self._slide()
                    self.counted.content = self.session.mobility()
                continue
            try:
                with self.viewer.lock:
                    action()
                    self.viewer.moved(self)
            except KempeError as error:
                self.session.status = str(error)
                self.show()
            self.spent.append(time.perf_counter() - arrived)
            del self.spent[:-1000]
            slow = True

    def show(self) -> None:
        """Show what the session is now, at once."""
        session = self.session
        if self.revision != session.revision:
            self._make_sliders()
        with self.client.atomic():
            self.nodes.move(session.q)
            self.nodes.haunt(session.solutions, self._clicked)
            if time.perf_counter() - self.slid > SLIDE:
                self._slide()
            if self.dragging != "gizmo":
                self.gizmo.wxyz, self.gizmo.position = poses_as(session.pose)
            self._miss()
            said = session.said()
            if self.said.content != said:
                self.said.content = said

    def _slide(self) -> None:
        """Put the sliders where the coordinates are, but for the one that is dragged."""
        self.slid = time.perf_counter()
        for slider in self.session.sliders:
            handle = self.sliders.get(slider.name)
            if handle is not None and slider.name != self.dragging and abs(handle.value - slider.value) > 1e-9:
                handle.value = min(max(slider.value, handle.min), handle.max)

    def _miss(self) -> None:
        """Draw the way from the frame to a target that it does not reach."""
        target = self.session.target
        ends = np.zeros((1, 2, 3), dtype=np.float32)
        if target is not None:
            ends[0] = self.session.pose[:3, 3], target[:3, 3]
        if not np.allclose(self.miss.points, ends):
            self.miss.points = ends

    # ---- what is on the page

    def _panel(self, drawn: Drawn) -> None:
        gui, session = self.client.gui, self.session
        gui.configure_theme(show_logo=False, show_share_button=False, control_width="medium")
        gui.set_panel_label(session.system.name)
        self.counted = gui.add_markdown("")
        self.said = gui.add_markdown("")
        self.folder = gui.add_folder("coordinates")
        with gui.add_folder("frame"):
            self.frame = gui.add_dropdown("frame", session.frames, initial_value=session.frame)
            self.task = gui.add_dropdown("what counts", ("pose", "position"), initial_value=session.task)
            self._button("other solutions", lambda: session.solve() or self._none())
            self._button("next solution", session.next_solution)
            self._button("curve, points it reaches", self._curve)
            self._button("motion with it at rest", self._self_motion)
        with gui.add_folder("go to"):
            self._button("next assembly mode", session.next_mode)
            self._button("random", session.random)
            for name in session.postures:
                self._button(name, lambda n=name: session.go(n))
        with gui.add_folder("motion", visible=session.path is not None) as self.motion:
            self.time = gui.add_slider("part", 0.0, 1.0, 0.001, 0.0)
            self.play = gui.add_button("play")
        if drawn.lost:
            gui.add_markdown(f"{len(drawn.lost)} meshes could not be shown, such as {drawn.lost[0]}")
        self.frame.on_update(self._by_hand("frame", lambda: self._aim(self.frame.value)))
        self.task.on_update(self._by_hand("task", lambda: self._aim(self.frame.value, self.task.value)))
        self.time.on_update(self._by_hand("time", lambda: session.at(self.time.value)))
        self.play.on_click(self._play)

    def _button(self, label: str, action: Callable[[], Any]) -> None:
        button = self.client.gui.add_button(label)
        button.on_click(self._by_hand(label, action))

    def _by_hand(self, key: str, action: Callable[[], Any]) -> Any:
        """A callback of viser that posts an action where a person caused the event."""

        async def called(event: Any) -> None:
            if event.client is not None:
                self.dragging = key if key in self.sliders else ""
                self.post(key, action)

        return called

    def _make_sliders(self) -> None:
        session, gui = self.session, self.client.gui
        self.revision = session.revision
        wanted = session.sliders
        if tuple(s.name for s in wanted) == tuple(self.sliders):
            return
        for handle in self.sliders.values():
            handle.remove()
        self.sliders = {}
        with self.folder:
            for s in wanted:
                handle = gui.add_slider(f"{s.name} [{s.unit}]", s.low, s.high, _step(s), s.value)
                self.sliders[s.name] = handle
                handle.on_update(self._by_hand(s.name, lambda n=s.name, h=handle: session.set(n, float(h.value))))

    def _gizmo(self) -> None:
        session, flat = self.session, self.session.system.dim == 2
        quat, place = poses_as(session.pose)
        self.gizmo = self.client.scene.add_transform_controls(
            "/target", scale=0.22 * max(self.nodes.drawn.rigid.size, 1e-9), active_axes=(True, True, not flat),
            disable_rotations=flat or session.task == "position", depth_test=False, wxyz=quat, position=place,
        )  # fmt: skip
        colour = np.round(255 * np.array(rgb(style.OPEN))).astype(np.uint8)
        self.miss = self.client.scene.add_line_segments("/missed", np.zeros((1, 2, 3)), colour, line_width=3.0)

        @self.gizmo.on_update
        async def _(event: Any) -> None:
            if event.client is None:
                return
            X = np.eye(4)
            X[:3, :3] = spatial.quat_wxyz_to_matrix(np.asarray(event.target.wxyz))
            X[:3, 3] = event.target.position
            last = event.phase == "end"
            self.dragging = "" if last else "gizmo"
            self.post("end" if last else "gizmo", lambda: self._reach(X, last))

    # ---- actions

    def _reach(self, X: Any, last: bool) -> None:
        ghosts = len(self.session.solutions)
        self.session.reach(X, quick=not last)
        if ghosts:
            self.session.solve()

    def _none(self) -> None:
        self.session.status = f"no other solution is known with {self.session.frame} here"

    def _aim(self, frame: str, task: str | None = None) -> None:
        self.session.aim(frame, task)
        if self.task.value != self.session.task:
            self.task.value = self.session.task
        self.gizmo.disable_rotations = self.session.system.dim == 2 or self.session.task == "position"

    async def _clicked(self, event: Any) -> None:
        if event.instance_index is not None:
            self.post("ghost", lambda: self.session.choose(int(event.instance_index)))

    def _curve(self) -> None:
        scene, session = self.client.scene, self.session
        points = np.asarray(session.curve(), dtype=np.float32)
        points = points[np.isfinite(points).all(axis=1)]
        colour = np.round(255 * np.array(rgb(style.curve_colour(0)))).astype(np.uint8)
        scene.remove_by_name("/curve")
        if session.is_curve and len(points) > 1:
            scene.add_line_segments("/curve", np.stack([points[:-1], points[1:]], axis=1), colour, line_width=2.5)
        elif len(points):
            scene.add_point_cloud("/curve", points, colour, point_size=0.25 * self.nodes.drawn.rigid.r)

    def _self_motion(self) -> None:
        self.motion.visible = self.session.self_motion() or self.session.path is not None

    async def _play(self, event: Any) -> None:
        self.playing = not self.playing
        self.play.label = "stop" if self.playing else "play"
        if self.playing:
            threading.Thread(target=self._run, daemon=True).start()

    def _run(self) -> None:
        part = self.time.value if self.time.value < 1.0 else 0.0
        while self.playing and self.open:
            part = (part + 1.0 / (SLOW * FRAMES)) % 1.0

            def there(x: float = part) -> None:
                self.session.at(x)
                self.time.value = x

            self.post("play", there)
            time.sleep(1.0 / FRAMES)


def _step(slider: Slider) -> float:
    """The step of a slider: a round number, STEPS of them or more."""
    wide = max(slider.high - slider.low, 1e-9)
    return float(10.0 ** np.floor(np.log10(wide / STEPS)))
