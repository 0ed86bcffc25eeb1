"""Public names: few on `System` and `Mechanism`, families in namespaces, former names with a warning."""

from __future__ import annotations

import inspect
import pickle
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import kempe
from kempe import Mechanism, System
from kempe.model.former_names import FORMER

MOST_OF_SYSTEM, MOST_OF_MECHANISM = 53, 36

EARLIER = """
    arm_angle assemble assembler assembly_modes body_names classify closed_form closure_error closures
    configuration_space constraints content_hash coordinate_names coordinates coordinates_of_joint couplings
    difference dim distance drive fk frame_name frame_names frames from_maximal idealised ik ik_all ik_path
    ik_plan ik_step ik_sweep independent integrate interpolate jacobian joint_names joints layout limits lock
    loop_jacobian lower manoeuvre maximal mechanical_advantage mechanism mid mobility name neutral notes nq nv
    parameters parent parent_joints plot posture posture_names q q_dict query random relations save
    self_motion simulate structure_hash subchain symbolic_fk table to_maximal tolerance topology trace
    transmission_angle upper velocity_limits velocity_names with_limits with_parameters
""".split()
"""What a system had before there were namespaces."""

BAR, ARM, DYADS = kempe.load("four_bar"), kempe.load("iiwa14"), kempe.load("two_link")
Q, TOOL, CLOSED = ARM.random(3), "tool", BAR.assemble({"A": 0.7}).q
X = ARM.fk(Q, TOOL)

CALLS: dict[str, tuple[System, Callable[[Any], Any], Callable[[System], Any]]] = {
    "integrate": (ARM, lambda f: f(Q, np.ones(7)), lambda s: s.configuration_space.integrate(Q, np.ones(7))),
    "difference": (ARM, lambda f: f(Q, Q + 0.1), lambda s: s.configuration_space.difference(Q, Q + 0.1)),
    "interpolate": (ARM, lambda f: f(Q, Q + 1, 0.5), lambda s: s.configuration_space.interpolate(Q, Q + 1, 0.5)),
    "distance": (ARM, lambda f: f(Q, Q + 0.1), lambda s: s.configuration_space.distance(Q, Q + 0.1)),
    "symbolic_fk": (DYADS, lambda f: f(DYADS.body_names[-1]), lambda s: s.symbolic.fk(s.body_names[-1])),
    "ik_plan": (ARM, lambda f: f(TOOL), lambda s: s.inverse.plan(TOOL)),
    "ik_sweep": (ARM, lambda f: f(X, TOOL, n=5).q, lambda s: s.inverse.sweep(X, TOOL, n=5).q),
    "self_motion": (ARM, lambda f: f(Q, TOOL).q, lambda s: s.inverse.self_motion(Q, TOOL).q),
    "arm_angle": (ARM, lambda f: f(Q, TOOL), lambda s: s.inverse.arm_angle(Q, TOOL)),
    "constraints": (BAR, lambda f: [c.names for c in f()], lambda s: [c.names for c in s.loops.constraints()]),
    "closure_error": (BAR, lambda f: f(BAR.neutral), lambda s: s.loops.closure_error(s.neutral)),
    "assembler": (BAR, lambda f: f(["A"])([0.5]).q, lambda s: s.loops.assembler(["A"])([0.5]).q),
    "closed_form": (BAR, lambda f: str(f(["A"])), lambda s: str(s.loops.closed_form(["A"]))),
    "loop_jacobian": (BAR, lambda f: f(CLOSED, ["A"], ["D"]).matrix,
                      lambda s: s.loops.jacobian(CLOSED, ["A"], ["D"]).matrix),
    "mechanical_advantage": (BAR, lambda f: f(CLOSED, "A", "D"),
                             lambda s: s.loops.mechanical_advantage(CLOSED, "A", "D")),
    "transmission_angle": (BAR, lambda f: f(CLOSED, "B"), lambda s: s.loops.transmission_angle(CLOSED, "B")),
    "posture": (BAR, lambda f: f("closed"), lambda s: s.q("closed")),
    "lock": (ARM, lambda f: f({ARM.coordinate_names[0]: 0.2}),
             lambda s: s.mechanism.lock({s.coordinate_names[0]: 0.2}).build()),
    "subchain": (ARM, lambda f: f(ARM.body_names[2], TOOL),
                 lambda s: s.mechanism.subchain(s.body_names[2], TOOL).build()),
    "maximal": (BAR, lambda s: s, kempe.convert.maximal),
    "to_maximal": (BAR, lambda f: f(CLOSED), lambda s: kempe.convert.to_maximal(s, CLOSED)),
    "from_maximal": (BAR, lambda f: f(BAR.fk(CLOSED)[1:]), lambda s: kempe.convert.from_maximal(s, s.fk(CLOSED)[1:])),
    "frame_name": (ARM, lambda f: f(TOOL), lambda s: s.structure.frame_name(TOOL)),
    "coordinates_of_joint": (BAR, lambda f: f("A"), lambda s: s.structure.coordinates_of_joint("A")),
    "structure_hash": (BAR, lambda x: x, lambda s: s.structure.hash),
}  # fmt: skip
"""System, how the former name is called, the same by the present name; other former names are those of `structure`."""


