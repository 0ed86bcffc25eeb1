"""Sketches of planar mechanisms without a page: edits, undo, the mechanism, its freedoms, its motion."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

import kempe
from kempe.errors import InputError
from kempe.library import list_models
from kempe.views.sketch.dimensions import set_distance
from kempe.views.sketch.mechanism import (
    compute_motion,
    describe_motion,
    examine_sketch,
    explain_missing_parts,
    list_bodies_of,
    make_mechanism,
    name_driver,
    write_python,
    write_sketch_toml,
)
from kempe.views.sketch.picture import draw_faces, place_labels, triangulate
from kempe.views.sketch.reading import read_sketch
from kempe.views.sketch.sketch import GROUND, History, Sketch, snap_point


def draw(places, bars=(), grounded=""):
    """A sketch of pins A, B, ... at places, with bars and grounded pins by their letters."""
    sketch = Sketch()
    for at in places:
        sketch, _ = sketch.add_pin(at)
    for pins in bars:
        sketch, name = sketch.add_bar(pins[0], pins[1])
        for pin in pins[2:]:
            sketch = sketch.extend_bar(name, pin)
            name = sketch.find_bar(pins[0], pin)
    for pin in grounded:
        sketch = sketch.ground_pin(pin)
    return sketch


FOUR_BAR = ((0, 0), (0, 0.1), (0.3, 0.4), (0.4, 0), (0.2, 0.5))


def draw_four_bar():
    return draw(FOUR_BAR, ["AB", "BCE", "CD"], "AD").set_crank("A")


def draw_slider_crank():
    sketch = draw([(0, 0), (0, 0.1), (0.3, 0)], ["AB", "BC"], "A")
    return sketch.slide_pin("C").set_crank("A")


def find_reason(call, *args):
    with pytest.raises(InputError) as caught:
        call(*args)
    return str(caught.value)


# ---- motions, by their closed forms


def test_a_drawn_four_bar_traces_the_curve_of_the_closed_form():
    """The coupler point by circles about the pins of the crank and of the rocker."""
    motion = compute_motion(examine_sketch(draw_four_bar()))
    A, B, C, D, E = (complex(*p) for p in FOUR_BAR)
    assert motion.path.closed and motion.traced == ["E"]
    b = motion.compute_places("B") @ [1, 1j]
    assert np.allclose(np.abs(b - A), abs(B - A), rtol=0, atol=1e-12)
    coupler, rocker = abs(C - B), abs(D - C)
    away = np.abs(D - b)
    along = (away**2 + coupler**2 - rocker**2) / (2 * away)
    c = b + (D - b) / away * (along + 1j * np.sqrt(coupler**2 - along**2))
    e = b + (c - b) * (E - B) / (C - B)
    assert np.allclose(motion.compute_places("C") @ [1, 1j], c, rtol=0, atol=1e-10)
    assert np.allclose(motion.compute_places("E") @ [1, 1j], e, rtol=0, atol=1e-10)
    assert np.ptp(np.unwrap(np.angle(b - A))) > 6.28


def test_a_drawn_slider_crank_moves_as_its_closed_form():
    motion = compute_motion(examine_sketch(draw_slider_crank()))
    b, c = (motion.compute_places(pin) for pin in "BC")
    assert motion.path.closed
    assert np.allclose(c[:, 1], 0, atol=1e-12)
    x = b[:, 0] + np.sqrt(0.1 - b[:, 1] ** 2)  # the rod is sqrt(0.1) long
    assert np.allclose(c[:, 0], x, rtol=0, atol=1e-10)


def test_a_pin_in_the_slot_of_a_bar_drives_it():
    """Whitworth's quick return: the lever points from its pivot to the pin of the crank."""
    sketch = draw([(0, 0), (0, 0.1), (0, -0.2), (0, 0.3)], ["AB", "CD"], "AC")
    sketch = sketch.slide_pin("B", math.pi / 2, "CD").set_crank("A")
    motion = compute_motion(examine_sketch(sketch))
    b, d = (motion.compute_places(pin) for pin in "BD")
    away = b - [0, -0.2]
    lever = [0, -0.2] + 0.5 * away / np.linalg.norm(away, axis=1)[:, None]
    assert motion.path.closed
    assert np.allclose(d, lever, rtol=0, atol=1e-10)


