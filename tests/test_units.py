"""Sentences, tables and pictures name the unit of the mechanism: a designer's millimetres are no metres.

The same mechanisms in metres and in millimetres say the same but for numbers and the unit.
"""

import re
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from command import Result

import kempe
from kempe import units
from kempe.description.length_units import convert_unit
from kempe.errors import InputError, KempeError
from kempe.library import list_models
from kempe.model.characteristic_length import compute_characteristic_length
from kempe.model.configurations import list_units
from kempe.units import name_lengths
from kempe.views.facts import SystemFacts
from kempe.words import InWords

METRES = re.compile(r"(?<![\w'\"`.])m(?![\w'\"`=]| =)|\bmetres?\b")
"""The unit, as a word of its own."""
NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:e[-+]?\d+)?|\b(?:one|two|three|no)\b")


def in_millimetres(X):
    """Return poses or places with lengths in millimetres."""
    out = np.array(X, dtype=float)
    if out.shape[-2:] == (4, 4):
        out[..., :3, 3] *= 1e3
        return out
    return out * 1e3


def make_slider_crank():
    m = kempe.Mechanism("slider-crank", dim=2)
    m.revolute("crank", m.ground, m.body("crank"), actuated=True)
    m.revolute("pin", "crank", m.body("rod"), at=(0.04, 0))
    m.revolute("wrist", "rod", m.body("piston"), at=(0.12, 0))
    m.prismatic("stroke", m.ground, "piston", axis="x", limits=(0.08, 0.16))
    m.frame("tip", "piston", at=(0.01, 0))
    return m


def make_arm():
    m = kempe.from_dh([{"d": 0.4, "alpha": np.pi / 2}, {"a": 0.35}, {"a": 0.2}], name="arm3")
    m.prismatic("s", "link3", m.body("hand", mass=1.0, center=(0.01, 0, 0.02)), limits=(0, 0.3))
    m.helical("h", "hand", m.body("screw"), pitch=0.01, limits=(-1, 1))
    m.frame("tip", "screw", at=(0.05, 0, 0))
    m.shape("hand", "capsule", radius=0.04, length=0.1)
    m.shape("link1", "box", size=(0.1, 0.1, 0.2))
    m.obstacle("table", "box", size=(1, 1, 0.1), at=(0, 0, -0.3))
    return m


def make_rods():
    m = kempe.Mechanism("rods")
    m.spherical("A", m.ground, m.body("a"))
    m.frame("p", "a", at=(0.3, 0, 0))
    m.constrain(kempe.constraints.Distance("p", "ground", 0.5, other_point=(0, 0.4, 0)), name="rod")
    m.frame("plane", m.ground, at=(0, 0, -0.2))
    m.contact("c", "a", "plane")
    return m


def make_car():
    car = kempe.Mechanism("car", dim=2)
    car.planar("drive", car.ground, car.body("body"))
    car.no_sideslip("rear axle", "body")
    return car


def say_slider_crank(system, k):
    """Yield what verbs say of a slider-crank with its numbers k times as large."""
    at = system.q({"crank": 0.5, "stroke": 0.15 * k})
    q = system.assemble({"crank": 0.5}, start={"stroke": 0.15 * k}).q
    yield lambda: system
    yield lambda: system.assemble({"crank": 0.5}, start=at)
    yield lambda: system.assemble({"stroke": 0.3 * k})
    yield lambda: system.assembly_modes({"crank": 0.5})
    yield lambda: system.mobility()
    yield lambda: system.mobility(q)
    yield lambda: system.trace("crank", start=q)
    yield lambda: system.drive({"crank": 1.0}, start=q)
    yield lambda: system.workspace("tip", n=2000)
    yield lambda: system.configuration_space
    yield lambda: system.configuration_space.components()
    yield lambda: system.singularities()
    yield lambda: system.singularities("tip")
    yield lambda: system.task_space("tip")
    yield lambda: system.idealise()
    yield lambda: system.independent()
    yield lambda: system.loops.relative_motion(q, "rod", "ground")
    yield lambda: system.loops.transmission_angle("wrist", q)
    yield lambda: system.loops.closed_form({"crank": 0.5})
    yield lambda: system.reach.planar("tip")
    yield lambda: system.simulate(0.5, start=q, inputs={"crank": 1.0})
    for part in (system.structure.joints, system.structure.frames):
        yield from ((lambda x=x: x) for x in part.values())
    yield lambda: SystemFacts(system)
    yield lambda: system.ik((0.1 * k, 0), "tip", tolerance=1e-5).judged
    yield lambda: system.ik((0.1 * k, 0), "tip")
    yield lambda: system.ik((1.5 * k, 0), "tip")
    yield lambda: system.ik(
        [kempe.tasks.Position("tip", (0.1 * k, 0)), kempe.tasks.Position("rod", (9 * k, 0))]
    )
    yield lambda: system.loops
    yield lambda: system.ik_step(q, np.array([5 * k, 0, 0, 0, 0, 0]), "tip", dt=0.1)