def listed(thing: object) -> set[str]:
    return {name for name in dir(thing) if not name.startswith("_")}


# ---- how many


@pytest.mark.parametrize("thing", [System, BAR, ARM], ids=["class", "closed", "open"])
def test_a_system_has_few_names(thing):
    assert len(listed(thing)) <= MOST_OF_SYSTEM


def test_a_mechanism_has_few_names():
    """Its tables (`joints`, `frames`, ...) are attributes of each mechanism besides."""
    assert len(listed(Mechanism)) <= MOST_OF_MECHANISM
    assert {name for name in vars(Mechanism("m")) if not name.startswith("_")} <= {
        "name", "dim", "bodies", "joints", "frames", "couplings", "constraints", "parameters", "postures", "locks",
        "notes", "roots", "tolerance",
    }  # fmt: skip


# ---- former names


def test_no_name_is_lost():
    assert set(EARLIER) == (listed(System) & set(EARLIER)) | set(FORMER) and not listed(System) & set(FORMER)
    assert not listed(BAR) & set(FORMER) and len(EARLIER) == 82


@pytest.mark.parametrize("name", [n for n in sorted(FORMER) if n != "save"])
def test_a_former_name_warns_and_is_the_same(name):
    own = lambda x: x, lambda s: getattr(s.structure, name)
    system, ask, present = CALLS.get(name, (BAR, *own))
    with pytest.warns(DeprecationWarning, match=f"system.{name} is the former name of ") as caught:
        thing = getattr(system, name)
    assert len(caught) == 1 and Path(caught[0].filename) == Path(__file__)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        before, after = ask(thing), present(system)
    assert type(before) is type(after)
    if isinstance(before, np.ndarray):
        np.testing.assert_array_equal(before, after)
    else:
        assert before == after


def test_save_writes_the_mechanism(tmp_path):
    with pytest.warns(DeprecationWarning, match=r"system.save is the former name of system.mechanism.save"):
        path = BAR.save(tmp_path / "bar.toml")
    assert path.read_text() == BAR.mechanism.save(tmp_path / "again.toml").read_text()


def test_what_is_no_name_is_no_attribute():
    with pytest.raises(AttributeError, match="no attribute 'closurs'"):
        BAR.closurs  # noqa: B018


# ---- namespaces


NAMESPACES = {
    "structure": {"closures", "joints", "limits", "frame_name", "hash"},
    "configuration_space": {"integrate", "difference", "interpolate", "distance", "dimension", "ambient"},
    "loops": {"assembler", "closed_form", "closure_error", "constraints", "jacobian", "transmission_angle"},
    "inverse": {"plan", "sweep", "self_motion", "arm_angle"},
    "reach": {"poses", "place", "capability", "planar"},
    "symbolic": {"fk"},
}


@pytest.mark.parametrize("name", NAMESPACES)
def test_namespaces_are_documented(name):
    thing = getattr(BAR, name)
    assert listed(thing) >= NAMESPACES[name]
    assert inspect.getdoc(getattr(System, name)) and inspect.getdoc(type(thing))
    for member in listed(type(thing)):
        assert inspect.getdoc(inspect.getattr_static(type(thing), member)), member


@pytest.mark.parametrize("name", ["structure", "loops", "inverse", "reach", "symbolic"])
def test_namespaces_say_what_they_are(name):
    said = repr(getattr(BAR, name))
    assert "'four_bar'" in said and said[0].isupper() and "\n" not in said
    if name != "structure":
        assert all(member in said for member in listed(getattr(BAR, name)) - {"system"})
    else:
        assert "loops closed by 'C'" in said and "relations" not in said


@pytest.mark.parametrize("name", NAMESPACES)
def test_namespaces_are_made_once_and_can_be_sent(name):
    assert getattr(BAR, name) is getattr(BAR, name)
    again = pickle.loads(pickle.dumps(getattr(BAR, name)))
    assert listed(again) == listed(getattr(BAR, name))
    assert pickle.loads(pickle.dumps(BAR)) == BAR


def test_a_posture_is_a_configuration_by_name():
    arm = kempe.load("puma560")
    name = arm.structure.posture_names[0]
    values = arm.mechanism.postures[name]
    assert all(arm.q_dict(arm.q(name))[n] == x for n, x in values.items())
    base = np.arange(6.0)
    m = Mechanism("m")
    m.revolute("a", m.ground, m.body("x"))
    m.revolute("b", "x", m.body("y"))
    m.posture("up", {"a": 1.0})
    np.testing.assert_array_equal(m.build().q("up"), [1.0, 0.0])
    np.testing.assert_array_equal(m.build().q("up", base[4:]), [1.0, 5.0])
    with pytest.raises(kempe.errors.UnknownNameError, match="no posture 'upp'; did you mean 'up'"):
        m.build().q("upp")
