"""The page of `system.show()`, on which a system is seen and moved; it is served by viser.

Needs the extra [view]. Errors: `MissingExtraError` without viser or trimesh.
"""

from __future__ import annotations

import copy
import html
import socket
import threading
import time
import traceback
import webbrowser
from collections.abc import Callable, Iterator
from functools import partial
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from kempe import spatial
from kempe.arguments import read_flag
from kempe.arrays import is_whole
from kempe.errors import InputError, KempeError, warn
from kempe.model.configurations import has_loops
from kempe.spatial import Array
from kempe.views.drawing import style
from kempe.views.drawing.labels import fit_sentence, shorten_label
from kempe.views.drawing.solids import parse_colour
from kempe.views.viewer.overlays import Overlay, iterate_rounds, list_offered_overlays
from kempe.views.viewer.scene_nodes import Drawn, Nodes, split_poses
from kempe.views.viewer.server import HOST, PageServer, silence_action
from kempe.views.viewer.session import KINDS, Session, Slider, list_possible_motions

if TYPE_CHECKING:
    from kempe.model.model import FrameLike, Model


# ---- work beside the page

# Searches and overlays are computed in a thread, while the page goes on.

DEFECTS = (
    ArithmeticError,
    AssertionError,
    AttributeError,
    LookupError,
    MemoryError,
    OSError,
    RuntimeError,
    TypeError,
    ValueError,
)
"""What a mistake in the code raises, or a machine that has no more room."""
Action = Callable[[], Any]
"""What the page does with what was found."""


class Job:
    """A computation in rounds, each of which gives an action for the page; `dropped` once nobody
    waits for it.
    """

    def __init__(self, key: str, work: Callable[[Callable[..., None]], Iterator[Action]]):
        self.key = key
        self.dropped = False
        self.rounds = work(self.check)

    def check(self, *done: object) -> None:
        """Raise `KeyboardInterrupt` if nobody waits: verbs whose progress this is then end with
        what they have.
        """
        if self.dropped:
            raise KeyboardInterrupt


class Beside:
    """A thread that does jobs round by round, in turn, those begun last first; actions are given to
    `post`.

    `post(key, action)` is called for each round, with a key of its own, and `failed(sentence)` is
    the action where a round raised a `KempeError`, or anything else, whose traceback is then
    printed.
    """

    def __init__(self, post: Callable[[str, Action], None], failed: Callable[[str], Any]):
        self.post = post
        self.failed = failed
        self.jobs = list[Job]()
        self.ready = threading.Condition()
        self.open = True
        threading.Thread(target=self._work, daemon=True).start()

    def start(self, key: str, work: Callable[[Callable[..., None]], Iterator[Action]]) -> None:
        """Begin a job in place of the one with the same key."""
        with self.ready:
            self.drop(key)
            self.jobs.insert(0, Job(key, work))
            self.ready.notify()

    def drop(self, key: str | None = None) -> None:
        """End the job of a key, or all."""
        with self.ready:
            for job in tuple(self.jobs):
                if key in (None, job.key):
                    job.dropped = True
                    self.jobs.remove(job)

    def close(self) -> None:
        """End the thread."""
        with self.ready:
            self.open = False
            self.drop()
            self.ready.notify()

    def _work(self) -> None:
        count = 0
        while True:
            with self.ready:
                while self.open and not self.jobs:
                    self.ready.wait()
                if not self.open:
                    return
                job = self.jobs[0]
            try:
                action = next(job.rounds, None)
            except KempeError as error:
                action = self._refused(job, str(error))
            except KeyboardInterrupt:
                action = None
            except DEFECTS as error:  # the page goes on, and the terminal has where it was
                traceback.print_exc()
                action = self._refused(
                    job, f"not done, by a defect of Kempe: {type(error).__name__}: {error}"
                )
            count += 1
            if action is not None:
                self.post(f"{job.key} {count}", self._if_wanted(job, action))
            with self.ready:
                if job in self.jobs:
                    self.jobs.remove(job)
                    if action is not None and not job.dropped:
                        self.jobs.append(job)

    def _refused(self, job: Job, text: str) -> Action:
        job.rounds = iter(())
        return lambda: self.failed(text)

    @staticmethod
    def _if_wanted(job: Job, action: Action) -> Action:
        return lambda: None if job.dropped else action()


# ---- the player of motions

# The slider and the button with which a motion is played, and the buttons that find one.

FRAMES = 30.0
"""Frames a second of a motion that is played."""


