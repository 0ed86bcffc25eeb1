"""One page in a browser: the panel, the gizmo and the ghosts of a session, by viser. It only passes
on.
"""

from __future__ import annotations

import copy
import html
import threading
import time
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe import spatial
from kempe.errors import KempeError
from kempe.kinematics.configuration import has_loops
from kempe.views.drawing import style
from kempe.views.drawing.labels import fitting, shortened
from kempe.views.drawing.solids import rgb
from kempe.views.viewer.beside import Action, Beside
from kempe.views.viewer.overlays import Overlay, offered, rounds
from kempe.views.viewer.player import Player
from kempe.views.viewer.scene_nodes import Drawn, Nodes, poses_as
from kempe.views.viewer.session import KINDS, Session, Slider

if TYPE_CHECKING:
    from kempe.views.viewer.live import Viewer

STEPS = 2000
"""Places of a slider."""
SLIDE = 0.1
"""Seconds between two updates of sliders while something else is dragged."""
PAUSE = 0.25
"""Seconds of rest after which the slower sentences are said."""
SEES = 1.85
"""Height of the picture, in parts of the farthest that shall be in it."""
DEGREE = np.pi / 180.0
ROUNDING = 1e-12
"""How far [rad] a limit in degrees may be from the limit by rounding."""
PARAGRAPH = (
    '<p style="margin:0;padding:0 .75rem .6rem;font-size:14px;overflow-wrap:anywhere">{}</p>'
)
"""How a sentence looks in the panel."""
QUICK = 0.1
"""Seconds that a search may take which is repeated while a target is dragged."""