def test_a_slider_may_be_the_crank():
    sketch = draw_slider_crank().set_crank("C")
    motion = compute_motion(examine_sketch(sketch))
    assert make_mechanism(sketch).joints["slide of C"].actuated
    assert np.ptp(motion.compute_places("B") @ [1, 0]) == pytest.approx(0.2, abs=1e-3)


@pytest.mark.parametrize(
    ("sketch", "said"),
    [
        (draw_four_bar(), "The crank turns fully. Curve of E."),
        (draw_four_bar().set_crank("D"), "The crank swings to and fro. Curve of E."),
        (draw_slider_crank(), "The crank turns fully. Curves of B and C."),
        (draw_slider_crank().set_crank("C"), "The slider moves to and fro. Curves of B and C."),
    ],
)
def test_motions_are_described(sketch, said):
    assert describe_motion(compute_motion(examine_sketch(sketch))) == said


# ---- what is drawn


@pytest.mark.parametrize("sketch", [draw_four_bar(), draw_slider_crank().set_crank("C")])
def test_names_stand_beside_what_is_drawn(sketch):
    """No name is on a bar, a pin, a block, a symbol or an arrow, or near another name."""
    r = 0.01
    names = place_labels(sketch, r)
    assert [name.text for name in names] == [*sketch.pins]
    faces = [face for each in draw_faces(sketch, r).values() for face in each]
    for name in names:
        for face in faces:
            sides = np.roll(face.corners, -1, axis=0) - face.corners
            u, v = (name.at - face.corners).T
            turned = sides[:, 0] * v - sides[:, 1] * u
            assert turned.max() > 0 > turned.min()
    for a, b in itertools.combinations(names, 2):
        assert np.linalg.norm(a.at - b.at) > 4 * r


def test_all_that_is_drawn_faces_the_camera():
    """Triangles turn to the left, lie in their layers, and have the area of their faces."""
    for faces in draw_faces(draw_slider_crank(), 0.01, ["AB", "C"]).values():
        corners, colours = triangulate(faces, 0.01)
        a, b, c = corners.reshape(-1, 3, 3).swapaxes(0, 1)
        areas = 0.5 * np.cross(b - a, c - a)
        assert areas[:, 2].min() > -1e-12 and len(colours) == len(corners)
        u, v = zip(*((f.corners, np.roll(f.corners, -1, axis=0)) for f in faces), strict=True)
        own = sum(
            abs(0.5 * (p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0]).sum())
            for p, q in zip(u, v, strict=True)
        )
        assert areas[:, 2].sum() == pytest.approx(own, rel=1e-9)


# ---- what is said at each state


def test_each_state_of_a_sketch_is_said():
    """From nothing to a mechanism that plays, each sentence says what comes next."""
    said = lambda sketch: examine_sketch(sketch).sentence  # noqa: E731
    assert said(Sketch()) == "Click in the plane to place pins, then join them by bars."
    pins = draw(FOUR_BAR[:4])
    assert said(pins) == "No bar yet: join two pins by a bar."
    bars = draw(FOUR_BAR[:4], ["AB", "BC", "CD"])
    assert said(bars) == "Nothing is grounded: choose a pin that does not move."
    assert said(bars.ground_pin("A")) == (
        "3 degrees of freedom (Grübler count: 3). One crank leaves 2 freedoms: ground one more pin, "
        "or add a bar."
    )
    closed = bars.ground_pin("A").ground_pin("D")
    assert said(closed) == (
        "1 degree of freedom (Grübler count: 1). Choose the crank, and press play."
    )
    assert said(closed.set_crank_bar("CD")) == (
        "1 degree of freedom (Grübler count: 1). The crank is bar CD, which turns about D: press "
        "play."
    )
    rigid, _ = closed.add_bar("A", "C")
    assert said(rigid) == (
        "0 degrees of freedom (Grübler count: 0). A structure, which cannot move: delete a bar, or "
        "free a pin from the ground."
    )
    loose, _ = draw([*FOUR_BAR, (1, 1)], ["AB", "BC", "CD"], "AD").add_bar("E", "F")
    assert said(loose) == (
        "Bar EF is not connected to the ground: join a pin to the others, or ground it."
    )
    assert said(draw(FOUR_BAR, ["AB", "BC", "CD"], "AD")).endswith("Pin E belongs to no bar.")


