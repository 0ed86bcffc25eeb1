"""One page in a browser: the panel, the gizmo and the ghosts of a session, by viser. It only passes on."""

from __future__ import annotations

import copy
import threading
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe import spatial
from kempe.errors import KempeError
from kempe.kinematics.configuration import has_loops
from kempe.views.drawing import style
from kempe.views.drawing.solids import rgb
from kempe.views.viewer.motions import possible
from kempe.views.viewer.overlays import Overlay, offered, rounds
from kempe.views.viewer.scene_nodes import Drawn, Nodes, poses_as
from kempe.views.viewer.session import Session, Slider

if TYPE_CHECKING:
    from kempe.views.viewer.live import Viewer

STEPS = 2000
"""Places of a slider."""
FRAMES = 30.0
"""Frames a second of a motion that is played."""
SLIDE = 0.1
"""Seconds between two updates of sliders while something else is dragged."""
PAUSE = 0.25
"""Seconds of rest after which the slower sentences are said."""
SEES = 1.2
"""Distance of the camera, in parts of the farthest that shall be in the picture."""
NOTHING = "nothing"
"""What is chosen where nothing is laid over the system."""


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
        self.laid: object = None
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
            with self.session.lock:
                try:
                    action()
                except KempeError as error:
                    self.session.status = str(error)
                self.viewer.moved(self)
            self.spent.append(time.perf_counter() - arrived)
            del self.spent[:-1000]
            slow = True

    def show(self) -> None:
        """Show what the session is now, at once."""
        session = self.session
        if self.revision != session.revision:
            self._make_sliders()
            if self.over.value == "curve" and session.motion is None:
                self._lay()
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
        gui.configure_theme(show_logo=False, show_share_button=False)
        gui.set_panel_label(session.system.name)
        self.counted = gui.add_markdown("")
        self.said = gui.add_markdown("")
        self.folder = gui.add_folder("coordinates")
        gos = {name: lambda n=name: session.go(n) for name in session.postures}
        self._buttons("go to", {"random": session.random} | gos)
        with gui.add_folder("frame"):
            self.frame = gui.add_dropdown("frame", session.frames, initial_value=session.frame)
            self.task = gui.add_dropdown("what counts", ("pose", "position"), initial_value=session.task)
            self._pair("other solutions", "solution")
            if has_loops(session.system):
                self._pair("assembly modes", "mode")
        with gui.add_folder("show"):
            self.over = gui.add_dropdown("over it", (NOTHING, *offered(session)), initial_value=NOTHING)
            self.names = gui.add_checkbox("names", False)
            self.axes = gui.add_checkbox("axes of frames", False)
        with gui.add_folder("motion", visible=session.motion is not None or bool(possible(session))) as self.movie:
            self._buttons("find", {n: lambda n=n: self._found(session.find_motion(n)) for n in possible(session)})
            self.time: Any = None
            self.play = gui.add_button("play", color="gray", visible=False)
            self._found(session.motion is not None)
        if drawn.lost:
            gui.add_markdown(f"{len(drawn.lost)} meshes could not be shown, such as {drawn.lost[0]}")
        self.frame.on_update(self._by_hand("frame", lambda: self._aim(self.frame.value)))
        self.task.on_update(self._by_hand("task", lambda: self._aim(self.frame.value, self.task.value)))
        self.over.on_update(self._by_hand("over it", self._lay))
        self.names.on_update(self._by_hand("names", lambda: self.nodes.name(self.names.value)))
        self.axes.on_update(self._by_hand("axes", lambda: self.nodes.mark(self.axes.value)))
        self.play.on_click(self._play)

    def _buttons(self, label: str, actions: dict[str, Callable[[], Any]]) -> None:
        """Add buttons in a row, each with its action."""
        if actions:
            group = self.client.gui.add_button_group(label, tuple(actions))

            def pressed() -> None:
                self.said.content = f"{label}: {group.value} ..."
                actions[group.value]()

            group.on_click(self._by_hand(label, pressed))

    def _pair(self, label: str, kind: str) -> None:
        self._buttons(label, {"show": lambda: self.session.solve(kind), "next": lambda: self.session.next(kind)})

    def _found(self, has: bool) -> None:
        """Make the slider of the motion that is played."""
        motion = self.session.motion
        if not has or motion is None:
            return
        if self.time is not None:
            self.time.remove()
        label, last = ("time [s]", motion.duration) if motion.timed else ("part", 1.0)
        with self.movie:
            self.time = self.client.gui.add_slider(label, 0.0, last, last / 1000.0, 0.0, order=self.play.order - 0.5)
        scale = motion.duration / last
        self.time.on_update(self._by_hand("time", lambda h=self.time: self.session.at(scale * h.value)))
        self.play.visible = True

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
        session, ghosts = self.session, len(self.session.solutions)
        session.reach(X, quick=not last)
        if ghosts and session.kind == "solution" and (last or not has_loops(session.system)):
            said = session.status
            session.solve()
            session.status = said

    def _aim(self, frame: str, task: str | None = None) -> None:
        self.session.aim(frame, task)
        self._lay()
        if self.task.value != self.session.task:
            self.task.value = self.session.task
        self.gizmo.disable_rotations = self.session.system.dim == 2 or self.session.task == "position"

    async def _clicked(self, event: Any) -> None:
        if event.instance_index is not None:
            self.post("ghost", lambda: self.session.choose(int(event.instance_index)))

    def _lay(self) -> None:
        """Begin to compute what is chosen to be laid over the system, and take away what was."""
        self.laid = token = object()
        self.nodes.lay(None)
        if self.over.value != NOTHING:
            self.session.status = f"{self.over.value}: being computed"
            threading.Thread(target=self._compute, args=(token, self.over.value, copy.copy(self.session))).start()

    def _compute(self, token: object, name: str, session: Session) -> None:
        """Send one round after the other to the page, until something else is chosen."""

        def said(text: str, overlay: Overlay | None = None, first: bool = False) -> None:
            if self.laid is token:
                self.session.status = text
                self.nodes.lay(overlay)
                if overlay is not None and first:
                    self._step_back(overlay)

        try:
            for k, overlay in enumerate(rounds(session, name)):
                if self.laid is not token or not self.open:
                    return
                self.post(f"overlay {k}", lambda x=overlay, k=k: said(x.said, x, k == 0))
        except KempeError as error:
            self.post("overlay", lambda text=str(error): said(text))

    def _step_back(self, overlay: Overlay) -> None:
        """Move the camera back until what is laid over the system is in the picture."""
        if not len(overlay.extent):
            return
        camera, (low, high) = self.client.camera, overlay.extent
        away, at = camera.position - camera.look_at, np.array(camera.look_at)
        far = float(np.linalg.norm(np.maximum(np.abs(high - at), np.abs(low - at)))) * SEES
        if np.linalg.norm(away) < far:
            camera.position = at + away * (far / np.linalg.norm(away))
            camera.look_at = at

    async def _play(self, event: Any) -> None:
        self.playing = not self.playing
        self.play.label = "stop" if self.playing else "play"
        if self.playing:
            threading.Thread(target=self._run, daemon=True).start()

    def _run(self) -> None:
        bar, motion = self.time, self.session.motion
        if motion is None:
            return
        part = bar.value if bar.value < bar.max else 0.0
        while self.playing and self.open and bar is self.time:
            part = (part + bar.max / (motion.duration * FRAMES)) % bar.max

            def there(x: float = part) -> None:
                self.session.at(x * motion.duration / bar.max)
                bar.value = x

            self.post("play", there)
            time.sleep(1.0 / FRAMES)
        self.playing = False
        self.play.label = "play"


def _step(slider: Slider) -> float:
    """The step of a slider: a round number, STEPS of them or more."""
    wide = max(slider.high - slider.low, 1e-9)
    return float(10.0 ** np.floor(np.log10(wide / STEPS)))
