"""A sketch as a `Mechanism`, as Python, and what is said about it while it is drawn.

All bodies have the axes of the ground in the drawn position, where all coordinates are zero.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from kempe.description.mechanism import Mechanism
from kempe.description.toml_writer import write_toml
from kempe.errors import InputError, KempeError
from kempe.forward.fk import fk
from kempe.mobility.mobility import mobility
from kempe.motion.trace import trace
from kempe.spatial import Array
from kempe.units import METRE
from kempe.views.sketch.sketch import GROUND, Crank, Sketch
from kempe.words import choose_verb, format_count, join_words, make_plural

if TYPE_CHECKING:
    from kempe.model.model import Model
    from kempe.motion.path import Path

ROUNDING = 15
"""Decimals of a direction: those of the right angles are exact."""


class Call(NamedTuple):
    """A call of a method of `Mechanism`: its name, names as arguments, and keywords.

    `pin` is that whose place is given as `at`, and to joints as `child_at`.
    """

    method: str
    names: tuple[str, ...]
    pin: str = ""
    keywords: tuple[tuple[str, Any], ...] = ()


def list_calls(sketch: Sketch) -> list[Call]:
    """List the calls that make the mechanism of a sketch.

    At a pin all bodies turn about the first of them: the block of a slider, else the ground, else a
    bar. Pins without a bar, a slider or the ground are left out.
    """
    calls = [Call("body", (bar,)) for bar in sketch.bars]
    calls += [Call("body", (_name_block(pin),)) for pin in sketch.sliders]
    frames = list[Call]()
    driven = name_driver(sketch)
    for pin in sketch.pins:
        bodies = list_bodies_of(sketch, pin)
        for body in bodies[1:]:
            name = name_joint(sketch, pin, body)
            driver = (("actuated", True),) if name == driven else ()
            calls.append(Call("revolute", (name, bodies[0], body), pin, driver))
        if (slider := sketch.sliders.get(pin)) is not None:
            way = tuple(round(f(slider.angle), ROUNDING) + 0.0 for f in (math.cos, math.sin))
            name = _name_slide(pin)
            driver = (("actuated", True),) if name == driven else ()
            keywords = (("axis", way), *driver)
            calls.append(Call("prismatic", (name, slider.carrier, _name_block(pin)), pin, keywords))
        if bodies:
            frames.append(Call("frame", (pin, bodies[0]), pin))
    return calls + frames


def list_bodies_of(sketch: Sketch, pin: str) -> list[str]:
    """List the bodies that meet at a pin, the one about which the others turn first."""
    first = [_name_block(pin)] if pin in sketch.sliders else []
    first += [GROUND] if pin in sketch.grounded else []
    return first + sketch.list_bars_of(pin)


def name_joint(sketch: Sketch, pin: str, body: str) -> str:
    """Name the joint between a bar and the first body at its pin: the pin, or both if there are more."""
    return pin if body == list_bodies_of(sketch, pin)[1] else f"{pin} {body}"


def name_driver(sketch: Sketch) -> str:
    """Name the joint that the crank drives; empty without a crank."""
    crank = sketch.crank
    if crank is None:
        return ""
    return name_joint(sketch, crank.pin, crank.bar) if crank.bar else _name_slide(crank.pin)


def _name_block(pin: str) -> str:
    """Name the block that slides with a pin."""
    return f"block of {pin}"


def _name_slide(pin: str) -> str:
    """Name the joint along which a pin slides."""
    return f"slide of {pin}"


# ---- the mechanism


def make_mechanism(sketch: Sketch) -> Mechanism:
    """Make the mechanism of a sketch, with the drawn position as its posture `closed`.

    Errors: `InputError` where a part is not connected to the ground.
    """
    if missing := explain_missing_parts(sketch):
        raise InputError(missing)
    m = Mechanism(sketch.name, dim=2, unit=sketch.unit)
    for call in list_calls(sketch):
        keywords = dict(call.keywords)
        if call.pin:
            keywords["at"] = sketch.pins[call.pin]
            if call.method != "frame":
                keywords["child_at"] = keywords["at"]
        getattr(m, call.method)(*call.names, **keywords)
    m.posture("closed", dict.fromkeys(m.joints, 0.0))
    return m


def write_python(sketch: Sketch) -> str:
    """Write the program that makes the mechanism of a sketch, and counts its freedoms.

    Errors: `InputError` where a part is not connected to the ground.
    """
    make_mechanism(sketch)
    unit = "" if sketch.unit == METRE else f", unit={_quote(sketch.unit)}"
    lines = [
        "import kempe",
        "",
        f"P = {{  # places of the pins as drawn [{sketch.unit}]",
        *(f"    {_quote(pin)}: {place!r}," for pin, place in sketch.pins.items()),
        "}",
        f"m = kempe.Mechanism({_quote(sketch.name)}, dim=2{unit})",
    ]
    for call in list_calls(sketch):
        words = [_quote(name) for name in call.names]
        words += [f"at=P[{_quote(call.pin)}]"] * bool(call.pin)
        words += [f"child_at=P[{_quote(call.pin)}]"] * (call.method in ("revolute", "prismatic"))
        words += [f"{key}={value!r}" for key, value in call.keywords]
        lines.append(f"m.{call.method}({', '.join(words)})")
    lines += [
        'm.posture("closed", dict.fromkeys(m.joints, 0.0))',
        "system = m.build()",
        "print(system.mobility(system.neutral).sentence)",
    ]
    return "\n".join(lines) + "\n"


def _quote(text: str) -> str:
    """Write a text as Python does, between double quotes."""
    return json.dumps(text, ensure_ascii=False)


def write_sketch_toml(sketch: Sketch) -> str:
    """Write the mechanism of a sketch as TOML. Errors: `InputError` as in `make_mechanism`."""
    return write_toml(make_mechanism(sketch))


# ---- what is said

NOTHING_YET = "Click in the plane to place pins, then join them by bars."


def explain_missing_parts(sketch: Sketch) -> str:
    """Explain what a sketch still needs before it is a mechanism; empty if it is one."""
    if not sketch.pins:
        return NOTHING_YET
    if not sketch.bars and not sketch.sliders:
        return "No bar yet: join two pins by a bar."
    if not sketch.grounded and all(s.carrier != GROUND for s in sketch.sliders.values()):
        return "Nothing is grounded: choose a pin that does not move."
    loose = _list_loose_bodies(sketch)
    if not loose:
        return ""
    what = f"{make_plural(len(loose), 'bar').capitalize()} {join_words(loose)}"
    verb = choose_verb(len(loose), "is", "are")
    return f"{what} {verb} not connected to the ground: join a pin to the others, or ground it."


def _list_loose_bodies(sketch: Sketch) -> list[str]:
    """List the bodies that no joints connect to the ground."""
    links = [list_bodies_of(sketch, pin) for pin in sketch.pins]
    links += [[s.carrier, _name_block(pin)] for pin, s in sketch.sliders.items()]
    reached = {GROUND}
    grown = True
    while grown:
        grown = False
        for bodies in links:
            if reached & {*bodies} and not {*bodies} <= reached:
                reached |= {*bodies}
                grown = True
    blocks = [_name_block(pin) for pin in sketch.sliders]
    return [body for body in (*sketch.bars, *blocks) if body not in reached]


@dataclass
class Findings:
    """What a sketch is as a mechanism.

    `sentence` says it, `freedoms` is None where the sketch is no mechanism yet or the number is
    not known.
    """

    sketch: Sketch
    system: Model | None = None
    sentence: str = ""
    freedoms: int | None = None


def examine_sketch(sketch: Sketch) -> Findings:
    """Examine a sketch: what it still needs, how many degrees of freedom it has, what comes next."""
    if missing := explain_missing_parts(sketch):
        return Findings(sketch, sentence=missing)
    try:
        system = make_mechanism(sketch).build()
        found = mobility(system, np.zeros(system.nq))
    except KempeError as error:
        return Findings(sketch, sentence=str(error))
    findings = Findings(sketch, system, freedoms=found.dof)
    findings.sentence = f"{found.sentence}. {_advise(findings)}{_name_idle_pins(sketch)}"
    return findings


def _advise(findings: Findings) -> str:
    """Say what the number of freedoms means for the one who draws."""
    count = findings.freedoms
    crank = findings.sketch.crank
    if count is None:
        return ""
    if count == 0:
        return "A structure, which cannot move: delete a bar, or free a pin from the ground."
    if count > 1:
        return (
            f"One crank leaves {format_count(count - 1, 'freedom')}: ground one more pin, or add a "
            "bar."
        )
    if crank is None:
        return "Choose the crank, and press play."
    return f"The crank is {describe_crank(crank)}: press play."


def describe_crank(crank: Crank) -> str:
    """Describe the crank: 'bar AB, which turns about A'."""
    if not crank.bar:
        return f"the slider of {crank.pin}"
    return f"bar {crank.bar}, which turns about {crank.pin}"


def _name_idle_pins(sketch: Sketch) -> str:
    """Name the pins that belong to no bar, in a sentence."""
    idle = [p for p in sketch.pins if not list_bodies_of(sketch, p)]
    if not idle:
        return ""
    return (
        f" {choose_verb(len(idle), 'Pin', 'Pins')} {join_words(idle)} "
        f"{choose_verb(len(idle), 'belongs', 'belong')} to no bar."
    )


# ---- the motion


FRAMES = 240
"""Configurations of a motion, at equal distances along its path."""


@dataclass(frozen=True)
class Motion:
    """Motion of a sketch by its crank: the path, and the poses of its bodies (n, bodies, 4, 4)."""

    sketch: Sketch
    path: Path
    bodies: tuple[str, ...]
    poses: Array

    def compute_places(self, pin: str) -> Array:
        """Compute the places (n, 2) of a pin during the motion."""
        body = list_bodies_of(self.sketch, pin)[0]
        X = self.poses[:, self.bodies.index(body)]
        return X[:, :2, :2] @ np.array(self.sketch.pins[pin]) + X[:, :2, 3]

    @property
    def traced(self) -> list[str]:
        """Pins whose curves are shown: free ends of moving bars, else all moving pins."""
        moving = [
            p
            for p in self.sketch.pins
            if p not in self.sketch.grounded and list_bodies_of(self.sketch, p)
        ]
        ends = [p for p in moving if len(list_bodies_of(self.sketch, p)) == 1]
        return ends or moving


def compute_motion(findings: Findings) -> Motion:
    """Compute the motion of a sketch by its crank. Errors: `InputError` with what prevents it."""
    sketch = findings.sketch
    system = findings.system
    if system is None or findings.freedoms is None:
        raise InputError(f"There is nothing to play yet. {findings.sentence}")
    if findings.freedoms != 1:
        raise InputError(
            f"One crank moves a mechanism with 1 degree of freedom, and this has "
            f"{findings.freedoms}. {_advise(findings)}"
        )
    if sketch.crank is None:
        raise InputError("No crank is chosen: click on a bar at a grounded pin, or on a slider.")
    driver = name_driver(sketch)
    path = trace(system, driver, start=np.zeros(system.nq))
    if len(path.q) < 2:
        raise InputError(f"The crank, {describe_crank(sketch.crank)}, cannot move: {path.status}")
    k = system.coordinate_names.index(driver)
    if float(np.ptp(path.q[:, k])) <= 1e-9:
        raise InputError(
            f"The crank, {describe_crank(sketch.crank)}, stands still while the rest moves: choose "
            "another one."
        )
    return Motion(sketch, path, system.body_names, fk(system, path.resample(FRAMES).q))


def describe_motion(motion: Motion) -> str:
    """Describe a motion: how the crank or the slider moves, and whose curves are drawn."""
    crank = motion.sketch.crank
    how = "The slider moves to and fro."
    if crank is not None and crank.bar:
        whole = motion.path.turns.get(name_driver(motion.sketch), 0)
        how = "The crank turns fully." if whole else "The crank swings to and fro."
    curves = f"{make_plural(len(motion.traced), 'curve').capitalize()} of"
    return f"{how} {curves} {join_words(motion.traced)}." if motion.traced else how