def test_redundant_bars_are_counted_and_still_move():
    """A parallelogram with a third crank, all alike: Grübler's count is 0, and it moves."""
    places = [(0, 0), (0, 1), (1, 0), (1, 1), (2, 0), (2, 1)]
    sketch = draw(places, ["AB", "CD", "EF", "BDF"], "ACE").set_crank("A")
    found = examine_sketch(sketch)
    assert found.freedoms == 1
    assert found.sentence.startswith(
        "1 degree of freedom (Grübler count: 0; 1 redundant constraint)."
    )
    assert len(compute_motion(found).path.q) > 10


def test_what_cannot_be_played_is_refused_with_the_reason():
    bars = draw(FOUR_BAR[:4], ["AB", "BC", "CD"])
    chain = bars.ground_pin("A").set_crank("A")
    refused = lambda sketch: find_reason(compute_motion, examine_sketch(sketch))  # noqa: E731
    assert refused(chain) == (
        "One crank moves a mechanism with 1 degree of freedom, and this has 3. One crank leaves 2 "
        "freedoms: ground one more pin, or add a bar."
    )
    assert "No crank is chosen" in refused(bars.ground_pin("A").ground_pin("D"))
    assert "There is nothing to play yet. Nothing is grounded" in refused(bars)
    rigid, _ = bars.ground_pin("D").ground_pin("A").set_crank("A").add_bar("A", "C")
    assert "this has 0. A structure" in refused(rigid)
    # the crank stands still: its bar is part of a truss on the ground, and another bar turns
    truss = draw([(0, 0), (1, 0), (0.5, 1), (2, 0), (2, 1)], ["AC", "BC", "DE"], "ABD")
    assert "stands still while the rest moves" in refused(truss.set_crank("A"))


# ---- edits


def test_wrong_edits_are_refused_with_the_reason():
    sketch = draw_four_bar()
    for call, args, why in (
        (sketch.add_pin, ((0, 0),), "pin A is at this place already"),
        (sketch.add_pin, ((math.nan, 0),), "finite"),
        (sketch.add_bar, ("A", "A"), "two pins, not A with itself"),
        (sketch.add_bar, ("A", "B"), "bar AB joins A and B already"),
        (sketch.add_bar, ("A", "Z"), "there is no pin Z"),
        (sketch.extend_bar, ("BCE", "E"), "belongs to bar BCE already"),
        (sketch.extend_bar, ("BCE", "A"), "belong to bar AB"),
        (sketch.move_pin, ("B", (0, 0)), "bar AB would have length 0"),
        (sketch.slide_pin, ("B", 0.0, "AB"), "cannot slide on it"),
        (sketch.slide_pin, ("B", math.inf), "finite angle"),
        (sketch.set_crank, ("B",), "pin B is not grounded"),
        (sketch.set_crank_bar, ("BCE",), "none of its pins is grounded"),
        (sketch.ground_pin("E").ground_pin("B").set_crank_bar, ("BCE",), "B and E are grounded"),
        (sketch.rename, ("A", "B"), "names must differ"),
        (sketch.rename, ("A", "ground"), "names must differ"),
        (sketch.rename, ("A", "a b"), "cannot be a name"),
        (sketch.rename, ("Z", "Y"), "no pin or bar Z"),
        (sketch.delete, ("Z",), "there is no pin Z"),
        (sketch.set_name, (" ",), "empty"),
    ):
        assert why in find_reason(call, *args)
    shared, _ = draw(FOUR_BAR, ["AB", "BC"], "A").add_bar("A", "D")
    assert "2 bars (AB and AD)" in find_reason(shared.set_crank, "A")


def test_deleting_takes_what_needs_the_deleted_part():
    sketch = draw_four_bar()
    left = sketch.delete("E")
    assert left.bars == {"AB": ("A", "B"), "BC": ("B", "C"), "CD": ("C", "D")}
    left = sketch.delete("B")
    assert left.bars == {"CE": ("C", "E"), "CD": ("C", "D")} and left.crank is None
    assert sketch.delete("AB").crank is None and sketch.delete("CD").crank == sketch.crank
    slot = sketch.slide_pin("D", 0.0, "AB").delete("AB")
    assert slot.sliders == {} and "D" in slot.pins


