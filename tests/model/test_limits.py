"""What a system says of itself cannot be written to, and `with_limits` is how its limits are
changed.
"""

from __future__ import annotations

import contextlib
import copy
import inspect
import pickle
from collections.abc import Iterator, Mapping
from functools import cached_property
from typing import Any

import numpy as np
import pytest

import kempe
from kempe import Mechanism
from kempe.errors import InputError, KempeError, UnknownNameError
from kempe.model.model import Structure

MODELS = (
    "panda",
    "four_bar",
    "stewart",
    "two_link_pose",
    "seven_bodies_loop",
    "joint_cylindrical",
    "rssr",
)


def properties(kind: type) -> list[str]:
    """Public properties of a class and its bases."""
    return [
        n
        for n, x in inspect.getmembers(kind)
        if isinstance(x, (property, cached_property)) and n[0] != "_"
    ]


def answers(system: kempe.System) -> list[object]:
    """An answer of each kind that a system gives without much work."""
    q = system.assemble().q
    tip = system.frame_names[-1]
    out = [
        system,
        system.structure,
        system.configuration_space,
        system.assemble(),
        system.mobility(),
        system.mechanism,
    ]
    if not system.structure.closures:
        X = system.fk(q, tip)
        out += [
            system.ik(X, tip),
            system.ik_path(np.stack([X, X]), tip),
            system.ik_step(q, np.zeros(6), tip, 0.01),
        ]
    if system.structure.closures and system.dim == 2:
        out += [
            system.trace(),
            system.assembly_modes({system.coordinate_names[0]: q[0]}),
            system.independent(),
        ]
    return out


def mechanism() -> Mechanism:
    """A finger with a mimic joint, a geared screw, a ball and a slide without limits."""
    m = Mechanism("hand")
    m.revolute("a", m.ground, m.body("A"), limits=(-1.0, 2.0), velocity=3.0)
    m.revolute("b", "A", m.body("B"), limits=(-1.5, 1.5))
    m.couple("b", {"a": -0.5}, 0.1)
    m.prismatic("s", "B", m.body("C"))
    m.spherical("ball", "C", m.body("D"))
    m.cylindrical("c", "D", m.body("E"), limits={"z": (0.0, 1.0)})
    m.revolute("e", "E", m.body("F"), limits=(0.0, 1.0))
    m.lock({"e": 0.5})
    m.posture("up", {"a": 0.5})
    return m


def had(thing: Any) -> Iterator[tuple[str, Any]]:
    """What a system or an answer has: properties that raise, such as those of what was not found,
    are left out.
    """
    for name in properties(type(thing)):
        with contextlib.suppress(KempeError):
            yield name, getattr(thing, name)


@pytest.mark.parametrize("model", ["two_link", "four_bar", "panda", "slider_crank"])
def test_writing_changes_something_or_is_refused(model):
    """Over all properties of systems and answers: no array or dict is a copy that swallows what is
    written.
    """
    looked = 0
    for thing in answers(kempe.load(model)):
        for name, x in had(thing):
            if isinstance(x, np.ndarray) and x.size and x.dtype.kind == "f":
                looked += 1
                if x.flags.writeable:
                    x.flat[0] = 12.5
                    assert np.ravel(getattr(thing, name))[0] == 12.5, (
                        f"{type(thing).__name__}.{name}"
                    )
                else:
                    with pytest.raises(ValueError, match="read-only"):
                        x[0] = 1.0
            if isinstance(x, dict) and x and isinstance(thing, Structure):
                looked += 1
                key = next(iter(x))
                for write in (
                    lambda x=x, key=key: x.__setitem__(key, 1.0),
                    x.clear,
                    x.popitem,
                    lambda x=x: x.update(a=1),
                    lambda x=x, key=key: x.pop(key),
                ):
                    with pytest.raises(TypeError, match="with_limits"):
                        write()
                assert getattr(thing, name) == {**x} and pickle.loads(
                    pickle.dumps(x)
                ) == x == copy.deepcopy(x)
    assert looked >= 8


def test_copies_can_be_written():
    system = kempe.load("panda")
    copies = (
        system.mid.copy(),
        system.neutral.copy(),
        system.structure.limits.copy(),
        system.q("ready"),
    )
    for array in (*copies, system.random(0), system.q({})):
        array[0] = 0.5
    joints = {**system.structure.joints}
    joints.clear()
    assert isinstance(system.structure.joints, Mapping) and system.structure.joints


# ---- other limits


