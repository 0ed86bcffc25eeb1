"""The drawing board of `kempe draw`: a page on which a planar mechanism is drawn by mouse.

The page passes clicks on to the sketch of `kempe.views.sketch`, and shows what it has become.
"""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from kempe.errors import InputError, KempeError
from kempe.spatial import Array
from kempe.units import from_metres
from kempe.views.drawing import style
from kempe.views.drawing.labels import fit_sentence
from kempe.views.sketch.dimensions import set_distance
from kempe.views.sketch.mechanism import (
    Findings,
    Motion,
    compute_motion,
    describe_motion,
    examine_sketch,
    name_driver,
    write_python,
    write_sketch_toml,
)
from kempe.views.sketch.picture import draw_faces, place_labels, triangulate
from kempe.views.sketch.sketch import GROUND, History, Point, Sketch, snap_point
from kempe.views.viewer.dimensions import describe_four_bar
from kempe.views.viewer.first_sight import fit_camera
from kempe.views.viewer.live import (
    FRAMES,
    Action,
    Beside,
    check_port,
    format_html,
    get_view,
    is_same_view,
)
from kempe.views.viewer.scene_nodes import OPENING, UPWARDS, split_poses, write_glb
from kempe.views.viewer.server import ServedPages, copy_text, save_text

CELL = 0.1
"""Distance of the lines of the grid in an empty plane [m]."""
STEP = 0.1
"""Steps of lengths that are typed, in cells."""
WIDE = (14.0, 9.0)
"""Size of the plane that is seen at first, in cells."""
PIN = 0.25
"""Radius of a pin, in cells."""
REACH = 0.45
"""Distance up to which a click means a pin, in cells."""
NEAR_BAR = 0.3
"""Distance up to which a click means a bar, in cells."""
CELL_LINES = (150, 155, 160)
SECTION_LINES = (120, 126, 132)
"""Colours of the grid, for light and dark pages."""
PAPER = 1e4
"""Size of the plane that takes clicks, in cells."""
UPRIGHT = np.array([0.0, 1.0, 0.0])
PAUSE_OF_TYPING = 3.0
"""Seconds without a key after which what is typed is a step of its own."""
SECONDS = 6.0
"""Seconds of a motion that is played once."""

TOOLS = {
    "select": "Click on a pin or a bar to name it and to type its dimensions. Drag pins with any tool.",
    "pin": "Click in the plane to place pins. Drag a pin to move it.",
    "bar": "Click on two pins, or on a bar and a pin; in the empty plane a pin is placed. The next "
    "bar begins where the last one ended.",
    "ground": "Click on a pin to fix it to the ground, or to free it.",
    "slider": "Click on a pin: it slides on a horizontal line. Click again: on a vertical one, then "
    "on none. After a click on a bar, the next pin slides in a slot of this bar.",
    "crank": "Click on a bar at a grounded pin, or on a slider: it is driven.",
    "delete": "Click on a pin or a bar to delete it.",
}
"""Tools by name, and what a click does with each."""
KEYS = {"select": "V", "pin": "N", "bar": "B", "ground": "G", "slider": "L", "crank": "C"}
LARGE = '<div style="zoom:1.25;font-weight:600">{}</div>'
"""How the sentence about the freedoms looks: it is read from the last row."""
ACTIVE = (194, 65, 12)
"""Colour of the tool that is chosen."""


