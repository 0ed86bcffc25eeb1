"""The sketch of a planar mechanism: pins, bars between them, what is grounded, and the crank.

A sketch is data: each edit returns another one, or raises `InputError` with the reason, in the words
of the person who draws. `History` keeps them for undo and redo.
"""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Generic, NamedTuple, TypeVar

from kempe.errors import InputError
from kempe.units import METRE
from kempe.words import format_count, join_words

Point = tuple[float, float]

GROUND = "ground"
SAME_PLACE = 1e-9
"""Distance [m] up to which two pins are at the same place."""
LETTERS = "ABCDEFGHIJKLMNOPQRSTUVWXYZ"
NAME = re.compile(r"[\w'+-]{1,24}")
"""Names of pins and bars: without spaces, which the names of joints have that are made of them."""


class Slider(NamedTuple):
    """Line on which a pin slides: its direction in the drawn position [rad], and its carrier.

    The line goes through the drawn pin. The carrier is the ground, or a bar, as its slot.
    """

    angle: float = 0.0
    carrier: str = GROUND


class Crank(NamedTuple):
    """The joint that is driven: between the ground and a bar at a pin, or the slider of a pin.

    `bar` is empty for a slider.
    """

    pin: str
    bar: str = ""


def snap_point(at: Point, grid: float) -> Point:
    """Return the nearest point of a grid [m]; the point itself where `grid` is 0."""
    if not grid:
        return at
    x, y = (round(round(c / grid) * grid, 12) + 0.0 for c in at)
    return x, y