def say_arm(system, k):
    """Yield what verbs say of an arm with its numbers k times as large."""
    q = system.q({"q1": 0.3, "q2": 0.4, "q3": 0.5, "s": 0.1 * k})
    X = system.fk(q, "tip")
    far = X.copy()
    far[0, 3] += 5 * k
    yield lambda: system
    yield lambda: system.ik(X, "tip")
    yield lambda: system.ik(far, "tip")
    yield lambda: system.ik(np.stack([X, far]), "tip")
    yield lambda: system.ik(X[:3, 3], "tip")
    yield lambda: system.ik(
        [kempe.tasks.Position("tip", X[:3, 3]), kempe.tasks.Position("hand", far[:3, 3])]
    )
    yield lambda: system.ik(
        [kempe.tasks.Position("tip", X[:3, 3]), kempe.tasks.Clearance(at_least=0.02 * k)]
    )
    yield lambda: system.ik_all(X[:3, 3], "link2")
    yield lambda: system.ik_path(np.stack([X, X]), "tip", start=q)
    yield lambda: system.ik_path(np.stack([X, far]), "tip", start=q)
    yield lambda: system.geometry.nearest(q)
    yield lambda: system.reach.poses(X[None], "tip")
    yield lambda: system.reach.capability("tip", cells=3, box=((-k, -k, -k), (k, k, k)))
    yield lambda: system.inverse.plan("tip")
    yield lambda: system.inverse.plan("link2", task="position")
    yield lambda: system.inverse.self_motion(q, kempe.tasks.Position("tip", X[:3, 3]))
    yield lambda: system.symbolic.to_dh("tip")
    yield lambda: system.symbolic.ik("link2", task="position")
    yield lambda: system.ik(far, "tip", history=True)
    yield lambda: system.task_space("tip")
    yield lambda: SystemFacts(system)
    yield lambda: system.mobility()
    yield lambda: system.workspace("tip", n=2000)
    yield lambda: system.ik_step(q, np.zeros(6), "tip", dt=0.1)


def say_rods(system, k):
    """Yield what verbs say of a body on a rod."""
    yield lambda: system
    yield lambda: SystemFacts(system)
    yield lambda: system.loops.relative_motion(system.assemble().q, "a", "ground")
    yield lambda: system.mobility()
    yield lambda: system.assemble()
    yield lambda: system.assemble({"A": [1, 0, 0, 0]})
    yield lambda: system.classify()


def say_car(system, k):
    """Yield what verbs say of a car."""
    q = system.neutral
    yield lambda: system.classify()
    yield lambda: system.manoeuvre(q, system.q({"drive.y": 2.0 * k}))
    yield lambda: system.ik_step(q, np.array([0, k, 0, 0, 0, 0]), "body", dt=0.1)


CASES = {
    "slider crank": (make_slider_crank, say_slider_crank),
    "arm": (make_arm, say_arm),
    "rods": (make_rods, say_rods),
    "car": (make_car, say_car),
}


