"""The interactive page of `system.show()`, served by viser.

Needs the extra [view]. Errors: `MissingExtraError` without viser or trimesh.
"""

from __future__ import annotations

import copy
import html
import itertools
import socket
import threading
import time
import traceback
import webbrowser
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, Any

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
from kempe.views.viewer.dimensions import write_mechanism
from kempe.views.viewer.first_sight import fit_camera, is_in_sight
from kempe.views.viewer.overlays import Overlay, iterate_rounds, list_offered_overlays
from kempe.views.viewer.scene_nodes import Drawn, Nodes, split_poses
from kempe.views.viewer.server import HOST, ServedPages, copy_text, save_text
from kempe.views.viewer.session import KINDS, Session, list_possible_motions
from kempe.views.viewer.sliders import MANY, Slider, group_by_limb
from kempe.words import format_count

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
Work = Callable[[Callable[..., None]], Iterator[Action]]
"""What begins the rounds of a computation; the function that it gets ends one that is cancelled."""


class Job:
    """A computation in rounds, each of which gives an action for the page; `dropped` if cancelled."""

    def __init__(self, key: str, work: Work):
        self.key = key
        self.dropped = False
        self.rounds = work(self.check_cancellation)

    def check_cancellation(self, *done: object) -> None:
        """Raise `KeyboardInterrupt` if the job was cancelled; searches then end with what they
        have.
        """
        if self.dropped:
            raise KeyboardInterrupt


class Beside:
    """A thread that runs jobs round by round, in turn, the latest first; actions go to `post`.

    `post(key, action)` is called for each round, with a key of its own, and `failed(sentence)` is
    the action where a round raised a `KempeError`, or anything else, whose traceback is then
    printed.
    """

    def __init__(self, post: Callable[[str, Action], None], failed: Callable[[str], Any]):
        self.post = post
        self.failed = failed
        self.jobs = list[Job]()
        self.later: dict[str, Work] = {}
        self.ready = threading.Condition()
        self.open = True
        threading.Thread(target=self._run_jobs, daemon=True).start()

    def start_job(self, key: str, work: Work) -> None:
        """Start a job in place of the one with the same key."""
        with self.ready:
            self.drop_jobs(key)
            self.jobs.insert(0, Job(key, work))
            self.ready.notify()

    def renew_job(self, key: str, work: Work) -> None:
        """Start a job after the one with the same key; of several that wait only the last.

        So something is shown while what is computed changes all the time.
        """
        with self.ready:
            if any(job.key == key for job in self.jobs):
                self.later[key] = work
            else:
                self.start_job(key, work)

    def drop_jobs(self, key: str | None = None) -> None:
        """Cancel the job with a key, or all jobs."""
        with self.ready:
            for job in tuple(self.jobs):
                if key in (None, job.key):
                    job.dropped = True
                    self.jobs.remove(job)
            self.later = {k: work for k, work in self.later.items() if key not in (None, k)}

    def end_thread(self) -> None:
        """Cancel all jobs and end the thread."""
        with self.ready:
            self.open = False
            self.drop_jobs()
            self.ready.notify()

    def _run_jobs(self) -> None:
        """Run the jobs until the thread is ended."""
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
                action = self._refuse_job(job, str(error))
            except KeyboardInterrupt:
                action = None
            except DEFECTS as error:  # the page goes on, and the terminal has where it was
                traceback.print_exc()
                action = self._refuse_job(
                    job, f"not done, by a defect of Kempe: {type(error).__name__}: {error}"
                )
            count += 1
            if action is not None:
                self.post(f"{job.key} {count}", self._guard_action(job, action))
            with self.ready:
                if job in self.jobs:
                    self.jobs.remove(job)
                    if action is not None and not job.dropped:
                        self.jobs.append(job)
                    elif job.key in self.later:
                        self.jobs.append(Job(job.key, self.later.pop(job.key)))

    def _refuse_job(self, job: Job, text: str) -> Action:
        """End a job that failed; return the action that reports the failure."""
        job.rounds = iter(())
        return lambda: self.failed(text)

    @staticmethod
    def _guard_action(job: Job, action: Action) -> Action:
        """Wrap an action so that it does nothing once its job is cancelled."""
        return lambda: None if job.dropped else action()


# ---- the player of motions

# The slider and the button with which a motion is played, and the buttons that find one.

FRAMES = 30.0
"""Frames a second of a motion that is played."""