class Player:
    """What a page shows of motions; `motion` is the one that its slider is for."""

    def __init__(self, page: Page):
        self.page = page
        self.motion = page.session.motion
        self.playing = False
        gui = page.client.gui
        with gui.add_folder("motion") as self.folder:
            self.finds: Any = None
            self.time: Any = None
            self.play = gui.add_button("play", color="gray", visible=False)
        self.play.on_click(self._pressed)
        self.make_finds()
        self.make_time()

    def make_finds(self) -> None:
        """Make the buttons that find motions, where the frame and what counts of it allow any."""
        if self.finds is not None:
            self.finds.remove()
        page = self.page
        names = list_possible_motions(page.session)
        with self.folder:
            self.finds = (
                page.buttons("find", {n: lambda n=n: page.find(n) for n in names})
                if names
                else None
            )
        self.folder.visible = bool(names) or page.session.motion is not None

    def make_time(self) -> None:
        """Make the slider of the motion that is played."""
        page = self.page
        self.motion = motion = page.session.motion
        if motion is None:
            return
        if self.time is not None:
            self.time.remove()
        label, last = ("time [s]", motion.duration) if motion.timed else ("part", 1.0)
        with self.folder:
            self.time = page.client.gui.add_slider(
                label, 0.0, last, last / 1000.0, 0.0, order=self.play.order - 0.5
            )
        scale = motion.duration / last
        self.time.on_update(
            page.by_hand("time", lambda h=self.time: page.session.at(scale * h.value))
        )
        self.folder.visible = self.play.visible = True

    async def _pressed(self, event: Any) -> None:
        self.playing = not self.playing
        self.play.label = "stop" if self.playing else "play"
        if self.playing:
            threading.Thread(target=self._run, daemon=True).start()

    def _run(self) -> None:
        page = self.page
        bar = self.time
        motion = self.motion
        if motion is None:
            return
        part = bar.value if bar.value < bar.max else 0.0
        while self.playing and page.open and bar is self.time:
            part = (part + bar.max / (motion.duration * FRAMES)) % bar.max

            def there(x: float = part) -> None:
                page.session.at(x * motion.duration / bar.max)
                bar.value = x

            page.post("play", there)
            time.sleep(1.0 / FRAMES)
        self.playing = False
        if page.open:
            self.play.label = "play"


# ---- the page

# The panel, the gizmo and the ghosts of a session, by viser. It only passes on.

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
                self.gizmo.wxyz, self.gizmo.position = split_poses(session.pose)
            self._miss()
            said = format_html(fit_sentence(session.said()))
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
            # an angle without limits: the slider goes along
            if not handle.min <= slider.value <= handle.max:
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
            self.boxes = {
                name: gui.add_checkbox(name, False) for name in list_offered_overlays(session)
            }
            self.names = gui.add_checkbox("names", False)
            self.axes = gui.add_checkbox("axes of frames", False)
            self.degrees = gui.add_checkbox("degrees", self.viewer.deg)
        self.player = Player(self)
        if drawn.lost:
            gui.add_html(format_html(fit_sentence(drawn.lost_sentence)))
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
                    f"{shorten_label(s.name)} [{s.unit}]",
                    s.low,
                    s.high,
                    _choose_slider_step(s),
                    s.value,
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
        quat, place = split_poses(session.pose)
        self.gizmo = self.client.scene.add_transform_controls(
            "/target",
            scale=0.22 * max(self.nodes.drawn.rigid.size, 1e-9),
            active_axes=(True, True, not flat),
            disable_rotations=flat or session.task == "position",
            depth_test=False,
            wxyz=quat,
            position=place,
        )
        colour = np.round(255 * np.array(parse_colour(style.OPEN))).astype(np.uint8)
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
            yield lambda: setattr(self.counted, "content", format_html(fit_sentence(text)))

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
            for k, overlay in enumerate(iterate_rounds(session, name)):
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


def format_html(text: str) -> str:
    """A text as HTML that shows it letter by letter; empty lines part its paragraphs.

    Names come from files, and viser's Markdown would run what HTML is in them.
    """
    return "".join(PARAGRAPH.format(html.escape(part)) for part in text.split("\n\n") if part)


def _choose_slider_step(slider: Slider) -> float:
    """The step of a slider: a round number, STEPS of them or more."""
    wide = max(slider.high - slider.low, 1e-9)
    return float(10.0 ** np.floor(np.log10(wide / STEPS)))


# ---- showing and serving

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
    system: Model,
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
    opened = read_flag(browser, "browser")
    viewer = serve_viewer(system, q, frame, path, share, port, deg)
    if said := viewer.drawn.lost_sentence:
        warn(said, UserWarning)
    if opened:
        webbrowser.open(viewer.url)
    return viewer


def serve_viewer(
    system: Model,
    q: Any = None,
    frame: FrameLike | None = None,
    path: Any = None,
    share: bool = False,
    port: int | None = None,
    deg: bool = False,
) -> Viewer:
    """A `Viewer` as `show` makes it, without a browser and without a warning about meshes."""
    shared = read_flag(share, "share")
    degrees = read_flag(deg, "deg")
    return Viewer(Session(system, q, frame, path), shared, _check_port(port), degrees)


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
            silence_action(self.server.stop)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"Viewer of {self.system.name!r} at {self.url}" + (
            ", closed" if self._closed.is_set() else ""
        )


def _check_port(port: Any) -> int:
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