def test_names_follow_in_all_that_uses_them():
    sketch = draw_four_bar().rename("A", "O").rename("BCE", "coupler").rename("B", "tip")
    assert {*sketch.bars} == {"O-tip", "coupler", "CD"}
    assert sketch.crank == ("O", "O-tip") and sketch.grounded == {"O", "D"}
    assert sketch.bars["coupler"] == ("tip", "C", "E")
    assert examine_sketch(sketch).freedoms == 1
    assert make_mechanism(sketch).joints["O"].actuated


def test_each_change_is_one_step_of_the_history():
    history = History(Sketch())
    seen = [history.state]
    for change in (
        lambda s: s.add_pin((0, 0))[0],
        lambda s: s.add_pin((1, 0))[0],
        lambda s: s.add_bar("A", "B")[0],
        lambda s: s.ground_pin("A"),
        lambda s: s.set_crank("A"),
        lambda s: set_distance(s, "A", "B", 2.0),
        lambda s: s.rename("B", "P"),
        lambda s: s.delete("P"),
    ):
        history.add_step(change(history.state))
        history.add_step(history.state)  # nothing has changed: no step
        seen.append(history.state)
    for sketch in seen[-2::-1]:
        history.undo_step()
        assert history.state == sketch
    assert "nothing to undo" in find_reason(history.undo_step)
    for sketch in seen[1:]:
        history.redo_step()
        assert history.state == sketch
    assert "nothing to redo" in find_reason(history.redo_step)
    history.undo_step()
    history.add_step(history.state.move_pin("A", (0, 1)))
    assert "nothing to redo" in find_reason(history.redo_step)


def test_points_snap_to_the_grid():
    assert snap_point((0.149, -0.251), 0.1) == (0.1, -0.3)
    assert snap_point((0.149, -0.251), 0.0) == (0.149, -0.251)
    assert snap_point((0.31, -0.01), 0.1) == (0.3, 0.0)


def test_parts_near_a_click_are_found():
    sketch = draw_four_bar()
    assert sketch.find_nearest_pin((0.01, 0.09), 0.03) == "B"
    assert sketch.find_nearest_pin((0.2, 0.2), 0.03) is None
    assert sketch.find_nearest_bar((0.35, 0.21), 0.03) == "CD"
    assert sketch.find_nearest_bar((0.1, 0.3), 0.03) == "BCE"
    assert sketch.find_nearest_bar((0.35, -0.2), 0.03) is None


# ---- dimensions


def measure_bars(sketch):
    return {
        (a, b): sketch.measure_distance(a, b)
        for pins in sketch.bars.values()
        for a, b in itertools.combinations(pins, 2)
    }


@pytest.mark.parametrize(
    ("pair", "length"), [("AB", 0.13), ("BC", 0.5), ("CE", 0.2), ("CD", 0.35), ("AB", 0.02)]
)
def test_a_typed_length_leaves_all_others(pair, length):
    sketch = draw_four_bar()
    made = set_distance(sketch, *pair, length)
    wanted = measure_bars(sketch) | {tuple(pair): length}
    assert measure_bars(made) == pytest.approx(wanted, abs=1e-12)
    assert {p: made.pins[p] for p in "AD"} == {p: sketch.pins[p] for p in "AD"}
    assert compute_motion(examine_sketch(made)).path.q.shape[0] > 10


def test_the_ground_between_two_pins_is_typed():
    sketch = draw_four_bar()
    made = set_distance(sketch, "A", "D", 0.45)
    assert made.pins["A"] == (0, 0) and made.pins["D"] == pytest.approx((0.45, 0))
    assert measure_bars(made) == pytest.approx(measure_bars(sketch), abs=1e-12)