class Player:
    """Controls of a page for motions: buttons to find and play them, and a time slider."""

    def __init__(self, page: Page):
        self.page = page
        self.motion = page.session.motion
        self.playing = False
        gui = page.client.gui
        with gui.add_folder("motion") as self.folder:
            self.finds: Any = None
            self.time: Any = None
            self.play = gui.add_button("play", color="gray", visible=False)
        self.play.on_click(self.toggle_playing)
        self.make_finds()
        self.make_time()

    def make_finds(self) -> None:
        """Make the buttons that find motions, if the frame and the task allow any."""
        if self.finds is not None:
            self.finds.remove()
        page = self.page
        names = list_possible_motions(page.session)
        with self.folder:
            self.finds = (
                page.add_buttons("find", {n: lambda n=n: page.find_motion(n) for n in names})
                if names
                else None
            )
        self.folder.visible = bool(names) or page.session.motion is not None

    def make_time(self) -> None:
        """Make the time slider of the motion that is played."""
        page = self.page
        self.motion = motion = page.session.motion
        if self.time is not None:
            self.time.remove()
            self.time = None
        self.play.visible = motion is not None
        if motion is None:
            self.playing = False
            return
        label, last = ("time [s]", motion.duration) if motion.timed else ("part", 1.0)
        with self.folder:
            self.time = page.client.gui.add_slider(
                label, 0.0, last, last / 1000.0, 0.0, order=self.play.order - 0.5
            )
        scale = motion.duration / last
        self.time.on_update(
            page.make_callback("time", lambda h=self.time: page.session.go_to_time(scale * h.value))
        )
        self.folder.visible = True

    async def toggle_playing(self, event: Any) -> None:
        """Start or stop playing when the button or its key is pressed."""
        if self.motion is None:
            return
        self.playing = not self.playing
        self.play.label = "stop" if self.playing else "play"
        if self.playing:
            threading.Thread(target=self._play_motion, daemon=True).start()

    def _play_motion(self) -> None:
        """Play the motion in a loop until it is stopped."""
        page = self.page
        bar = self.time
        motion = self.motion
        if motion is None:
            return
        part = bar.value if bar.value < bar.max else 0.0
        while self.playing and page.open and bar is self.time:
            part = (part + bar.max / (motion.duration * FRAMES)) % bar.max

            def go_to_time(x: float = part) -> None:
                """Show the motion at a part of its duration."""
                page.session.go_to_time(x * motion.duration / bar.max)
                bar.value = x

            page.post_action("play", go_to_time)
            time.sleep(1.0 / FRAMES)
        self.playing = False
        if page.open:
            self.play.label = "play"


# ---- the page

# The panel, the gizmo and the ghosts of a session, by viser. It only passes on.

SLIDE = 0.1
"""Seconds between two updates of sliders while something else is dragged."""
PAUSE = 0.25
"""Seconds of rest after which the slower sentences are said."""
SAME_VIEW = 1e-4
"""Parts of its distance by which the view of a camera may be off another to count as that."""
TILT = np.deg2rad(50.0)
"""Angle up to which a planar system is looked at from aside."""
DEGREE = np.pi / 180.0
PARAGRAPH = (
    '<p style="margin:0;padding:0 .75rem .6rem;font-size:14px;overflow-wrap:anywhere">{}</p>'
)
"""How a sentence looks in the panel."""
ROW = (
    '<div style="padding:0 .75rem .3rem;font-size:12px;overflow-wrap:anywhere"><span '
    'style="display:inline-block;width:1.6em;height:.7em;border-radius:.2em;margin-right:.6em;'
    'background:{}"></span>{}</div>'
)
"""How a colour and what it means look in the panel."""
HANDLES = "linear-gradient(90deg,#ff2f6a 33%,#77d999 33% 66%,#358fe5 66%)"
PALE = "#b8c0c7"
"""Colours in the legend of the handles of a target, and of other configurations."""
QUICK = 0.1
"""Seconds that a search may take which is repeated while a target is dragged."""


def get_view(camera: Any) -> Array:
    """Get where a camera is and where it looks (2, 3)."""
    return np.array([camera.position, camera.look_at])


def is_same_view(a: Array, b: Array) -> bool:
    """Tell whether two views (2, 3) are the same."""
    return float(np.linalg.norm(a - b)) <= SAME_VIEW * float(np.linalg.norm(b[0] - b[1]))