def list_texts(thing):
    """List the texts that an answer shows."""
    if thing is None:
        return []
    out = [str(thing)]
    if hasattr(thing, "text") and callable(thing.text):
        out += [thing.text(), thing.text(degrees=True), thing._repr_html_()]
    parts = [x for x in getattr(thing, "__dict__", {}).values()]
    for part in [*parts, *(x for p in parts if isinstance(p, (list, tuple)) for x in p)]:
        if isinstance(part, InWords):
            out.append(str(part))
    if hasattr(thing, "status"):
        out += np.ravel(np.asarray(thing.status, dtype=object)).tolist()
    return out


def list_answer_texts(ask):
    """List the texts of an answer, or of the error in its place."""
    try:
        return list_texts(ask())
    except KempeError as error:
        return [str(error)]


@cache
def list_millimetre_texts(name):
    """List the texts of each answer of a case whose lengths are in millimetres."""
    make, say = CASES[name]
    return [list_answer_texts(x) for x in say(convert_unit(make(), "mm").build(), 1e3)]


@pytest.mark.parametrize("name", CASES)
def test_no_sentence_in_millimetres_says_metres(name):
    said = list_millimetre_texts(name)
    wrong = [line for texts in said for t in texts for line in t.split("\n")]
    wrong = [line for line in wrong if METRES.search(re.sub('src="[^"]*"', "", line))]
    assert not wrong, "\n".join(dict.fromkeys(wrong))


def test_texts_without_a_unit_stay_as_they_are():
    text = "0.5 m, 'm' is 2 m/s, 1 m^2, (m, rad), x [m], (1, 2, 3) m; metres; l1 m apart"
    assert name_lengths(text, "m") is text
    assert name_lengths(text, "mm") == (
        "0.5 mm, 'm' is 2 mm/s, 1 mm^2, (mm, rad), x [mm], (1, 2, 3) mm; millimetres; l1 mm apart"
    )
    assert (
        name_lengths("m = 2, m n 3  m = 4, from 1 m = 2", "in")
        == "m = 2, m n 3  m = 4, from 1 m = 2"
    )
    assert name_lengths(name_lengths(text, "mm"), "mm") == name_lengths(text, "mm")


def mask_numbers(text):
    """Return a text without its numbers and units."""
    text = re.sub('src="[^"]*"', "", text)
    text = text.replace("; lengths are metres, and these look like millimetres", "")
    text = re.sub(r"\bmm?\b|\b(?:milli)?metres\b", "U", NUMBER.sub("#", text))
    return " ".join(text.split())


@pytest.mark.parametrize("name", CASES)
def test_both_units_say_the_same(name):
    make, say = CASES[name]
    metres = [list_answer_texts(x) for x in say(make().build(), 1.0)]
    for texts in zip(metres, list_millimetre_texts(name), strict=True):
        first, second = (list(map(mask_numbers, x)) for x in texts)
        assert first == second


def list_picture_texts(ax):
    """List the texts of a picture: labels of axes, titles, dimensions, keys."""
    from matplotlib.text import Text

    return [t.get_text() for t in np.ravel(ax)[0].figure.findobj(Text)]


def test_pictures_name_the_unit():
    pytest.importorskip("matplotlib").use("Agg")
    system = convert_unit(make_slider_crank(), "mm").build()
    q = system.assemble({"crank": 0.5}, start={"stroke": 150.0}).q
    path = system.trace("crank", start=q)
    drawn = list_picture_texts(system.plot(q, dimensions=True, labels="all"))
    assert {"40 mm", "120 mm", "  20 mm"} <= set(drawn)
    assert {"x [mm]", "y [mm]"} <= set(list_picture_texts(path.plot()))
    curves = list_picture_texts(path.plot_curve())
    assert "angles [rad], slides [mm]" in curves
    arm = convert_unit(make_arm(), "mm").build()
    spatial = list_picture_texts(arm.plot(arm.mid))
    assert {"x [mm]", "y [mm]", "z [mm]"} <= set(spatial)
    cells = list_picture_texts(arm.workspace("tip", n=1000).plot())
    for texts in (drawn, curves, spatial, cells):
        assert not [text for text in texts if METRES.search(text)]