def test_sliders_stay_on_their_lines_when_a_length_is_typed():
    made = set_distance(draw_slider_crank(), "B", "C", 0.4)
    assert made.pins["C"][1] == pytest.approx(0, abs=1e-12)
    assert made.measure_distance("A", "B") == pytest.approx(0.1, abs=1e-12)
    sketch = draw([(0, 0), (0.05, 0.1), (0, -0.2), (0.1, 0.4)], ["AB", "CD"], "AC")
    sketch = sketch.slide_pin("B", math.atan2(0.6, 0.1), "CD")
    made = set_distance(sketch, "A", "B", 0.15)
    before, after = (examine_sketch(s).freedoms for s in (sketch, made))
    assert before == after == 1
    way = np.subtract(made.pins["D"], made.pins["C"])
    assert made.sliders["B"].angle == pytest.approx(math.atan2(way[1], way[0]), abs=1e-12)
    # the line keeps its distance from the pivot
    off = []
    for each in (sketch, made):
        x, y = np.subtract(each.pins["B"], each.pins["C"])
        u, v = np.subtract(each.pins["D"], each.pins["C"])
        off.append(x * v - y * u)
    assert off[0] == pytest.approx(off[1], abs=1e-12)


def test_lengths_that_are_impossible_are_refused_with_the_reason():
    sketch = draw_four_bar()
    assert find_reason(set_distance, sketch, "A", "B", 3.0) == (
        "bar AB cannot be 3 m long: the other bars, which keep their lengths, do not close with it"
    )
    assert "must be more than 0" in find_reason(set_distance, sketch, "A", "B", 0.0)
    assert "must be more than 0" in find_reason(set_distance, sketch, "A", "B", math.nan)
    assert "no bar together" in find_reason(set_distance, sketch, "A", "C", 1.0)
    assert "the ground between A and D cannot" in find_reason(set_distance, sketch, "A", "D", 9.0)


def test_a_pin_on_the_line_of_a_bar_keeps_its_part_of_it():
    sketch = draw([(0, 0), (1, 0), (0.25, 0)], ["ABC"], "A")
    made = set_distance(sketch, "A", "B", 2.0)
    assert made.pins["C"] == pytest.approx((0.5, 0)) and made.pins["B"] == pytest.approx((2, 0))


# ---- as text


@pytest.mark.parametrize("sketch", [draw_four_bar(), draw_slider_crank()])
def test_python_and_toml_give_the_same_mechanism(sketch):
    scope = {}
    exec(write_python(sketch), scope)
    written = write_sketch_toml(sketch)
    loaded = kempe.load(written)
    assert loaded == make_mechanism(sketch).build() == scope["system"]
    assert loaded.mobility(loaded.neutral).dof == 1


def find_curves(system, q, driver, turns, frames):
    """Places of frames (n, 2) by name while a coordinate moves on from q by some amounts."""
    path = system.assemble({driver: q[driver] + turns}, start=q, prefer="continuous")
    assert np.all(path.success)
    return {f: system.fk(path.q, f)[..., :2, 3] for f in frames}


PLANAR = [name for name in list_models() if kempe.load(name).dim == 2]
NOT_DRAWN = ("car", "three_rpr")
"""Planar models with other parts than pins, bars and sliders of pins."""


def draw_model(name):
    """A planar model, its closed configuration, its sketch and the mechanism of the sketch."""
    system = kempe.load(name)
    sketch, lost = read_sketch(system)
    assert not lost or any("parameters" in text for text in lost)
    closed = system.q("closed") if "closed" in system.mechanism.postures else None
    return system, system.assemble(start=closed).q, sketch, make_mechanism(sketch).build()


@pytest.mark.parametrize("name", [name for name in PLANAR if name not in NOT_DRAWN])
def test_shipped_mechanisms_are_drawn_where_they_stand(name):
    system, q, sketch, drawn = draw_model(name)
    assert drawn.mobility(drawn.neutral).dof == system.mobility(q).dof
    for frame in {*system.mechanism.frames} & {*sketch.pins}:
        here = system.fk(q, frame)[:2, 3]
        assert np.allclose(drawn.fk(drawn.neutral, frame)[:2, 3], here, atol=1e-9)