@dataclass(frozen=True)
class Sketch:
    """Drawn planar mechanism.

    `pins` are places by name, `bars` the pins of each rigid bar by its name (a bar with three
    pins is a plate), `grounded` the pins that are fixed, `sliders` the lines of pins that slide.
    Lengths are in `unit`.
    """

    name: str = "sketch"
    pins: Mapping[str, Point] = field(default_factory=dict[str, Point])
    bars: Mapping[str, tuple[str, ...]] = field(default_factory=dict[str, tuple[str, ...]])
    grounded: frozenset[str] = frozenset()
    sliders: Mapping[str, Slider] = field(default_factory=dict[str, Slider])
    crank: Crank | None = None
    unit: str = METRE

    # ---- questions

    def measure_distance(self, a: str, b: str) -> float:
        """Measure the distance of two pins [m]."""
        return math.dist(self.pins[a], self.pins[b])

    def list_bars_of(self, pin: str) -> list[str]:
        """List the bars that a pin belongs to."""
        return [bar for bar, pins in self.bars.items() if pin in pins]

    def find_bar(self, a: str, b: str) -> str | None:
        """Find the bar that two pins belong to both; None without one."""
        return next((n for n, pins in self.bars.items() if a in pins and b in pins), None)

    def find_nearest_pin(self, at: Point, reach: float) -> str | None:
        """Find the pin that is nearest to a point, within `reach` [m]."""
        near = min(self.pins, key=lambda p: math.dist(self.pins[p], at), default=None)
        return near if near is not None and math.dist(self.pins[near], at) <= reach else None

    def find_nearest_bar(self, at: Point, reach: float) -> str | None:
        """Find the bar whose line between two of its pins is nearest to a point, within `reach`."""
        away = {
            bar: min(
                _measure_distance_to_segment(at, self.pins[a], self.pins[b])
                for a, b in itertools.combinations(pins, 2)
            )
            for bar, pins in self.bars.items()
        }
        near = min(away, key=lambda bar: away[bar], default=None)
        return near if near is not None and away[near] <= reach else None

    # ---- pins

    def add_pin(self, at: Point) -> tuple[Sketch, str]:
        """Add a pin at a place; return the sketch and the name of the pin."""
        for pin, place in self.pins.items():
            if math.dist(at, place) <= SAME_PLACE:
                raise InputError(f"pin {pin} is at this place already")
        used = self._list_names()
        name = next(n for n in iterate_pin_names() if n not in used)
        return replace(self, pins={**self.pins, name: _read_point(at)}), name

    def move_pin(self, pin: str, at: Point) -> Sketch:
        """Move a pin to a place; the other pins stay, and lengths change."""
        self._check_pin(pin)
        return self.place_pins({pin: _read_point(at)})

    def place_pins(self, places: Mapping[str, Point]) -> Sketch:
        """Give pins other places; slots turn with their bars."""
        pins = {**self.pins, **places}
        sliders = dict(self.sliders)
        for pin, slider in self.sliders.items():
            if slider.carrier != GROUND:
                a, b = self.bars[slider.carrier][:2]
                turned = _compute_angle(pins[a], pins[b]) - _compute_angle(
                    self.pins[a], self.pins[b]
                )
                sliders[pin] = slider._replace(angle=slider.angle + turned)
        moved = replace(self, pins=pins, sliders=sliders)
        moved.check_bars()
        return moved

    def ground_pin(self, pin: str, fixed: bool = True) -> Sketch:
        """Fix a pin to the ground, or free it; a pin that is fixed no longer slides."""
        self._check_pin(pin)
        sliders = {name: s for name, s in self.sliders.items() if name != pin or not fixed}
        grounded = self.grounded | {pin} if fixed else self.grounded - {pin}
        return replace(self, grounded=grounded, sliders=sliders)._drop_lost_parts()

    def slide_pin(self, pin: str, angle: float = 0.0, carrier: str = GROUND) -> Sketch:
        """Let a pin slide on a line through its place, which the ground or a bar carries.

        `angle` [rad] is the direction of the line. The pin is no longer fixed.
        """
        self._check_pin(pin)
        if not math.isfinite(angle):
            raise InputError(f"the direction of the slider is {angle}; it must be a finite angle")
        if carrier != GROUND:
            self._check_bar(carrier)
            if pin in self.bars[carrier]:
                raise InputError(
                    f"pin {pin} belongs to bar {carrier}, and cannot slide on it: choose a pin of "
                    "another bar"
                )
        sliders = {**self.sliders, pin: Slider(float(angle), carrier)}
        return replace(self, sliders=sliders, grounded=self.grounded - {pin})._drop_lost_parts()

    def stop_sliding(self, pin: str) -> Sketch:
        """Remove the line on which a pin slides."""
        sliders = {name: s for name, s in self.sliders.items() if name != pin}
        return replace(self, sliders=sliders)._drop_lost_parts()

    # ---- bars

    def add_bar(self, a: str, b: str) -> tuple[Sketch, str]:
        """Add a bar between two pins; return the sketch and the name of the bar."""
        for pin in (a, b):
            self._check_pin(pin)
        if a == b:
            raise InputError(f"a bar joins two pins, not {a} with itself")
        if (known := self.find_bar(a, b)) is not None:
            raise InputError(f"bar {known} joins {a} and {b} already")
        name = self.choose_bar_name((a, b))
        made = replace(self, bars={**self.bars, name: (a, b)})
        made.check_bars()
        return made, name

    def extend_bar(self, bar: str, pin: str) -> Sketch:
        """Add a pin to a bar, which becomes a plate."""
        self._check_bar(bar)
        self._check_pin(pin)
        pins = self.bars[bar]
        if pin in pins:
            raise InputError(f"pin {pin} belongs to bar {bar} already")
        if (slider := self.sliders.get(pin)) is not None and slider.carrier == bar:
            raise InputError(f"pin {pin} slides on bar {bar}, and cannot belong to it")
        for other in pins:
            shared = self.find_bar(other, pin)
            if shared is not None:
                raise InputError(
                    f"{other} and {pin} belong to bar {shared}: delete it first, or choose "
                    "another pin"
                )
        made = self._set_bar_pins(bar, (*pins, pin))
        made.check_bars()
        return made

    # ---- the crank

    def set_crank(self, pin: str, bar: str = "") -> Sketch:
        """Choose the joint that is driven: a bar at a grounded pin, or a pin that slides.

        Without `bar` it is that of a grounded pin with a single bar, or the slider of the pin.
        """
        self._check_pin(pin)
        if pin in self.sliders and not bar:
            return replace(self, crank=Crank(pin))
        if pin not in self.grounded:
            raise InputError(
                f"pin {pin} is not grounded: a crank turns about a grounded pin, or is a slider"
            )
        bars = self.list_bars_of(pin)
        if not bars:
            raise InputError(f"pin {pin} has no bar that could turn: join it to another pin")
        if not bar and len(bars) > 1:
            raise InputError(
                f"pin {pin} has {format_count(len(bars), 'bar')} ({join_words(bars)}): click on the one that is "
                "driven"
            )
        if bar and bar not in bars:
            raise InputError(f"bar {bar} has no pin {pin}")
        return replace(self, crank=Crank(pin, bar or bars[0]))

    def set_crank_bar(self, bar: str) -> Sketch:
        """Choose the bar that is driven, which has one grounded pin."""
        self._check_bar(bar)
        fixed = [pin for pin in self.bars[bar] if pin in self.grounded]
        if len(fixed) != 1:
            why = f"{join_words(fixed)} are grounded" if fixed else "none of its pins is grounded"
            raise InputError(
                f"bar {bar} cannot be the crank: {why}, and a crank turns about one grounded pin"
            )
        return self.set_crank(fixed[0], bar)

    # ---- names, deletion

    def rename(self, old: str, new: str) -> Sketch:
        """Give a pin or a bar another name; bars that are named after their pins follow."""
        new = new.strip()
        if old not in self._list_names():
            raise InputError(f"there is no pin or bar {old}")
        if new == old:
            return self
        if not NAME.fullmatch(new):
            raise InputError(
                f"{new!r} cannot be a name: use 1 to 24 letters, digits, _ or -, without spaces"
            )
        if new == GROUND or new in self._list_names():
            raise InputError(f"there is another {new}: names must differ")
        if old in self.bars:
            return self._rename_bar(old, new)
        change = {old: new}
        made = replace(
            self,
            pins={change.get(p, p): at for p, at in self.pins.items()},
            bars={n: tuple(change.get(p, p) for p in pins) for n, pins in self.bars.items()},
            grounded=frozenset(change.get(p, p) for p in self.grounded),
            sliders={change.get(p, p): s for p, s in self.sliders.items()},
            crank=self.crank
            and self.crank._replace(pin=change.get(self.crank.pin, self.crank.pin)),
        )
        for bar, pins in self.bars.items():
            if old in pins and bar == _join_names(pins):
                made = made._rename_bar(bar, made.choose_bar_name(made.bars[bar]))
        return made

    def set_name(self, name: str) -> Sketch:
        """Give the mechanism a name."""
        if not name.strip():
            raise InputError("the name of the mechanism is empty")
        return replace(self, name=name.strip())

    def delete(self, name: str) -> Sketch:
        """Delete a pin or a bar; bars that are left with one pin go, too."""
        if name in self.bars:
            bars = {bar: pins for bar, pins in self.bars.items() if bar != name}
            return replace(self, bars=bars)._drop_lost_parts()
        self._check_pin(name)
        made = self
        for bar in self.list_bars_of(name):
            left = tuple(pin for pin in self.bars[bar] if pin != name)
            made = made.delete(bar) if len(left) < 2 else made._set_bar_pins(bar, left)
        pins = {pin: at for pin, at in made.pins.items() if pin != name}
        return replace(made, pins=pins)._drop_lost_parts()

    # ---- consistency

    def _list_names(self) -> set[str]:
        """List the names that are taken."""
        return {*self.pins, *self.bars}

    def _check_pin(self, pin: str) -> None:
        """Check that a pin exists. Errors: `InputError`."""
        if pin not in self.pins:
            raise InputError(f"there is no pin {pin}")

    def _check_bar(self, bar: str) -> None:
        """Check that a bar exists. Errors: `InputError`."""
        if bar not in self.bars:
            raise InputError(f"there is no bar {bar}")

    def check_bars(self) -> None:
        """Check that the pins of each bar are at different places. Errors: `InputError`."""
        for bar, pins in self.bars.items():
            for a, b in itertools.combinations(pins, 2):
                if self.measure_distance(a, b) <= SAME_PLACE:
                    raise InputError(f"bar {bar} would have length 0 between {a} and {b}")

    def choose_bar_name(self, pins: Iterable[str], wanted: str = "") -> str:
        """Choose a free name for a bar: the one that is `wanted` if it can be one, else its pins."""
        name = wanted if NAME.fullmatch(wanted) and wanted != GROUND else _join_names(pins)
        used = self._list_names()
        numbered = (f"{name}-{k}" for k in itertools.count(2))
        return next(n for n in itertools.chain([name], numbered) if n not in used)

    def _set_bar_pins(self, bar: str, pins: tuple[str, ...]) -> Sketch:
        """Give a bar other pins; its name follows if it is that of its pins."""
        named = bar == _join_names(self.bars[bar])
        made = replace(self, bars={n: pins if n == bar else p for n, p in self.bars.items()})
        return made._rename_bar(bar, made.choose_bar_name(pins)) if named else made

    def _rename_bar(self, old: str, new: str) -> Sketch:
        """Give a bar a free name."""
        change = {old: new}
        return replace(
            self,
            bars={change.get(n, n): pins for n, pins in self.bars.items()},
            sliders={
                pin: s._replace(carrier=change.get(s.carrier, s.carrier))
                for pin, s in self.sliders.items()
            },
            crank=self.crank
            and self.crank._replace(bar=change.get(self.crank.bar, self.crank.bar)),
        )

    def _drop_lost_parts(self) -> Sketch:
        """Drop what needs a pin or a bar that is no longer there: ground, sliders, the crank."""
        sliders = {
            pin: s
            for pin, s in self.sliders.items()
            if pin in self.pins and (s.carrier == GROUND or s.carrier in self.bars)
        }
        grounded = self.grounded & {*self.pins}
        crank = self.crank
        if crank is not None:
            turns = crank.pin in grounded and crank.pin in self.bars.get(crank.bar, ())
            slides = not crank.bar and crank.pin in sliders
            crank = crank if turns or slides else None
        return replace(self, grounded=grounded, sliders=sliders, crank=crank)