class Page:
    """A page in a browser with its session; a thread answers events one after the other.

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
        self.sized = ""
        self.spent: list[float] = []
        self.revision = -1
        self.nodes = Nodes(client.scene, drawn, session.q)
        self.sliders: dict[str, Any] = {}
        self.dimensions: dict[str, Any] = {}
        self.made: tuple[tuple[str, str], ...] = ()
        self.made_handles = list[Any]()
        self.arrived = self.slid = 0.0
        self.searches = Beside(self.post_action, self._show_text)
        self.overlays = Beside(self.post_action, self._show_text)
        self.follow = False
        self.placed = [get_view(viewer.server.initial_camera)]
        self.framed = drawn.points
        self.upright = False
        with client.atomic():
            self._build_panel(drawn)
            self._add_gizmo()
        threading.Thread(target=self._run_actions, daemon=True).start()
        self.post_action("first", lambda: None)

    # ---- events

    def post_action(self, key: str, action: Callable[[], Any]) -> None:
        """Append an action to the waiting ones, in place of the one with the same key."""
        with self.ready:
            if not self.waiting:
                self.arrived = time.perf_counter()
            self.waiting[key] = action
            self.ready.notify()

    def close(self) -> None:
        """End the threads of the page."""
        self.searches.end_thread()
        self.overlays.end_thread()
        with self.ready:
            self.open = False
            self.ready.notify()

    def _run_actions(self) -> None:
        """Answer the waiting events until the page is closed."""
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
                self.session.dimension_steps.end_step()
                with self.client.atomic():
                    self._set_sliders(True)
                if self.dragging != "gizmo":
                    self._keep_in_sight()
                self._count_freedoms()
                continue
            with self.session.lock:
                try:
                    action()
                except KempeError as error:
                    self.session.status = str(error)
                self.viewer.update_pages(self)
            self.spent.append(time.perf_counter() - arrived)
            del self.spent[:-1000]
            slow = True

    def show(self) -> None:
        """Update the page to the state of the session."""
        session = self.session
        if self.nodes.drawn.system is not session.system:
            self._renew_system()
        if self.revision != session.revision:
            self._make_sliders()
            if "curve" in self.boxes and session.motion is None:
                self._begin_overlay("curve")
        if self.player.motion is not session.motion:
            self.player.make_time()
            if "curve" in self.boxes:
                self._begin_overlay("curve")
        with self.client.atomic():
            self.nodes.move_links(session.q)
            self.nodes.show_ghosts(session.solutions, self._choose_ghost)
            if time.perf_counter() - self.slid > SLIDE:
                self._set_sliders()
            if self.dragging != "gizmo":
                self.gizmo.wxyz, self.gizmo.position = split_poses(session.pose)
            self._draw_miss()
            said = format_html(fit_sentence(session.compose_text()))
            if self.said.content != said:
                self.said.content = said
            legend = format_legend(self._list_legend())
            if self.legend.content != legend:
                self.legend.content = legend

    def _list_legend(self) -> list[tuple[str, str]]:
        """List the colours on the page beside those of the links, and what each means."""
        session = self.session
        handles = "x, y, both" if session.system.dim == 2 else "x, y, z"
        rows = [(HANDLES, f"target of {session.frame}: {handles}")]
        rows += [row for legend in self.nodes.legends.values() for row in legend]
        if session.target is not None:
            rows.append((style.OPEN, "from the nearest configuration to the target"))
        if len(session.solutions):
            rows.append((PALE, f"pale: other {KINDS[session.kind]}s"))
        return rows

    def _renew_system(self) -> None:
        """Draw the system with its new dimensions, and compute again what is shown of it."""
        session = self.session
        drawn = Drawn(session.system, session.q, None, self.nodes.drawn)
        with self.client.atomic():
            self.nodes.change_drawing(drawn, session.q)
            self.nodes.show_names(self.names.value)
            self.nodes.show_axes(self.axes.value)
            self._make_sliders()
        for name, box in self.boxes.items():
            if box.value:
                self._begin_overlay(name, name == "curve")
        self._count_freedoms()

    def _set_sliders(self, rest: bool = False) -> None:
        """Update the sliders to the coordinates and dimensions, except the one that is dragged.

        At `rest` also that of a dimension, which stays where the loops no longer close.
        """
        self.slid = time.perf_counter()
        for slider in map(self._convert_slider, self.session.dimensions):
            handle = self.dimensions[slider.name]
            if (rest or slider.name != self.sized) and abs(handle.value - slider.value) > 1e-9:
                handle.value = slider.value
        for slider in map(self._convert_slider, self.session.sliders):
            handle = self.sliders.get(slider.name)
            if (
                handle is None
                or slider.name == self.dragging
                or abs(handle.value - slider.value) <= 1e-9
            ):
                continue
            # an angle without limits: the slider goes along
            if not handle.min <= slider.value <= handle.max:
                self.made = ()
                self._make_sliders()
                return
            handle.value = slider.value

    def _draw_miss(self) -> None:
        """Draw the line from the frame to a target that is not reached."""
        target = self.session.target
        ends = np.zeros((1, 2, 3), dtype=np.float32)
        if target is not None:
            ends[0] = self.session.pose[:3, 3], target[:3, 3]
        if not np.allclose(self.miss.points, ends):
            self.miss.points = ends

    # ---- what is on the page

    def _build_panel(self, drawn: Drawn) -> None:
        """Make the panel with all controls."""
        gui = self.client.gui
        session = self.session
        gui.configure_theme(show_logo=False, show_share_button=False)
        gui.set_panel_label(session.system.name)
        self.counted = gui.add_html("")
        self.said = gui.add_html("")
        self.folder = gui.add_folder("coordinates")
        with self.folder:
            self.filter = gui.add_text("filter", "", visible=False)
        gos = {name: lambda n=name: session.go_to_posture(n) for name in session.postures}
        actions = {"reset": session.reset, "random": session.go_to_random}
        self.add_buttons("go to", actions | gos)
        self._add_dimensions()
        with gui.add_folder("frame"):
            self.frame = gui.add_dropdown("frame", session.frames, initial_value=session.frame)
            self.task = gui.add_dropdown(
                "what counts", ("pose", "position"), initial_value=session.task
            )
            self._add_pair("other solutions", "solution")
            if has_loops(session.system):
                self._add_pair("assembly modes", "mode")
        with gui.add_folder("show"):
            self.boxes = {
                name: gui.add_checkbox(name, False) for name in list_offered_overlays(session)
            }
            self.names = gui.add_checkbox("names", False)
            self.axes = gui.add_checkbox("axes of frames", False)
            self.degrees = gui.add_checkbox("degrees", self.viewer.deg)
            self.legend = gui.add_html("")
        self.player = Player(self)
        if drawn.lost:
            gui.add_html(format_html(fit_sentence(drawn.lost_sentence)))
        self.frame.on_update(self.make_callback("frame", lambda: self._aim_frame(self.frame.value)))
        self.task.on_update(
            self.make_callback("task", lambda: self._aim_frame(self.frame.value, self.task.value))
        )
        for name, box in self.boxes.items():
            box.on_update(self.make_callback(name, lambda n=name: self._begin_overlay(n)))
        self.names.on_update(
            self.make_callback("names", lambda: self.nodes.show_names(self.names.value))
        )
        self.degrees.on_update(self.make_callback("degrees", self._change_units))
        self._make_dimensions()
        self.filter.on_update(self.make_callback("filter", self._make_sliders))
        self.axes.on_update(
            self.make_callback("axes", lambda: self.nodes.show_axes(self.axes.value))
        )

        self._add_keys()

    def _add_keys(self) -> None:
        """Add the keys of the keyboard, which are listed by Ctrl-K."""
        keys: dict[Any, tuple[str, Action]] = {
            "R": ("go to random", self.session.go_to_random),
            "H": ("go to the first configuration", self.session.reset),
            "N": ("next solution", lambda: self._show_next_configuration("solution")),
        }
        if self.session.dimensions:
            keys["U"] = "undo the last change of a dimension", self.session.undo_dimensions
        if has_loops(self.session.system):
            keys["M"] = "next assembly mode", lambda: self._show_next_configuration("mode")
        for key, (label, action) in keys.items():
            command = self.client.gui.add_command(label, hotkey=key)
            command.on_trigger(self.make_callback(label, action))
        command = self.client.gui.add_command("play or stop the motion", hotkey="space")
        command.on_trigger(self.player.toggle_playing)

    def add_buttons(self, label: str, actions: dict[str, Action]) -> Any:
        """Add buttons in a row, each with its action; returns the group."""
        group = self.client.gui.add_button_group(label, tuple(actions))
        group.on_click(self.make_callback(label, lambda: actions[group.value]()))
        return group

    def _add_pair(self, label: str, kind: str) -> None:
        """Add the buttons that show other solutions of a kind, and that go to the next one."""
        self.add_buttons(
            label,
            {
                "show": lambda: self._find_solutions(kind),
                "next": lambda: self._show_next_configuration(kind),
            },
        )

    def make_callback(self, key: str, action: Action) -> Any:
        """Make a callback of viser that posts an action if a person caused the event."""

        async def handle_event(event: Any) -> None:
            """Post the action if a person caused the event."""
            if event.client is not None:
                self.dragging = key if key in self.sliders else ""
                self.follow = False
                self.post_action(key, action)

        return handle_event

    def _make_sliders(self) -> None:
        """Make the sliders of the independent coordinates, unless they are unchanged."""
        session = self.session
        gui = self.client.gui
        self.revision = session.revision
        every = session.sliders
        text = self.filter.value.strip().lower()
        self.filter.visible = len(every) >= MANY
        wanted = [s for s in every if text in s.name.lower()] if self.filter.visible else every
        made = tuple((s.name, self._convert_slider(s).unit) for s in wanted)
        if made == self.made:
            return
        self.made = made
        for handle in self.made_handles:
            handle.remove()
        self.made_handles = []
        self.sliders = {}
        groups = [("", wanted)]
        if len(wanted) >= MANY:
            groups = group_by_limb(session.system, wanted)
        for k, (name, group) in enumerate(groups):
            folder = self.folder
            if len(groups) > 1:
                with self.folder:
                    label = shorten_label(name)
                    folder = gui.add_folder(label, expand_by_default=k == 0)
                self.made_handles.append(folder)
            with folder:
                for slider in map(self._convert_slider, group):
                    self._add_slider(slider, len(groups) == 1)

    def _make_slider(self, s: Slider, **how: Any) -> Any:
        """Make the control of a slider in the open folder."""
        label = f"{shorten_label(s.name)} [{s.unit}]"
        handle = self.client.gui.add_slider(
            label, s.low, s.high, s.step, s.value, marks=s.marks, **how
        )
        handle.precision = s.digits
        return handle

    def _add_slider(self, s: Slider, alone: bool) -> None:
        """Add a slider to the open folder; `alone`: it is removed on its own."""
        handle = self._make_slider(s)
        self.sliders[s.name] = handle
        if alone:
            self.made_handles.append(handle)
        handle.on_update(
            self.make_callback(s.name, lambda: self._set_coordinate(s.name, handle.value))
        )

    # ---- dimensions

    def _add_dimensions(self) -> None:
        """Make the folder of the mechanism's parameters, if it has any."""
        session = self.session
        self.dimension_folder: Any = None
        if not session.dimensions:
            return
        with self.client.gui.add_folder("dimensions", expand_by_default=False) as folder:
            self.dimension_folder = folder
            self.measured = self.client.gui.add_html("", order=0.0)
            self.add_buttons(
                "mechanism",
                {
                    "undo": session.undo_dimensions,
                    "redo": session.redo_dimensions,
                    "undo all": session.reset_dimensions,
                    "copy as TOML": self._copy_mechanism,
                    "save": self._save_mechanism,
                },
            )

    def _make_dimensions(self) -> None:
        """Make the sliders of the mechanism's parameters, in the units of the page."""
        for handle in self.dimensions.values():
            handle.remove()
        self.dimensions = {}
        if self.dimension_folder is None:
            return
        with self.dimension_folder:
            every = self.session.dimensions
            for k, s in enumerate(map(self._convert_slider, every), 1):
                handle = self._make_slider(s, order=k / (len(every) + 1.0))  # above the buttons
                self.dimensions[s.name] = handle
                handle.on_update(self._make_size_callback(s.name, handle))

    def _make_size_callback(self, name: str, handle: Any) -> Any:
        """Make the callback of the slider of a parameter."""

        def set_dimension() -> None:
            """Set the parameter to what the slider shows."""
            self.sized = name
            value = float(handle.value)
            for slider in self.session.dimensions:
                if slider.name == name:
                    value = self._read_slider(slider, value)
            self.session.set_dimension(name, value)

        return self.make_callback(f"dimension {name}", set_dimension)

    def _copy_mechanism(self) -> None:
        """Copy the mechanism with its present dimensions to the clipboard, as TOML."""
        text = write_mechanism(self.session.system)
        copy_text(self.client, text)
        self.session.status = f"copied: {format_count(len(text.splitlines()), 'line')} of TOML"

    def _save_mechanism(self) -> None:
        """Let the browser save the mechanism with its present dimensions, as a TOML file."""
        text = write_mechanism(self.session.system)
        file = save_text(self.client, self.session.system.name, text)
        self.session.status = f"saved: {file}, among the downloads of the browser"

    # ---- sliders

    def _change_units(self) -> None:
        """Make the sliders again, in degrees or radians."""
        self._make_sliders()
        self._make_dimensions()

    def _set_coordinate(self, name: str, value: float) -> None:
        """Set a coordinate to the value of its slider.

        An end of the slider is the limit, without rounding.
        """
        for slider in self.session.sliders:
            if slider.name == name:
                value = self._read_slider(slider, value)
                break
        self.session.set_coordinate(name, float(value))

    def _read_slider(self, slider: Slider, value: float) -> float:
        """Convert the value of a slider on the page; an end is the limit, without rounding."""
        shown = self._convert_slider(slider)
        ends = {shown.low: slider.low, shown.high: slider.high}
        near = min(ends, key=lambda end: abs(end - value))
        if abs(near - value) <= 0.5 * shown.step:
            return ends[near]
        return value * DEGREE if shown.unit == "deg" else value

    def _convert_slider(self, slider: Slider) -> Slider:
        """Convert a slider to the units of the page: degrees if requested."""
        if slider.unit != "rad" or not self.degrees.value:
            return slider
        return Slider(slider.name, "deg", *(x / DEGREE for x in slider[2:]))

    def _add_gizmo(self) -> None:
        """Make the gizmo that drags the target, and the line to a missed target."""
        session = self.session
        flat = self.session.system.dim == 2
        quat, place = split_poses(session.pose)
        self.gizmo = self.client.scene.add_transform_controls(
            "/target",
            scale=self.nodes.drawn.handle_size,
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
        async def post_gizmo_pose(event: Any) -> None:
            """Post the pose of the gizmo as a target."""
            if event.client is None:
                return
            X = np.eye(4)
            X[:3, :3] = spatial.quat_wxyz_to_matrix(np.asarray(event.target.wxyz))
            X[:3, 3] = event.target.position
            last = event.phase == "end"
            self.dragging = "" if last else "gizmo"
            self.post_action("end" if last else "gizmo", lambda: self._reach_pose(X, last))

    # ---- actions

    def _reach_pose(self, X: Any, last: bool) -> None:
        """Bring the frame to a target (4, 4), and update the other solutions."""
        session = self.session
        session.reach_pose(X, quick=not last)
        if self.follow and session.took < QUICK:
            said = session.status
            session.find_other_configurations()
            session.status = said
        elif self.follow and last:
            self._find_solutions("solution")

    def _aim_frame(self, frame: str, task: str | None = None) -> None:
        """Choose the frame and the task of targets."""
        self.session.aim_frame(frame, task)
        for name in self.boxes:
            self._begin_overlay(name)
        if self.task.value != self.session.task:
            self.task.value = self.session.task
        self.gizmo.disable_rotations = (
            self.session.system.dim == 2 or self.session.task == "position"
        )
        self.player.make_finds()

    async def _choose_ghost(self, event: Any) -> None:
        """Go to the configuration of the ghost that was clicked."""
        if event.instance_index is not None:
            self.post_action(
                "ghost", lambda: self.session.choose_solution(int(event.instance_index))
            )

    # ---- what is computed beside

    def _show_text(self, text: str) -> None:
        """Set the status sentence."""
        self.session.status = text

    def _begin_job(
        self,
        where: Beside,
        key: str,
        work: Callable[[Session], Iterator[Action]],
        renew: bool = False,
    ) -> None:
        """Start a computation with a copy of the present session.

        `renew`: one with the same key is finished before.
        """
        session = copy.copy(self.session)

        def iterate_actions(check: Callable[..., None]) -> Iterator[Action]:
            """Start the rounds of the computation; `check` ends it when it is cancelled."""
            session.progress = check
            return work(session)

        (where.renew_job if renew else where.start_job)(key, iterate_actions)

    def _count_freedoms(self) -> None:
        """Show the degrees of freedom, computed beside since large systems take long."""

        def iterate_actions(session: Session) -> Iterator[Action]:
            """Count the degrees of freedom, and give the action that shows them."""
            text = session.describe_mobility()
            sizes = session.describe_dimensions()
            yield lambda: show_text(text, sizes)

        def show_text(text: str, sizes: str) -> None:
            """Show the sentences about the mechanism."""
            self.counted.content = format_html(fit_sentence(text))
            if self.dimension_folder is not None:
                self.measured.content = format_html(fit_sentence(sizes))

        self._begin_job(self.searches, "freedoms", iterate_actions, True)

    def _find_solutions(self, kind: str, then: Action | None = None) -> None:
        """Find other configurations, and show them if the system has not moved meanwhile."""

        def show_solutions(found: Session) -> None:
            """Take the solutions of a finished search."""
            session = self.session
            if session.q is found.q:
                session.solutions = found.solutions
                session.kind = kind
                session.status = found.status
                session.took = found.took
                self.follow = kind == "solution" and len(found.solutions) > 0
                if then is not None and len(found.solutions):
                    then()

        def iterate_actions(session: Session) -> Iterator[Action]:
            """Find the solutions, and give the action that takes them."""
            session.find_other_configurations(kind)
            yield lambda: show_solutions(session)

        self.session.status = f"looking for other {KINDS[kind]}s ..."
        self._begin_job(self.searches, "search", iterate_actions)

    def _show_next_configuration(self, kind: str) -> None:
        """Go to the next configuration of a kind; search for one if none is known."""
        if self.session.kind == kind and len(self.session.solutions):
            self.session.choose_next_configuration(kind)
            self.follow = kind == "solution"
        else:
            self._find_solutions(kind, lambda: self.session.choose_next_configuration(kind))

    def find_motion(self, name: str) -> None:
        """Find a motion from the present configuration, to be played."""

        def show_motion(found: Session, has: bool) -> None:
            """Take the motion of a finished search."""
            self.session.status = found.status
            if has:
                self.session.motion = found.motion

        def iterate_actions(session: Session) -> Iterator[Action]:
            """Search the motion, and give the action that takes it."""
            has = session.find_motion(name)
            yield lambda: show_motion(session, has)

        self.session.status = f"{name}: looked for ..."
        self._begin_job(self.searches, "search", iterate_actions)

    def _begin_overlay(self, name: str, renew: bool = False) -> None:
        """Remove an overlay, and start to compute it again if it is wanted.

        `renew`: the old one stays until there is a new one.
        """
        if not renew:
            self.nodes.show_overlay(name, None)
            self.overlays.drop_jobs(name)
        if not self.boxes[name].value:
            return

        def show_overlay(overlay: Overlay, first: bool) -> None:
            """Show an overlay; have the first one in sight."""
            if not renew:
                self.session.status = overlay.said
            self.nodes.show_overlay(name, overlay)
            if first and len(overlay.extent):
                self._include_points(np.array(list(itertools.product(*overlay.extent.T))))

        def iterate_actions(session: Session) -> Iterator[Action]:
            """Compute overlays round by round, and give the actions that show them."""
            for k, overlay in enumerate(iterate_rounds(session, name)):
                yield lambda x=overlay, first=not k: show_overlay(x, first)

        if not renew:
            self.session.status = f"{name}: being computed"
        self._begin_job(self.overlays, name, iterate_actions, renew)

    # ---- the camera

    def _keep_in_sight(self) -> None:
        """Move the camera if what is shown has left the picture since the page was last at rest."""
        session = self.session
        points = self.nodes.drawn.compute_extremes(
            np.concatenate([session.q[None], session.solutions])
        )
        self._include_points(points)
        self.framed = points

    def _include_points(self, points: Array) -> None:
        """Move the camera to have points (n, 3) in sight, unless someone looks at a detail."""
        camera = self.client.camera
        up = self.nodes.drawn.upright
        place, at = get_view(camera)
        seen = up, camera.fov, camera.image_width / camera.image_height
        if not is_in_sight(self.framed, place, at, *seen) or is_in_sight(points, place, at, *seen):
            return
        every = np.concatenate([self.framed, points])
        with self.client.atomic():
            camera.position, camera.look_at = fit_camera(every, place - at, *seen)

    def uncover_system(self, camera: Any) -> None:
        """Move a camera that nobody has moved, so that it suits the picture's present size.

        A picture is as wide as the page before the panel is laid beside it.
        """
        if self.open and any(is_same_view(get_view(camera), view) for view in self.placed):
            self.place_camera(camera)

    def place_camera(self, camera: Any) -> None:
        """Place a camera so that the system is in the picture."""
        aspect = camera.image_width / camera.image_height
        wanted = self.nodes.drawn.find_place(aspect)
        if not is_same_view(get_view(camera), wanted):
            self.placed[1:] = [wanted]
            self.nodes.drawn.place_camera(camera, aspect)

    def limit_tilt(self, camera: Any) -> None:
        """Put a camera back that looks at a planar system from too far aside."""
        away = np.subtract(camera.position, camera.look_at)
        far = float(np.linalg.norm(away))
        aside = float(np.linalg.norm(away[:2]))
        if aside <= far * np.sin(TILT) * (1.0 + SAME_VIEW) and away[2] >= 0.0:
            self.upright = True
        elif self.upright:  # else it is still where browsers begin
            away[:2] *= far * np.sin(TILT) / max(aside, 1e-300)
            away[2] = far * np.cos(TILT)
            at = np.array(camera.look_at)
            with self.client.atomic():
                camera.position = at + away
                camera.look_at = at


def format_html(text: str) -> str:
    """Format a text as HTML with its characters escaped; empty lines separate paragraphs.

    Names come from files, and viser's Markdown would run what HTML is in them.
    """
    return "".join(PARAGRAPH.format(html.escape(part)) for part in text.split("\n\n") if part)


def format_legend(rows: Sequence[tuple[str, str]]) -> str:
    """Format colours and what they mean as HTML, a row each."""
    return "".join(ROW.format(colour, html.escape(text)) for colour, text in rows)


# ---- showing and serving

PORT = 8080
"""The first port that is tried; of those that follow, the first that is free is taken."""


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
    """Show the system on a page in the browser, and return its `Viewer`; see `System.show`."""
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
    """Serve the page of `show`, without opening a browser or warning about meshes."""
    shared = read_flag(share, "share")
    degrees = read_flag(deg, "deg")
    return Viewer(Session(system, q, frame, path), shared, check_port(port), degrees)


class Viewer(ServedPages):
    """Served page that shows a system.

    Attributes
    ----------
    url
        Address of the page.
    q
        Configuration (nq,) of the page that was moved last.
    system
        System of that page, with its dimensions.
    """

    def __init__(self, session: Session, share: bool, port: int, deg: bool = False):
        self.session = session
        self.share = share
        self.deg = deg
        self.drawn = Drawn(
            session.system, session.q, None if session.motion is None else session.motion.q
        )
        self.drawn.add_handles(session.pose)
        self._last = session
        super().__init__(port, self.system.name, "+y" if self.system.dim == 2 else "+z")
        self.drawn.place_camera(self.server.initial_camera)
        self._accept_clients()

    @property
    def system(self) -> Model:
        """System of the page that was moved last, with its dimensions."""
        return self._last.system

    @property
    def q(self) -> Array:
        """Configuration (nq,) of the page that was moved last."""
        return self._last.q.copy()

    @q.setter
    def q(self, q: Any) -> None:
        """Set the configuration of all pages, given as an array (nq,) or a dict.

        Errors: `InputError`.
        """
        for session in {
            id(s): s for s in (self.session, *(p.session for p in self.pages.values()))
        }.values():
            with session.lock:
                session.go_to_configuration(q)
                for page in (p for p in tuple(self.pages.values()) if p.session is session):
                    page.show()

    def update_pages(self, page: Page) -> None:
        """Update all pages that share the configuration of a page after its change."""
        self._last = page.session
        for other in tuple(self.pages.values()):
            if other.session is page.session:
                other.show()

    def _open_page(self, client: Any) -> None:
        """Add a page for a new client."""
        session = self.session if self.share else copy.copy(self.session)
        if not self.share:
            session.lock = threading.RLock()
            session.forget_steps()
        client.camera.max_orbit_distance = float("inf")
        client.camera.min_orbit_distance = self.drawn.near
        page = self.pages[client.client_id] = Page(self, client, session, self.drawn)
        page.place_camera(client.camera)
        client.camera.on_update(page.uncover_system)
        if self.system.dim == 2:
            client.camera.on_update(page.limit_tilt)

    def __repr__(self) -> str:
        return f"Viewer of {self.system.name!r} at {self.url}" + (
            ", closed" if self._closed.is_set() else ""
        )


def check_port(port: Any) -> int:
    """Check that a port is free, 8080 by default. Errors: `InputError`."""
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