@pytest.mark.parametrize("name", ["four_bar", "jansen", "klann", "peaucellier", "watt_six_bar"])
def test_shipped_mechanisms_move_as_they_are_drawn(name):
    system, q, sketch, drawn = draw_model(name)
    driver = name_driver(sketch)
    turns = np.linspace(0, 0.3, 7)
    named = [*{*system.mechanism.frames} & {*sketch.pins}]
    one = find_curves(
        system, dict(zip(system.coordinate_names, q, strict=True)), driver, turns, named
    )
    two = find_curves(drawn, dict.fromkeys(drawn.coordinate_names, 0.0), driver, turns, named)
    assert named and all(np.allclose(one[f], two[f], atol=1e-8) for f in named)
    assert max(np.ptp(curve) for curve in one.values()) > 1e-3


@pytest.mark.parametrize("name", NOT_DRAWN)
def test_models_with_other_parts_are_refused(name):
    assert "cannot be drawn" in find_reason(read_sketch, kempe.load(name))


@st.composite
def sketches(draw_number):
    """Random sketches in general position: pins, bars, plates, sliders, ground."""
    number = st.floats(-1, 1).map(lambda x: round(x, 3))
    places = draw_number(st.lists(st.tuples(number, number), min_size=2, max_size=7, unique=True))
    rng = np.random.default_rng(len(places))
    sketch = draw([tuple(np.array(p) + 0.1 * rng.normal(size=2)) for p in places])
    pins = st.sampled_from([*sketch.pins])
    for _ in range(draw_number(st.integers(1, 12))):
        kind = draw_number(st.sampled_from(["bar", "bar", "bar", "plate", "ground", "slide"]))
        try:
            if kind == "bar":
                sketch, _ = sketch.add_bar(draw_number(pins), draw_number(pins))
            elif kind == "plate" and sketch.bars:
                bar = draw_number(st.sampled_from([*sketch.bars]))
                sketch = sketch.extend_bar(bar, draw_number(pins))
            elif kind == "ground":
                sketch = sketch.ground_pin(draw_number(pins))
            elif kind == "slide":
                sketch = sketch.slide_pin(draw_number(pins), rng.uniform(0, 3))
        except InputError:
            continue
    return sketch


@settings(deadline=None, max_examples=60)
@given(sketches())
def test_random_sketches_are_read_as_they_were_drawn(sketch):
    assume(not explain_missing_parts(sketch))
    assume(make_mechanism(sketch).build().assemble().success)
    read, lost = read_sketch(make_mechanism(sketch).build())
    used = {p: at for p, at in sketch.pins.items() if list_bodies_of(sketch, p)}
    assert not lost and {*read.pins} == {*used} and read.grounded == sketch.grounded
    assert all(np.allclose(read.pins[p], at, atol=1e-8) for p, at in used.items())
    assert {b: {*p} for b, p in read.bars.items()} == {b: {*p} for b, p in sketch.bars.items()}
    assert {p: s.carrier for p, s in read.sliders.items()} == {
        p: s.carrier for p, s in sketch.sliders.items()
    }
    for pin, slider in read.sliders.items():
        assert abs(math.sin(slider.angle - sketch.sliders[pin].angle)) < 1e-8


def test_what_a_drawing_does_not_keep_is_listed():
    m = kempe.Mechanism("press", dim=2, unit="mm")
    crank, rod, ram = (m.body(n) for n in ("crank", "rod", "ram"))
    m.revolute("A", m.ground, crank, limits=(-1.0, 1.0))
    m.revolute("B", crank, rod, at=(100, 0))
    m.prismatic("slide", m.ground, ram, axis=(0, 1), at=(50, 0), actuated=True)
    m.revolute("C", rod, ram, at=(300, 0))
    m.frame("die", ram, at=(0, -80))
    sketch, lost = read_sketch(m.build())
    assert lost == ["limits of A", "frame die beside its pin"]
    assert sketch.unit == "mm" and sketch.crank == ("C", "")
    assert make_mechanism(sketch).build().unit == "mm"
    assert 'unit="mm"' in write_python(sketch)
    assert sketch.measure_distance("A", "B") == pytest.approx(100)
    assert "a length is -1 mm" in find_reason(set_distance, sketch, "A", "B", -1.0)