class Page:
    """A page, its client in viser, and the session that it shows. Events are answered one after the
    other by a thread.

    Of events of the same control that wait, only the last is answered.
    """

    def __init__(self, viewer: Viewer, client: Any, session: Session, drawn: Drawn):
        self.viewer = viewer
        self.client = client
        self.session = session
        self.waiting: dict[str, Callable[[], Any]] = {}
        self.ready = threading.Condition()
        self.open = True
        self.dragging = ""
        self.spent: list[float] = []
        self.revision = -1
        self.nodes = Nodes(client.scene, drawn, session.q)
        self.sliders: dict[str, Any] = {}
        self.made: tuple[tuple[str, str], ...] = ()
        self.arrived = self.slid = 0.0
        self.searches = Beside(self.post, self._say)
        self.overlays = Beside(self.post, self._say)
        self.follow = False
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
        """End the threads of the page."""
        self.searches.close()
        self.overlays.close()
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
                self._count()
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
            if "curve" in self.boxes and session.motion is None:
                self._lay("curve")
        if self.player.motion is not session.motion:
            self.player.make_time()
            if "curve" in self.boxes:
                self._lay("curve")
        with self.client.atomic():
            self.nodes.move(session.q)
            self.nodes.haunt(session.solutions, self._clicked)
            if time.perf_counter() - self.slid > SLIDE:
                self._slide()
            if self.dragging != "gizmo":
                self.gizmo.wxyz, self.gizmo.position = poses_as(session.pose)
            self._miss()
            said = as_html(fitting(session.said()))
            if self.said.content != said:
                self.said.content = said

    def _slide(self) -> None:
        """Put the sliders where the coordinates are, but for the one that is dragged."""
        self.slid = time.perf_counter()
        for slider in map(self._in_units, self.session.sliders):
            handle = self.sliders.get(slider.name)
            if (
                handle is None
                or slider.name == self.dragging
                or abs(handle.value - slider.value) <= 1e-9
            ):
                continue
            if (
                not handle.min <= slider.value <= handle.max
            ):  # an angle without limits: the slider goes along
                handle.min = slider.low
                handle.max = slider.high
            handle.value = slider.value

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
        gui = self.client.gui
        session = self.session
        gui.configure_theme(show_logo=False, show_share_button=False)
        gui.set_panel_label(session.system.name)
        self.counted = gui.add_html("")
        self.said = gui.add_html("")
        self.folder = gui.add_folder("coordinates")
        gos = {name: lambda n=name: session.go(n) for name in session.postures}
        self.buttons("go to", {"random": session.random} | gos)
        with gui.add_folder("frame"):
            self.frame = gui.add_dropdown("frame", session.frames, initial_value=session.frame)
            self.task = gui.add_dropdown(
                "what counts", ("pose", "position"), initial_value=session.task
            )
            self._pair("other solutions", "solution")
            if has_loops(session.system):
                self._pair("assembly modes", "mode")
        with gui.add_folder("show"):
            self.boxes = {name: gui.add_checkbox(name, False) for name in offered(session)}
            self.names = gui.add_checkbox("names", False)
            self.axes = gui.add_checkbox("axes of frames", False)
            self.degrees = gui.add_checkbox("degrees", self.viewer.deg)
        self.player = Player(self)
        if drawn.lost:
            gui.add_html(as_html(fitting(drawn.lost_sentence)))
        self.frame.on_update(self.by_hand("frame", lambda: self._aim(self.frame.value)))
        self.task.on_update(
            self.by_hand("task", lambda: self._aim(self.frame.value, self.task.value))
        )
        for name, box in self.boxes.items():
            box.on_update(self.by_hand(name, lambda n=name: self._lay(n)))
        self.names.on_update(self.by_hand("names", lambda: self.nodes.name(self.names.value)))
        self.degrees.on_update(self.by_hand("degrees", self._make_sliders))
        self.axes.on_update(self.by_hand("axes", lambda: self.nodes.mark(self.axes.value)))

    def buttons(self, label: str, actions: dict[str, Action]) -> Any:
        """Add buttons in a row, each with its action; what was added."""
        group = self.client.gui.add_button_group(label, tuple(actions))
        group.on_click(self.by_hand(label, lambda: actions[group.value]()))
        return group

    def _pair(self, label: str, kind: str) -> None:
        self.buttons(label, {"show": lambda: self._solve(kind), "next": lambda: self._next(kind)})

    def by_hand(self, key: str, action: Action) -> Any:
        """A callback of viser that posts an action where a person caused the event."""

        async def called(event: Any) -> None:
            if event.client is not None:
                self.dragging = key if key in self.sliders else ""
                self.follow = False
                self.post(key, action)

        return called

    def _make_sliders(self) -> None:
        session = self.session
        gui = self.client.gui
        self.revision = session.revision
        wanted = tuple(map(self._in_units, session.sliders))
        made = tuple((s.name, s.unit) for s in wanted)
        if made == self.made:
            return
        self.made = made
        for handle in self.sliders.values():
            handle.remove()
        self.sliders = {}
        with self.folder:
            for s in wanted:
                handle = gui.add_slider(
                    f"{shortened(s.name)} [{s.unit}]", s.low, s.high, _step(s), s.value
                )
                self.sliders[s.name] = handle
                handle.on_update(
                    self.by_hand(
                        s.name, lambda n=s.name, u=s.unit, h=handle: self._set(n, u, h.value)
                    )
                )

    def _set(self, name: str, unit: str, value: float) -> None:
        """Set a coordinate to the value of its slider; an end of a slider in degrees is the limit,
        without rounding.
        """
        if unit == "deg":
            ends = (s for s in self.session.sliders if s.name == name)
            value = next(
                (x for s in ends for x in (s.low, s.high) if abs(value * DEGREE - x) < ROUNDING),
                value * DEGREE,
            )
        self.session.set(name, float(value))

    def _in_units(self, slider: Slider) -> Slider:
        """A slider as the page shows it: angles in degrees where these are wanted."""
        if slider.unit != "rad" or not self.degrees.value:
            return slider
        return Slider(slider.name, "deg", *(x / DEGREE for x in slider[2:]))

    def _gizmo(self) -> None:
        session = self.session
        flat = self.session.system.dim == 2
        quat, place = poses_as(session.pose)
        self.gizmo = self.client.scene.add_transform_controls(
            "/target",
            scale=0.22 * max(self.nodes.drawn.rigid.size, 1e-9),
            active_axes=(True, True, not flat),
            disable_rotations=flat or session.task == "position",
            depth_test=False,
            wxyz=quat,
            position=place,
        )
        colour = np.round(255 * np.array(rgb(style.OPEN))).astype(np.uint8)
        self.miss = self.client.scene.add_line_segments(
            "/missed", np.zeros((1, 2, 3)), colour, thickness=3.0, thickness_units="screen"
        )

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
        session = self.session
        session.reach(X, quick=not last)
        if self.follow and session.took < QUICK:
            said = session.status
            session.solve()
            session.status = said
        elif self.follow and last:
            self._solve("solution")

    def _aim(self, frame: str, task: str | None = None) -> None:
        self.session.aim(frame, task)
        for name in self.boxes:
            self._lay(name)
        if self.task.value != self.session.task:
            self.task.value = self.session.task
        self.gizmo.disable_rotations = (
            self.session.system.dim == 2 or self.session.task == "position"
        )
        self.player.make_finds()

    async def _clicked(self, event: Any) -> None:
        if event.instance_index is not None:
            self.post("ghost", lambda: self.session.choose(int(event.instance_index)))

    # ---- what is computed beside

    def _say(self, text: str) -> None:
        """Set what is said."""
        self.session.status = text

    def _beside(self, where: Beside, key: str, work: Callable[[Session], Iterator[Action]]) -> None:
        """Begin to compute with a copy of the session as it is now."""
        session = copy.copy(self.session)

        def rounds(check: Callable[..., None]) -> Iterator[Action]:
            session.progress = check
            return work(session)

        where.start(key, rounds)

    def _count(self) -> None:
        """Say the degrees of freedom, which takes long for large systems."""

        def work(session: Session) -> Iterator[Action]:
            text = session.mobility()
            yield lambda: setattr(self.counted, "content", as_html(fitting(text)))

        self._beside(self.searches, "freedoms", work)

    def _solve(self, kind: str, then: Action | None = None) -> None:
        """Find other configurations; those that are found where the system still is are shown."""

        def take(found: Session) -> None:
            session = self.session
            if session.q is found.q:
                session.solutions = found.solutions
                session.kind = kind
                session.status = found.status
                session.took = found.took
                self.follow = kind == "solution" and len(found.solutions) > 0
                if then is not None and len(found.solutions):
                    then()

        def work(session: Session) -> Iterator[Action]:
            session.solve(kind)
            yield lambda: take(session)

        self.session.status = f"looking for other {KINDS[kind]}s ..."
        self._beside(self.searches, "search", work)

    def _next(self, kind: str) -> None:
        """Go to the next configuration of a kind, which is looked for if none is known."""
        if self.session.kind == kind and len(self.session.solutions):
            self.session.next(kind)
            self.follow = kind == "solution"
        else:
            self._solve(kind, lambda: self.session.next(kind))

    def find(self, name: str) -> None:
        """Find a motion from here, to be played."""

        def take(found: Session, has: bool) -> None:
            self.session.status = found.status
            if has:
                self.session.motion = found.motion

        def work(session: Session) -> Iterator[Action]:
            has = session.find_motion(name)
            yield lambda: take(session, has)

        self.session.status = f"{name}: looked for ..."
        self._beside(self.searches, "search", work)

    def _lay(self, name: str) -> None:
        """Begin to compute what is laid over the system, and take away what was; only that where it
        is not wanted.
        """
        self.nodes.lay(name, None)
        self.overlays.drop(name)
        if not self.boxes[name].value:
            return

        def take(overlay: Overlay, first: bool) -> None:
            self.session.status = overlay.said
            self.nodes.lay(name, overlay)
            if first:
                self._step_back(overlay)

        def work(session: Session) -> Iterator[Action]:
            for k, overlay in enumerate(rounds(session, name)):
                yield lambda x=overlay, first=not k: take(x, first)

        self.session.status = f"{name}: being computed"
        self._beside(self.overlays, name, work)

    def _step_back(self, overlay: Overlay) -> None:
        """Move the camera back until what is laid over the system is in the picture."""
        if not len(overlay.extent):
            return
        camera = self.client.camera
        (low, high) = overlay.extent
        away = camera.position - camera.look_at
        at = np.array(camera.look_at)
        far = float(np.linalg.norm(np.maximum(np.abs(high - at), np.abs(low - at))))
        far *= 0.5 * SEES / np.tan(0.5 * camera.fov)
        if np.linalg.norm(away) < far:
            camera.position = at + away * (far / np.linalg.norm(away))
            camera.look_at = at


def as_html(text: str) -> str:
    """A text as HTML that shows it letter by letter; empty lines part its paragraphs.

    Names come from files, and viser's Markdown would run what HTML is in them.
    """
    return "".join(PARAGRAPH.format(html.escape(part)) for part in text.split("\n\n") if part)


def _step(slider: Slider) -> float:
    """The step of a slider: a round number, STEPS of them or more."""
    wide = max(slider.high - slider.low, 1e-9)
    return float(10.0 ** np.floor(np.log10(wide / STEPS)))