@pytest.mark.parametrize("model", MODELS)
def test_limits_are_changed_and_nothing_else(model, hunt):
    system = kempe.load(model)
    rng = hunt.rng()
    names = [system.structure.velocity_names[i] for i in system.structure.layout.vector_v]
    for _ in range(hunt.cases(10)):
        some = rng.choice(names, size=int(rng.integers(1, len(names) + 1)), replace=False).tolist()
        ends = np.sort(rng.normal(size=(len(some), 2)), axis=1)
        requested = {
            n: [None, (a, b), (None, b), (a, None), [a, np.inf], np.array([a, b])][rng.integers(6)]
            for n, (a, b) in zip(some, ends, strict=True)
        }
        speeds = {n: [None, 0.0, 2.5][rng.integers(3)] for n in some[: len(some) // 2]}
        made = system.with_limits(requested, velocity=speeds)
        lower = system.lower.copy()
        upper = system.upper.copy()
        fast = system.structure.velocity_limits.copy()
        for n, pair in requested.items():
            i = system.structure.velocity_names.index(n)
            low, high = (None, None) if pair is None else pair
            lower[i] = -np.inf if low is None else low
            upper[i] = np.inf if high is None else high
        for n, speed in speeds.items():
            fast[system.structure.velocity_names.index(n)] = np.inf if speed is None else speed
        assert np.array_equal(made.lower, lower) and np.array_equal(made.upper, upper)
        assert np.array_equal(made.structure.velocity_limits, fast) and np.array_equal(
            made.structure.limits.T, [lower, upper]
        )
        assert (
            made.coordinate_names == system.coordinate_names
            and made.structure.closures == system.structure.closures
        )
        assert (
            made.parent == system.parent
            and made.structure.posture_names == system.structure.posture_names
        )
        assert (
            made.structure.hash == system.structure.hash
            and made.structure.parameters == system.structure.parameters
        )
        q = system.random(rng)
        assert np.array_equal(made.fk(q), system.fk(q)), (
            "where things are does not depend on limits"
        )
        assert np.array_equal(made.loops.closure_error(q), system.loops.closure_error(q))
        mid = made.mid[made.structure.layout.vector_q]
        assert np.all(
            (mid >= lower[made.structure.layout.vector_v])
            & (mid <= upper[made.structure.layout.vector_v])
        )
        back = made.with_limits(system.structure.limits, system.structure.velocity_limits)
        assert np.array_equal(back.structure.limits, system.structure.limits)
        assert np.array_equal(back.structure.velocity_limits, system.structure.velocity_limits)
        assert pickle.loads(pickle.dumps(made)) == made


def test_it_is_what_the_mechanism_would_give():
    """The same limits, given when the mechanism is described and afterwards, make equal answers."""

    def arm(limits):
        m = Mechanism("arm", dim=2)
        m.revolute("q1", m.ground, m.body("upper"), limits=limits)
        m.revolute("q2", "upper", m.body("lower"), at=(1.0, 0.0), limits=(-2.0, 2.0))
        m.frame("tip", "lower", at=(1.0, 0.0))
        return m.build()

    reported = arm((-0.4, 0.4))
    made = arm(None).with_limits({"q1": (-0.4, 0.4)})
    assert reported == made and reported.structure.content_hash == made.structure.content_hash
    targets = np.random.default_rng(1).uniform(-1.5, 1.5, (50, 2))
    a, b = (s.ik(targets, "tip") for s in (reported, made))
    assert np.array_equal(a.q, b.q) and np.array_equal(a.success, b.success) and not a.success.all()
    assert np.all(np.abs(b.q[:, 0]) <= 0.4)


def test_arrays_and_tables_of_limits():
    system = kempe.load("panda")
    limits = system.structure.limits.copy()
    limits[0] = -0.1, 0.1
    assert np.array_equal(system.with_limits(limits).structure.limits, limits)
    assert system.with_limits(velocity=0.5).structure.velocity_limits.tolist() == [0.5] * 7
    assert system.with_limits() == system
    many = {n: (-1.0, 1.0) for n in system.structure.velocity_names}
    assert system.with_limits(many).structure.limits.tolist() == [[-1.0, 1.0]] * 7


def test_the_solvers_hold_other_limits():
    robot = kempe.load("panda")
    hand = robot.frame_names[-1]
    first = robot.coordinate_names[0]
    narrow = robot.with_limits({first: (0.3, 0.4)}, velocity={first: 0.01})
    a = narrow.ik(robot.fk(robot.random(1, 50), hand), hand)
    assert np.all((a.q[:, 0] >= 0.3) & (a.q[:, 0] <= 0.4))
    step = narrow.ik_step(narrow.mid, np.full(6, 0.5), hand, 0.001)
    assert abs(step.velocity[0]) <= 0.01 + 1e-15
    crank = kempe.load("four_bar").with_limits({"A": (0.1, 0.9)})
    assert (
        not crank.trace("A").closed
        and not crank.assemble({"A": 2.0})
        and crank.assemble({"A": 0.5})
    )


def test_coordinates_that_move_together():
    system = mechanism().build()
    i = system.structure.velocity_names.index("a")
    assert system.structure.limits[i].tolist() == [-1.0, 2.0], (
        "b = 0.1 - a / 2 in [-1.5, 1.5] leaves a in [-2.8, 3.2]"
    )
    with pytest.raises(
        InputError, match=r"'a' cannot have the limits \[-1, 10\]: .* \[-1, 3.2\]; give .* 'b', too"
    ):
        system.with_limits({"a": (-1.0, 10.0)})
    made = system.with_limits({"a": (-1.0, 10.0), "b": None})
    assert made.structure.limits[i].tolist() == [-1.0, 10.0]
    assert system.with_limits({"b": (-0.4, 0.3)}).structure.limits[i] == pytest.approx([-0.4, 1.0])
    with pytest.raises(InputError, match="'b' cannot have the limits"):
        system.with_limits({"b": (-5.0, 5.0)})
    assert system.with_limits(velocity={"b": 1.0}).structure.velocity_limits[i] == 2.0
    with pytest.raises(
        InputError, match="'b' cannot have the speed 2: .* leaves 1.5; give that of 'a', too"
    ):
        system.with_limits(velocity={"b": 2.0})
    assert (
        system.with_limits({"c.z": (0.2, 0.3)}).lower[system.structure.velocity_names.index("c.z")]
        == 0.2
    )
    assert system.with_limits({"a": (0.0, 1.0)}).q("up")[0] == 0.5


@pytest.mark.parametrize(
    ("limits", "velocity", "error", "words"),
    [
        ({"nope": (0, 1)}, None, UnknownNameError, "no coordinate 'nope'"),
        ({"e": (0, 1)}, None, InputError, "'e' is held at 0.5"),
        ({"ball.wx": (0, 1)}, None, KempeError, "wx"),
        ({"a": (2.0, 1.0)}, None, KempeError, "above upper"),
        ({"a": (0.0, np.nan)}, None, KempeError, "must be numbers"),
        ({"a": ("0", "1")}, None, KempeError, "a pair"),
        ({"a": 1.0}, None, KempeError, "a pair"),
        ({"a": (0, 1, 2)}, None, KempeError, "a pair"),
        ({"a": (True, 2)}, None, KempeError, "a pair"),
        ([1.0], None, InputError, r"shape \(1,\)"),
        (None, {"a": -1.0}, KempeError, "not negative"),
        (None, "fast", InputError, "velocity is 'fast'"),
        (None, {"a": "1"}, KempeError, "velocity"),
        (np.zeros((3, 2)), None, InputError, "shape"),
        ({"a": (np.inf, np.inf)}, None, KempeError, "must be numbers"),
    ],
)
def test_limits_that_are_none_are_refused(limits, velocity, error, words):
    with pytest.raises(error, match=words):
        mechanism().build().with_limits(limits, velocity)


LEGGED = (
    "stewart",
    "stewart_sps",
    "stewart_dietmaier",
    "three_rpr",
    "three_rps",
    "three_upu",
    "three_upu_snu",
)


@pytest.mark.parametrize("model", LEGGED)
def test_legs_are_not_shorter_than_nothing(model, hunt):
    """The legs of the library's platforms: no search gives one a negative length, and none can be
    requested.
    """
    system = kempe.load(model)
    legs = [
        n for n, joint in system.structure.joints.items() if joint.type.type_name == "prismatic"
    ]
    at = [system.coordinate_names.index(n) for n in legs]
    rng = hunt.rng()
    home = system.q("closed")
    starts = np.stack(
        [
            system.configuration_space.integrate(home, rng.normal(size=system.nv))
            for _ in range(hunt.cases(60))
        ]
    )
    answer = system.assemble(start=starts)
    assert len(legs) in (3, 6) and answer.success.all() and np.all(answer.q[:, at] >= 0.0)
    assert not system.assemble({legs[0]: -0.4})
    with pytest.raises(InputError, match=legs[0]):
        system.fk({legs[0]: -0.4})