class BoardPage:
    """A page in a browser with its sketch; a thread answers events one after the other."""

    def __init__(self, board: Board, client: Any):
        self.board = board
        self.client = client
        self.history = History(board.first)
        self.tool = "pin"
        self.chosen: tuple[str, ...] = ()
        self.grid = board.cell
        self.said = ""
        self.findings: Findings | None = None
        self.motion: Motion | None = None
        self.playing = False
        self.frame = 0
        self.open = True
        self.dragged = ""
        self.drags = 0
        self.answered = 0
        self.typed = 0.0
        self.typing: Any = None
        self.made = 0
        self.bodies: dict[str, Any] = {}
        self.labels: dict[str, Any] = {}
        self.curves = list[Any]()
        self.fields = list[tuple[Any, Callable[[Sketch], float | str] | None]]()
        self.shown: tuple[Any, ...] = ()
        self.renamed: dict[str, str] = {}
        self.placed: list[Array] = []
        self.waiting: queue.SimpleQueue[Action | None] = queue.SimpleQueue()
        self.beside = Beside(lambda key, action: self.waiting.put(action), self.say)
        with client.atomic():
            self._build_panel()
            self._add_paper()
            self.show()
        threading.Thread(target=self._answer_events, daemon=True).start()

    # ---- events

    def _answer_events(self) -> None:
        """Answer the events that wait, until the page is closed."""
        while (action := self.waiting.get()) is not None:
            try:
                action()
            except KempeError as error:
                self.said = str(error)
            with self.client.atomic():
                self.show()
            self.answered += 1

    def make_callback(self, action: Callable[[Any], Any]) -> Any:
        """Make a callback of viser that has the action done with the event, if a person caused it."""

        async def post_event(event: Any) -> None:
            """Post the action."""
            if event.client is not None:
                self.waiting.put(lambda: answer_event(event))

        def answer_event(event: Any) -> None:
            """Do the action; typing into a field ends with what is done elsewhere."""
            self.typing = None
            action(event)

        return post_event

    def close(self) -> None:
        """End the threads of the page."""
        self.open = self.playing = False
        self.beside.end_thread()
        self.waiting.put(None)

    def say(self, text: str) -> None:
        """Say what happened last."""
        self.said = text

    # ---- the panel

    def _build_panel(self) -> None:
        """Make the panel with all controls."""
        gui = self.client.gui
        gui.configure_theme(show_logo=False, show_share_button=False)
        gui.set_panel_label("drawing board")
        self.sentence = gui.add_html("")
        self.hint = gui.add_html("")
        self.play = gui.add_button("play", color="green", hint="space")
        self.play.on_click(self.make_callback(lambda event: self.toggle_playing()))
        with gui.add_folder("tools"):
            self.tools = dict[str, Any]()
            for name, text in TOOLS.items():
                key = f"{text} Key: {KEYS[name]}." if name in KEYS else text
                button = gui.add_button(name, hint=key)
                button.on_click(self.make_callback(lambda event, n=name: self.choose_tool(n)))
                self.tools[name] = button
        self._add_buttons("step", {"undo": self.undo, "redo": self.redo})
        self.folder = gui.add_folder("what is chosen")
        with gui.add_folder("sketch"):
            self.snap = gui.add_number(
                f"grid [{self.history.state.unit}]",
                self.board.cell,
                min=0.0,
                step=STEP * self.board.cell,
            )
            self.lengths = gui.add_checkbox("lengths", False)
            self.title = gui.add_text("title", self.history.state.name)
            self._add_buttons("copy", {"as Python": self.copy_python, "as TOML": self.copy_toml})
            self._add_buttons("file", {"save": self.save, "new": self.clear})
        self.snap.on_update(self.make_callback(lambda event: self._set_grid(self.snap.value)))
        self.lengths.on_update(self.make_callback(lambda event: None))
        self.title.on_update(
            self.make_callback(lambda event: self._type(self.title, "title", self._rename_sketch))
        )
        for name, key in KEYS.items():
            command = gui.add_command(f"tool: {name}", hotkey=key)
            command.on_trigger(self.make_callback(lambda event, n=name: self.choose_tool(n)))
        for label, key, action in (
            ("play or stop", "space", self.toggle_playing),
            ("undo", "U", self.undo),
            ("redo", "R", self.redo),
            ("delete what is chosen", "X", self.delete_chosen),
        ):
            command = gui.add_command(label, hotkey=key)
            command.on_trigger(self.make_callback(lambda event, a=action: a()))

    def _add_buttons(self, label: str, actions: dict[str, Action]) -> None:
        """Add buttons in a row, each with its action."""
        group = self.client.gui.add_button_group(label, tuple(actions))
        group.on_click(self.make_callback(lambda event: actions[group.value]()))

    def _set_grid(self, grid: float) -> None:
        """Set the distance of the points to which pins snap; 0 for none."""
        self.grid = float(grid)

    def choose_tool(self, name: str) -> None:
        """Choose the tool that clicks work with."""
        self.tool = name
        self.chosen = ()
        self.said = ""

    # ---- clicks

    def _add_paper(self) -> None:
        """Add the plane that takes clicks and drags, and its grid."""
        scene = self.client.scene
        cell = self.board.cell
        scene.add_grid(
            "/grid",
            infinite_grid=True,
            fade_distance=200.0 * cell,
            cell_size=cell,
            section_size=5.0 * cell,
            cell_color=CELL_LINES,
            cell_thickness=0.5,
            section_color=SECTION_LINES,
            section_thickness=0.9,
            shadow_opacity=0.0,
            position=(0.0, 0.0, -0.1 * cell),
        )
        half = 0.5 * PAPER * cell
        corners = half * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], dtype=float)
        paper = scene.add_mesh_simple(
            "/paper",
            corners,
            np.array([[0, 1, 2], [0, 2, 3]]),
            opacity=0.0,
            position=(0.0, 0.0, -0.2 * cell),
            cast_shadow=False,
            receive_shadow=False,
        )
        # the plane takes drags: the camera would turn with them
        paper.on_drag("left")(self._post_drag)
        scene.on_click()(self.make_callback(self._answer_click))

    def _answer_click(self, event: Any) -> None:
        """Answer a click on the picture with the tool that is chosen."""
        origin, way = np.array(event.ray_origin), np.array(event.ray_direction)
        if abs(way[2]) < 1e-9:
            return
        x, y, _ = (origin - way * (origin[2] / way[2])).tolist()
        self.stop_playing()
        self.said = ""
        self.click((x, y))

    def click(self, at: Point) -> None:
        """Use the tool at a point of the plane."""
        sketch = self.history.state
        pin = sketch.find_nearest_pin(at, REACH * self.board.cell)
        bar = None if pin else sketch.find_nearest_bar(at, NEAR_BAR * self.board.cell)
        use: Callable[[Point, str | None, str | None], None] = getattr(self, f"_use_{self.tool}")
        self.history.end_step()
        use(at, pin, bar)

    def _use_select(self, at: Point, pin: str | None, bar: str | None) -> None:
        """Choose what was clicked."""
        self._choose_part(pin or bar)

    def _use_pin(self, at: Point, pin: str | None, bar: str | None) -> None:
        """Place a pin, or choose the one that is there."""
        self._choose_part(pin or self._place_pin(at))

    def _place_pin(self, at: Point) -> str:
        """Place a pin at the nearest point of the grid; return its name."""
        made, name = self.history.state.add_pin(snap_point(at, self.grid))
        self.history.add_step(made)
        return name

    def _use_bar(self, at: Point, pin: str | None, bar: str | None) -> None:
        """Begin a bar, or end it: at a pin, at a bar that gets one more pin, or in the plane."""
        first = self.chosen[0] if self.chosen else None
        sketch = self.history.state
        if first is None or first not in {*sketch.pins, *sketch.bars}:
            self._choose_part(pin or bar or self._place_pin(at))
            return
        if first == pin or (bar is not None and first == bar):
            self._choose_part(None)
            return
        if first in sketch.bars:
            sketch, pin = self._prepare_pin(sketch, at, pin)
            made = sketch.extend_bar(first, pin)
            self.history.add_step(made)
            self._choose_part(made.find_bar(sketch.bars[first][0], pin))
        elif bar is not None and first in sketch.pins:
            self.history.add_step(sketch.extend_bar(bar, first))
            self._choose_part(None)
        else:
            sketch, pin = self._prepare_pin(sketch, at, pin)
            made, _ = sketch.add_bar(first, pin)
            self.history.add_step(made)
            self._choose_part(pin)

    def _prepare_pin(self, sketch: Sketch, at: Point, pin: str | None) -> tuple[Sketch, str]:
        """Return a pin that was clicked, or a new one at the nearest point of the grid."""
        return (sketch, pin) if pin else sketch.add_pin(snap_point(at, self.grid))

    def _use_ground(self, at: Point, pin: str | None, bar: str | None) -> None:
        """Fix a pin to the ground, or free it."""
        pin = self._need_pin(pin)
        sketch = self.history.state
        self.history.add_step(sketch.ground_pin(pin, pin not in sketch.grounded))
        self._choose_part(pin)

    def _use_slider(self, at: Point, pin: str | None, bar: str | None) -> None:
        """Let a pin slide: on a horizontal line, a vertical one, none; or in a slot of a bar."""
        if bar is not None:
            self._choose_part(bar)
            self.said = f"Click on the pin that slides in a slot of bar {bar}."
            return
        pin = self._need_pin(pin)
        sketch = self.history.state
        if self.chosen and self.chosen[0] in sketch.bars:
            a, b = (np.array(sketch.pins[p]) for p in sketch.bars[self.chosen[0]][:2])
            angle = float(np.arctan2(*(b - a)[::-1]))
            made = sketch.slide_pin(pin, angle, self.chosen[0])
        elif pin not in sketch.sliders:
            made = sketch.slide_pin(pin)
        elif sketch.sliders[pin] == (0.0, GROUND):
            made = sketch.slide_pin(pin, 0.5 * np.pi)
        else:
            made = sketch.stop_sliding(pin)
        self.history.add_step(made)
        self._choose_part(pin)

    def _use_crank(self, at: Point, pin: str | None, bar: str | None) -> None:
        """Choose the crank."""
        sketch = self.history.state
        if bar is None:
            pin = self._need_pin(pin)
        made = sketch.set_crank_bar(bar) if bar is not None else sketch.set_crank(pin or "")
        self.history.add_step(made)
        self._choose_part(bar or pin)

    def _use_delete(self, at: Point, pin: str | None, bar: str | None) -> None:
        """Delete what was clicked."""
        if pin or bar:
            self._choose_part(pin or bar)
            self.delete_chosen()

    def _need_pin(self, pin: str | None) -> str:
        """Return the pin that was clicked. Errors: `InputError` where there is none."""
        if pin is None:
            raise InputError("no pin is here: click on a pin")
        return pin

    def _choose_part(self, name: str | None) -> None:
        """Choose a pin or a bar; None for nothing."""
        self.chosen = () if name is None else (name,)

    async def _post_drag(self, event: Any) -> None:
        """Post a drag of the paper, which moves the pin where it began."""
        camera = np.array(self.client.camera.position)

        def project(p: Any) -> Point:
            """Project a point of the paper on the plane of the pins."""
            q = np.array(p)
            x, y, _ = (camera + (q - camera) * (camera[2] / (camera[2] - q[2]))).tolist()
            return x, y

        begin, end, phase = project(event.start_position), project(event.end_position), event.phase
        self.waiting.put(lambda: self.drag(begin, end, phase))

    def drag(self, begin: Point, end: Point, phase: str) -> None:
        """Move the pin at the point where a drag began to the point where it is."""
        if phase == "start":
            self.typing = None
            self.stop_playing()
            pin = self.history.state.find_nearest_pin(begin, REACH * self.board.cell)
            self.dragged = pin or ""
            self.drags += 1
            self.history.end_step()
        if not self.dragged:
            return
        key = f"drag {self.drags}"
        at = snap_point(end, self.grid)
        self.said = ""
        if at != self.history.state.pins[self.dragged]:
            self.history.add_step(self.history.state.move_pin(self.dragged, at), key)
        if phase == "end":
            if self.tool != "bar":
                self._choose_part(self.dragged)
            self.dragged = ""
            self.history.end_step()

    # ---- actions

    def undo(self) -> None:
        """Go back by one step."""
        self.stop_playing()
        self.history.undo_step()
        self.said = "One step back."
        self.chosen = ()

    def redo(self) -> None:
        """Take the last undo back."""
        self.stop_playing()
        self.history.redo_step()
        self.said = "One step forward."
        self.chosen = ()

    def clear(self) -> None:
        """Begin a new sketch; undo brings the old one back."""
        self.stop_playing()
        self.history.add_step(Sketch(unit=self.history.state.unit))
        self.chosen = ()

    def delete_chosen(self) -> None:
        """Delete what is chosen."""
        self.stop_playing()
        for name in self.chosen:
            self.history.add_step(self.history.state.delete(name))
            self.said = f"{name} is deleted."
        self.chosen = ()

    def copy_python(self) -> None:
        """Copy the program that makes the mechanism to the clipboard."""
        copy_text(self.client, write_python(self.history.state))
        self.said = "Copied: the mechanism as Python."

    def copy_toml(self) -> None:
        """Copy the mechanism to the clipboard as TOML."""
        copy_text(self.client, write_sketch_toml(self.history.state))
        self.said = "Copied: the mechanism as TOML."

    def save(self) -> None:
        """Let the browser save the mechanism as a TOML file."""
        sketch = self.history.state
        file = save_text(self.client, sketch.name, write_sketch_toml(sketch))
        self.said = f"Saved: {file}, among the downloads of the browser."

    # ---- what is typed

    def _type(self, field: Any, key: str, change: Callable[[Sketch], Sketch]) -> None:
        """Take what is typed into a field: all that is typed into it in turn is one step."""
        self.typing = field
        self.stop_playing()
        self.said = ""
        now = time.monotonic()
        if now - self.typed > PAUSE_OF_TYPING:
            self.history.end_step()
        self.typed = now
        key = f"type {key}"
        self.history.add_step(change(self.history.find_base(key)), key)

    def _rename_sketch(self, sketch: Sketch) -> Sketch:
        return sketch.set_name(self.title.value)

    def _make_fields(self) -> None:
        """Make the fields for what is chosen, in place of those of something else."""
        sketch = self.history.state
        name = self.chosen[0] if self.chosen else ""
        if name and name == self.renamed.get(self.shown[0] if self.shown else ""):
            self._update_fields()  # the field in which the name is typed stays
            return
        pairs = list[tuple[str, str]]()
        angle = ""
        if name in sketch.bars:
            pins = sketch.bars[name]
            pairs = [(a, b) for k, a in enumerate(pins) for b in pins[k + 1 :]]
        elif name in sketch.pins:
            angle = name if name in sketch.sliders else ""
            if name in sketch.grounded:
                pairs = [(p, name) for p in sketch.pins if p in sketch.grounded and p != name]
        if (name, tuple(pairs), angle) == self.shown:
            self._update_fields()
            return
        self.shown = (name, tuple(pairs), angle)
        for field in self.fields:
            field[0].remove()
        self.fields = []
        self.renamed = {}
        gui = self.client.gui
        find = self._find_name
        step = STEP * self.board.cell
        with self.folder:
            if not name:
                handle = gui.add_html(format_html("Nothing: click on a pin or a bar."))
                self.fields.append((handle, None))
                return
            self._add_field(gui.add_text("name", name), lambda s: name, self._rename_chosen)
            if name in sketch.pins:
                for k, axis in enumerate("xy"):
                    self._add_field(
                        gui.add_number(f"{axis} [{sketch.unit}]", sketch.pins[name][k], step=step),
                        lambda s, k=k: s.pins[find(s, name)][k],
                        lambda s, value, k=k: _move_along_axis(s, find(s, name), k, value),
                    )
            for a, b in pairs:
                self._add_field(
                    gui.add_number(
                        f"{a} to {b} [{sketch.unit}]", sketch.measure_distance(a, b), step=step
                    ),
                    lambda s, a=a, b=b: s.measure_distance(find(s, a), find(s, b)),
                    lambda s, value, a=a, b=b: set_distance(s, find(s, a), find(s, b), value),
                )
            if angle:
                self._add_field(
                    gui.add_number("direction [deg]", _read_degrees(sketch, name), step=5.0),
                    lambda s: _read_degrees(s, find(s, name)),
                    lambda s, value: _turn_slider(s, find(s, name), value),
                )

    def _add_field(
        self,
        handle: Any,
        read: Callable[[Sketch], float | str],
        change: Callable[[Sketch, Any], Sketch],
    ) -> None:
        """Add a field: `read` gives its value in a sketch, `change` the sketch with another."""
        name = self.chosen[0]
        if not isinstance(handle.value, str):
            handle.precision = 6
            handle.value = round(float(handle.value), 6)
        key = f"{name} {len(self.fields)}"
        self.fields.append((handle, read))
        handle.on_update(
            self.make_callback(
                lambda event: self._type(handle, key, lambda s: change(s, handle.value))
            )
        )

    def _update_fields(self) -> None:
        """Update the fields to the sketch, but for the one into which someone types: its next keys
        may wait.
        """
        for handle, read in self.fields:
            if read is None or handle is self.typing or isinstance(handle.value, str):
                continue
            value = round(float(read(self.history.state)), 6)
            if handle.value != value and not self.said:
                handle.value = value

    def _rename_chosen(self, sketch: Sketch, new: str) -> Sketch:
        """Rename what is chosen, and keep it chosen."""
        old = self.shown[0]
        made = sketch.rename(self._find_name(sketch, old), new)
        self.renamed[old] = new.strip()
        self.chosen = (new.strip(),)
        return made

    def _find_name(self, sketch: Sketch, name: str) -> str:
        """Find the name in a sketch of what was called `name` when the fields were made."""
        return name if name in sketch.pins or name in sketch.bars else self.renamed[name]

    # ---- what is shown

    def show(self) -> None:
        """Show the sketch, and what is said about it."""
        sketch = self.history.state
        known = {*sketch.pins, *sketch.bars}
        self.chosen = tuple(name for name in self.chosen if name in known)
        if self.findings is None or self.findings.sketch != sketch:
            self.motion = None
            self._remove_curves()
            self._begin_examination()
        if not self.playing:
            self._draw(sketch)
        self._make_fields()
        for name, button in self.tools.items():
            color = ACTIVE if name == self.tool else "gray"
            if button.color != color:
                button.color = color
        if self.typing is not self.title and self.title.value.strip() != sketch.name:
            self.title.value = sketch.name
        self.play.label = "stop" if self.playing else "play"
        self.play.color = "red" if self.playing else "green"
        said = format_html(fit_sentence(self.said or TOOLS[self.tool]))
        if self.hint.content != said:
            self.hint.content = said

    def _draw(self, sketch: Sketch) -> None:
        """Draw the sketch as drawn, each body in a frame of its own."""
        scene = self.client.scene
        r = PIN * self.board.cell
        faces = draw_faces(sketch, r, self.chosen)
        for body in [b for b in self.bodies if b not in faces]:
            frame, _, _ = self.bodies.pop(body)
            self.labels = {
                path: label
                for path, label in self.labels.items()
                if not path.startswith(f"{frame.name}/")
            }
            frame.remove()
        for body, each in faces.items():
            corners, colours = triangulate(each, r)
            glb = write_glb(corners, np.tile(UPWARDS, (len(corners), 1)), colours)
            if body not in self.bodies:
                path = f"/sketch/{self.made}"
                self.made += 1
                frame = scene.add_frame(path, show_axes=False)
                node = scene.add_glb(f"{path}/faces", glb, cast_shadow=False, receive_shadow=False)
                self.bodies[body] = frame, node, glb
            else:
                frame, node, old = self.bodies[body]
                if old != glb:
                    node.glb_data = glb
                    self.bodies[body] = frame, node, glb
            frame.wxyz, frame.position = (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
        self._draw_labels(sketch, r)

    def _draw_labels(self, sketch: Sketch, r: float) -> None:
        """Draw the names of pins, and the lengths of bars if wanted."""
        wanted = place_labels(sketch, r, self.lengths.value)
        paths = [f"{self.bodies[w.body][0].name}/label {w.text} {k}" for k, w in enumerate(wanted)]
        for path in [p for p in self.labels if p not in paths]:
            self.labels.pop(path).remove()
        for path, label in zip(paths, wanted, strict=True):
            place = np.array([*label.at, 2.0 * r])
            if path not in self.labels:
                self.labels[path] = self.client.scene.add_label(
                    path,
                    label.text,
                    position=place,
                    font_screen_scale=1.25,
                    anchor="center-center",
                )
            elif not np.array_equal(self.labels[path].position, place):
                self.labels[path].position = place

    def _begin_examination(self) -> None:
        """Count the freedoms of the sketch in a thread, and show what is found."""
        sketch = self.history.state
        self.findings = Findings(sketch)

        def iterate_actions(check: Callable[..., None]) -> Iterator[Action]:
            """Examine the sketch, and give the action that shows the findings."""
            found = examine_sketch(sketch)
            more = ""
            if found.system is not None and found.freedoms == 1:
                q = np.zeros(found.system.nq)
                more = describe_four_bar(found.system, q, name_driver(sketch))
            yield lambda: show_findings(found, more)

        def show_findings(found: Findings, more: str) -> None:
            """Show the findings, unless the sketch has changed meanwhile."""
            if found.sketch == self.history.state:
                self.findings = found
                large = LARGE.format(format_html(fit_sentence(found.sentence)))
                self.sentence.content = large + format_html(fit_sentence(more))

        self.beside.start_job("findings", iterate_actions)

    # ---- the motion

    def toggle_playing(self) -> None:
        """Play the motion by the crank, or stop it."""
        if self.playing:
            self.stop_playing()
            return
        sketch = self.history.state
        if self.motion is not None:
            self._begin_playing()
            return
        self.said = "The motion is being computed ..."

        def iterate_actions(check: Callable[..., None]) -> Iterator[Action]:
            """Compute the motion, and give the action that plays it."""
            motion = compute_motion(examine_sketch(sketch))
            yield lambda: show_motion(motion)

        def show_motion(motion: Motion) -> None:
            """Play the motion, unless the sketch has changed meanwhile."""
            if motion.sketch == self.history.state:
                self.motion = motion
                self._begin_playing()

        self.beside.start_job("motion", iterate_actions)

    def _begin_playing(self) -> None:
        """Draw the curves of the motion, and play it in a thread."""
        motion = self.motion
        assert motion is not None
        self.chosen = ()
        self._draw(self.history.state)
        self._remove_curves()
        above = 12.0 * style.THICK * PIN * self.board.cell
        for k, pin in enumerate(motion.traced):
            places = motion.compute_places(pin)
            if motion.path.closed:
                places = np.concatenate([places, places[:1]])
            line = np.column_stack([places, np.full(len(places), above)]).astype(np.float32)
            colour = style.choose_curve_colour(k)
            rgb = tuple(int(colour[i : i + 2], 16) for i in (1, 3, 5))
            self.curves.append(
                self.client.scene.add_line_segments(
                    f"/curves/{k}",
                    np.stack([line[:-1], line[1:]], axis=1),
                    np.array(rgb, dtype=np.uint8),
                    thickness=4.0,
                    thickness_units="screen",
                )
            )
        self.said = describe_motion(motion)
        self.playing = True
        self.player = threading.Thread(target=self._play_motion, args=(motion,), daemon=True)
        self.player.start()

    def _play_motion(self, motion: Motion) -> None:
        """Move the bodies through the motion until it is stopped."""
        order = np.arange(len(motion.poses))
        if not motion.path.closed:
            order = np.concatenate([order, order[::-1]])
        begin = time.monotonic()
        while self.playing and self.open and self.motion is motion:
            part = (time.monotonic() - begin) / SECONDS
            k = int(order[int(part * len(motion.poses)) % len(order)])
            quats, places = split_poses(motion.poses[k])
            with self.client.atomic():
                for i, body in enumerate(motion.bodies):
                    entry = self.bodies.get(body)
                    if self.playing and entry is not None and body != GROUND:
                        entry[0].wxyz = quats[i]
                        entry[0].position = places[i]
            self.frame = k
            time.sleep(1.0 / FRAMES)

    def stop_playing(self) -> None:
        """Stop the motion; the sketch is drawn as it was."""
        if self.playing:
            self.playing = False
            self.said = ""
            self.player.join()

    def _remove_curves(self) -> None:
        """Remove the curves of a motion."""
        for curve in self.curves:
            curve.remove()
        self.curves = []

    # ---- the camera

    def place_camera(self, camera: Any) -> None:
        """Place the camera straight above the sketch, unless someone has moved it."""
        view = get_view(camera)
        wanted = self.board.find_view(camera.image_width / camera.image_height, camera.fov)
        moved = self.placed and not any(is_same_view(view, placed) for placed in self.placed)
        if self.open and not moved and not is_same_view(view, wanted):
            self.placed = [*self.placed[-1:], wanted]
            with self.client.atomic():
                camera.position, camera.look_at = wanted


def _choose_cell(sketch: Sketch) -> float:
    """Choose the distance of the lines of the grid: 1, 2 or 5 times a power of ten."""
    size = float(np.ptp(np.array([*sketch.pins.values()]), axis=0).max()) if sketch.pins else 0.0
    if size <= 0.0:
        return from_metres(CELL, sketch.unit)
    least = size / WIDE[1]
    power = 10.0 ** np.floor(np.log10(least))
    return float(
        next(k * power for k in (1.0, 2.0, 5.0, 10.0) if k * power >= least * (1.0 - 1e-9))
    )


def _move_along_axis(sketch: Sketch, pin: str, axis: int, value: float) -> Sketch:
    """Set one coordinate of a pin."""
    x, y = sketch.pins[pin]
    return sketch.move_pin(pin, (float(value), y) if axis == 0 else (x, float(value)))


def _turn_slider(sketch: Sketch, pin: str, degrees: float) -> Sketch:
    """Set the direction of the line on which a pin slides."""
    return sketch.slide_pin(pin, float(np.deg2rad(degrees)), sketch.sliders[pin].carrier)


def _read_degrees(sketch: Sketch, pin: str) -> float:
    """Read the direction of the line on which a pin slides [deg]."""
    return float(np.rad2deg(sketch.sliders[pin].angle))


class Board(ServedPages):
    """Served drawing board; each page that is opened has a sketch of its own.

    Attributes
    ----------
    url
        Address of the page.
    """

    def __init__(self, sketch: Sketch | None = None, port: int | None = None):
        self.first = sketch or Sketch()
        self.cell = _choose_cell(self.first)
        super().__init__(check_port(port), "Kempe: drawing board", "+y")
        camera = self.server.initial_camera
        camera.fov = OPENING[2]
        camera.near = 0.1 * self.cell
        camera.far = 1e3 * self.cell
        camera.position, camera.look_at = self.find_view(1.6, camera.fov)
        self._accept_clients()

    def find_view(self, aspect: float, opening: float) -> Array:
        """Find where a camera is that looks straight at the sketch, and where it looks (2, 3)."""
        half = 0.5 * self.cell * np.array(WIDE)
        corners = np.array([-half, half, *self.first.pins.values()])
        points = np.column_stack([corners, np.zeros(len(corners))])
        return fit_camera(points, UPWARDS, UPRIGHT, opening, aspect)

    def _open_page(self, client: Any) -> None:
        """Add a page for a new client."""
        client.camera.max_orbit_distance = 500.0 * self.cell
        client.camera.min_orbit_distance = self.cell
        page = self.pages[client.client_id] = BoardPage(self, client)
        page.place_camera(client.camera)
        client.camera.on_update(page.place_camera)