def test_what_cannot_be_drawn_is_refused_with_the_reason():
    assert "moves in space" in find_reason(read_sketch, kempe.load("bennett"))
    m = kempe.Mechanism("lamp", dim=2)
    m.revolute("A", m.ground, m.body("arm"))
    assert "a frame counts as a pin" in find_reason(read_sketch, m.build())
    m = kempe.Mechanism("far", dim=2)
    one, two = m.body("one"), m.body("two")
    m.revolute("A", m.ground, one)
    m.revolute("B", one, two, at=(1, 0))
    m.revolute("C", two, m.ground, at=(1, 0), child_at=(5, 0))
    assert "cannot be closed" in find_reason(read_sketch, m.build())


def count_freedoms(sketch, rng):
    """Freedoms by the rank of the distances between pins, at random places: bars as springs."""
    used = [p for p in sketch.pins if sketch.list_bars_of(p) or p in sketch.sliders]
    at = {p: rng.normal(size=2) for p in used}
    rows = []
    for pins in sketch.bars.values():
        pairs = [(pins[0], pins[1])] + [(a, p) for p in pins[2:] for a in pins[:2]]
        for a, b in pairs:
            row = np.zeros((len(used), 2))
            row[used.index(a)] = at[a] - at[b]
            row[used.index(b)] = at[b] - at[a]
            rows.append(row)
    for p in used:
        ways = np.eye(2) if p in sketch.grounded else []
        if p in sketch.sliders:
            a = sketch.sliders[p].angle
            ways = [[-math.sin(a), math.cos(a)]]
        for way in ways:
            row = np.zeros((len(used), 2))
            row[used.index(p)] = way
            rows.append(row)
    matrix = np.array(rows).reshape(len(rows), -1)
    return matrix.shape[1] - np.linalg.matrix_rank(matrix)


@settings(deadline=None, max_examples=40)
@given(sketches())
def test_freedoms_of_random_sketches_are_those_of_springs(sketch):
    """In general position; the drawn position closes all loops, and bodies are where they are drawn."""
    found = examine_sketch(sketch)
    assert found.sentence
    assume(found.system is not None)
    system = found.system
    assert np.allclose(system.fk(system.neutral), np.eye(4), rtol=0, atol=1e-12)
    assert np.abs(system.loops.closure_error(system.neutral)).max(initial=0.0) < 1e-12
    for pin in sketch.pins:
        if pin in system.structure.frames:
            place = system.fk(system.neutral, pin)[:2, 3]
            assert np.allclose(place, sketch.pins[pin], rtol=0, atol=1e-12)
    assert found.freedoms == count_freedoms(sketch, np.random.default_rng(0))
    scope = {}
    exec(write_python(sketch).replace("print(", "str("), scope)
    assert scope["system"] == system == kempe.load(write_sketch_toml(sketch))


@settings(deadline=None, max_examples=25)
@given(sketches(), st.integers(0, 2**32 - 1))
def test_typed_lengths_of_random_sketches_hold_or_are_refused(sketch, seed):
    rng = np.random.default_rng(seed)
    pairs = [*measure_bars(sketch)]
    assume(pairs)
    pair = pairs[rng.integers(len(pairs))]
    length = float(sketch.measure_distance(*pair) * rng.uniform(0.8, 1.2))
    try:
        made = set_distance(sketch, *pair, length)
    except InputError as error:
        assert "cannot be" in str(error)
        made = None
    assume(made is not None)
    held = [
        (a, b)
        for bar, pins in sketch.bars.items()
        for a, b in itertools.combinations(pins[:2] if {*pair} <= {*pins} else pins, 2)
    ]
    before, after = measure_bars(sketch), measure_bars(made)
    assert after[pair] == pytest.approx(length, abs=1e-9)
    assert all(after[p] == pytest.approx(before[p], abs=1e-9) for p in held if {*p} != {*pair})
    for pin, slider in sketch.sliders.items():
        if slider.carrier == GROUND:
            x, y = np.subtract(made.pins[pin], sketch.pins[pin])
            off = x * math.sin(slider.angle) - y * math.cos(slider.angle)
            assert off == pytest.approx(0, abs=1e-9)
    fixed = [p for p in sketch.grounded if {*pair} - sketch.grounded or p not in pair]
    assert all(made.pins[p] == sketch.pins[p] for p in fixed)