def test_a_file_is_read_in_a_unit(tmp_path):
    """In Python and on the command line: lengths go in and come out in it."""
    robot = kempe.load("ur5", unit="mm")
    X = kempe.load("ur5").fk([0.1] * 6, "tool")
    np.testing.assert_allclose(robot.fk([0.1] * 6, "tool")[:3, 3], 1e3 * X[:3, 3], rtol=1e-12)
    assert kempe.read("ur5", unit="in").unit == "in" and kempe.load("ur5").unit == "m"
    words = ("ik", "ur5", "--frame", "tool", "--unit", "mm", "--json")
    answer = Result(*words, "--task", "position", "--target", "400,200,300").json()
    reached = kempe.load("ur5").fk(list(answer["q"].values()), "tool")
    np.testing.assert_allclose(reached[:3, 3], [0.4, 0.2, 0.3], atol=1e-6)
    with pytest.raises(KempeError, match="unit is 'feet'"):
        kempe.load("ur5", unit="feet")
    kempe.read("ur5").save(tmp_path / "ur5.toml")
    assert Result("check", tmp_path / "ur5.toml", "--unit", "mm").code == 0


def test_screws_are_angles_in_any_unit():
    """Solutions of an arm with a slide and a screw on one axis do not depend on the unit."""
    metres, millimetres = make_arm().build(), convert_unit(make_arm(), "mm").build()
    for seed in range(2):
        X = metres.fk(metres.random(seed), "tip")
        Y = X.copy()
        Y[:3, 3] *= 1e3
        one, two = metres.ik_all(X, "tip"), millimetres.ik_all(Y, "tip")
        scaled = one.q * [1.0, 1.0, 1.0, 1e3, 1.0]
        np.testing.assert_allclose(two.q, scaled, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(
        millimetres.random(0, 5), metres.random(0, 5) * [1.0, 1.0, 1.0, 1e3, 1.0]
    )


@pytest.mark.parametrize("name", ["panda", "ur5"])
def test_steps_do_not_depend_on_the_unit(name):
    """Also where joints are singular or at their speed: 1 m counts as 1 rad in any unit."""
    metres, millimetres = kempe.load(name), kempe.load(name, unit="mm")
    tip = metres.frame_names[-1]
    rng = np.random.default_rng(0)
    for k in range(60):
        q = metres.random(k) if k % 4 else metres.neutral.copy()
        wanted = metres.fk(metres.random(k + 1000), tip) if k % 3 else 0.3 * rng.normal(size=6)
        scaled = wanted.copy()
        scaled[(slice(3), 3) if k % 3 else slice(3)] *= 1e3
        one = metres.ik_step(q, wanted, tip, 0.004, keep_direction=bool(k % 2))
        two = millimetres.ik_step(q, scaled, tip, 0.004, keep_direction=bool(k % 2))
        np.testing.assert_allclose(one.q, two.q, rtol=0, atol=1e-9)


# ---- shipped models in both units


def list_scales(system):
    """List by how much coordinates (nq,) of a system in metres grow in millimetres."""
    unit = list_units(system)
    return np.array([1e3 if unit[n] == "m" else 1.0 for n in system.coordinate_names])


def ask_model(system, metres, k):
    """Yield what verbs answer, with their numbers k times those of the same system in metres.

    With each answer comes whether its configuration is determined: searches choose one of several,
    and rounding can decide which.
    """
    rng = np.random.default_rng(len(metres.name))
    scale = list_scales(metres) if k != 1.0 else 1.0
    tip = metres.frame_names[-1]
    home = metres.assemble().q
    pose = metres.fk(home, tip)
    far = pose.copy()
    far[0, 3] += 7.0

    def convert(X):
        return X if k == 1.0 else in_millimetres(X)

    yield system.fk(home * scale, tip)[:3, 3] / k, True
    yield system.assemble(start=home * scale), True
    for _ in range(3):
        twist = rng.normal(size=6)
        if metres.dim == 2:
            twist[2:5] = 0.0
        yield system.ik_step(home * scale, np.r_[k * twist[:3], twist[3:]], tip, dt=0.01), True
    yield system.ik_step(home * scale, convert(pose), tip, dt=0.01), True
    budget = kempe.Budget(starts=20)
    yield system.ik(convert(pose), tip, start=home * scale, budget=budget), False
    yield system.ik(convert(far), tip, start=home * scale, budget=budget), False
    yield system.ik_path(convert(np.stack([pose, pose])), tip, start=home * scale), True
    yield system.ik_path(convert(np.stack([pose, far])), tip, start=home * scale), False
    yield system.mobility(home * scale).sentence, True
    yield system.task_space(tip).status, True
    with pytest.raises(InputError) as refused:
        system.ik(convert(pose), tip, tolerance=-1.0)
    yield str(refused.value), True


@pytest.mark.parametrize("name", list_models())
def test_shipped_models_answer_the_same_in_both_units(name):
    metres, millimetres = kempe.load(name), kempe.load(name, unit="mm")
    scale = list_scales(metres)
    both = zip(ask_model(metres, metres, 1.0), ask_model(millimetres, metres, 1e3), strict=True)
    for (one, fixed), (two, _) in both:
        if isinstance(one, np.ndarray):
            np.testing.assert_allclose(one, two, rtol=0, atol=1e-12)
            one = two = ""
        texts = [two] if isinstance(two, str) else [*list_texts(two)]
        wrong = [line for t in texts for line in t.split("\n")]
        assert not [t for t in wrong if METRES.search(re.sub('src="[^"]*"', "", t))]
        said = [str(x) if isinstance(x, str) else str(x.status) for x in (one, two)]
        assert mask_numbers(said[0]) == mask_numbers(said[1])
        if fixed and not isinstance(one, str):
            np.testing.assert_allclose(two.q, one.q * scale, rtol=1e-7, atol=1e-6)


def test_chains_of_slides_have_a_metre_as_their_length():
    """A body without lengths of its own moves by metres: 7 m are a jump of 7 lengths in any unit."""
    for name in ("joint_free", "joint_planar", "joint_translation", "slider"):
        for unit in ("m", "mm", "in"):
            system = kempe.load(name, unit=unit)
            metre = 1.0 / float(units.METRES[unit])
            assert compute_characteristic_length(system) == pytest.approx(metre)


def test_default_tolerances_are_lengths():
    """Of poses that are read, and of all solutions; what is refused names the unit."""
    system = kempe.load("puma560", unit="mm")
    poses = kempe.convert.to_maximal(system, system.mid)
    poses[2, :3, 3] += 5e-4
    assert np.abs(kempe.convert.from_maximal(system, poses) - system.mid).max() < 1e-9
    poses[2, :3, 3] += 5e-2
    with pytest.raises(InputError, match=r"by 0.0875 mm; at most 0.001 mm is read"):
        kempe.convert.from_maximal(system, poses)
    with pytest.raises(InputError, match="in millimetres and radians"):
        system.ik_all(system.fk(system.mid, "tool"), "tool", tolerance=0.0)
    found = system.ik_all(system.fk(system.mid, "tool"), "tool")
    assert found.problem.tolerance == pytest.approx(1e-6)
    assert found.problem.angular == pytest.approx(1e-9)


def test_shapes_of_arrays_in_messages_are_no_units():
    assert name_lengths("it must be (m, n), in (m, rad) or [m]", "mm") == (
        "it must be (m, n), in (mm, rad) or [mm]"
    )


def test_messages_of_ros_are_in_metres():
    """In any unit of the system: a message JointState has metres, as ROS has (REP 103)."""
    message = SimpleNamespace(name=["d3", "q1"], position=[0.5, 0.1], velocity=[])
    metres, millimetres = kempe.load("stanford"), kempe.load("stanford", unit="mm")
    for read in (kempe.System.q, kempe.convert.from_joint_state):
        one, two = read(metres, message), read(millimetres, message)
        np.testing.assert_allclose(two, one * list_scales(metres), rtol=1e-15)
    X, Y = metres.fk(message, "tool"), millimetres.fk(message, "tool")
    np.testing.assert_allclose(in_millimetres(X), Y, atol=1e-9)
    np.testing.assert_allclose(millimetres.fk([message], "tool")[0], Y)
    assert millimetres.q({"d3": 0.5})[2] == 0.5