State = TypeVar("State")


class History(Generic[State]):
    """States, such as sketches, in the order in which they were made, for undo and redo."""

    def __init__(self, state: State):
        self.state = state
        self._before = list[State]()
        self._after = list[State]()
        self._key = ""

    def add_step(self, state: State, key: str = "") -> None:
        """Take a state as the present one; each change is one step.

        Changes with the same `key` that follow one another, as of a pin that is dragged, are one
        step together.
        """
        if state == self.state:
            return
        if not key or key != self._key:
            self._before.append(self.state)
        self._after.clear()
        self._key = key
        self.state = state

    def find_base(self, key: str) -> State:
        """Find the state before the changes with this key: the present one if they begin now."""
        return self._before[-1] if key and key == self._key else self.state

    def end_step(self) -> None:
        """End the changes that are one step together."""
        self._key = ""

    def undo_step(self) -> None:
        """Go back by one step. Errors: `InputError` at the first one."""
        if not self._before:
            raise InputError("there is nothing to undo")
        self.end_step()
        self._after.append(self.state)
        self.state = self._before.pop()

    def redo_step(self) -> None:
        """Take the last undo back. Errors: `InputError` without one."""
        if not self._after:
            raise InputError("there is nothing to redo")
        self.end_step()
        self._before.append(self.state)
        self.state = self._after.pop()


def iterate_pin_names() -> Iterator[str]:
    """Iterate over A, B, ..., Z, A1, B1, ..."""
    yield from LETTERS
    for k in itertools.count(1):
        yield from (f"{letter}{k}" for letter in LETTERS)


def _join_names(pins: Iterable[str]) -> str:
    """Join the names of pins to that of a bar: 'ABC', or 'left-right'."""
    names = list(pins)
    return ("" if all(len(n) == 1 for n in names) else "-").join(names)


def _read_point(at: Point) -> Point:
    """Read a point. Errors: `InputError` for numbers that are not finite."""
    x, y = (float(c) + 0.0 for c in at)
    if not (math.isfinite(x) and math.isfinite(y)):
        raise InputError(f"the place of a pin is ({x}, {y}); both must be finite numbers")
    return x, y


def _compute_angle(a: Point, b: Point) -> float:
    """Compute the direction from a point to another [rad]."""
    return math.atan2(b[1] - a[1], b[0] - a[0])


def _measure_distance_to_segment(at: Point, a: Point, b: Point) -> float:
    """Measure the distance of a point from the segment between two others."""
    x, y = b[0] - a[0], b[1] - a[1]
    square = x * x + y * y
    part = ((at[0] - a[0]) * x + (at[1] - a[1]) * y) / square if square else 0.0
    part = min(max(part, 0.0), 1.0)
    return math.dist(at, (a[0] + part * x, a[1] + part * y))
