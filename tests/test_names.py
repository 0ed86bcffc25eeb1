"""Public names: few on `System` and `Mechanism`, families in namespaces."""

from __future__ import annotations

import difflib
import inspect
import pickle

import numpy as np
import pytest

import kempe
from kempe import Mechanism, System
from kempe.errors import hint

MOST_OF_SYSTEM = 57
MOST_OF_MECHANISM = 40

BAR = kempe.load("four_bar")
ARM = kempe.load("iiwa14")


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
        "name",
        "dim",
        "unit",
        "bodies",
        "joints",
        "frames",
        "couplings",
        "constraints",
        "parameters",
        "postures",
        "groups",
        "ignored_pairs",
        "locks",
        "notes",
        "roots",
        "tolerance",
    }


def test_what_is_no_name_is_no_attribute():
    with pytest.raises(AttributeError, match="has no 'closurs'"):
        BAR.closurs  # noqa: B018


# ---- namespaces


NAMESPACES = {
    "structure": {"closures", "joints", "limits", "frame_name", "hash"},
    "configuration_space": {
        "integrate",
        "difference",
        "interpolate",
        "distance",
        "dimension",
        "ambient",
    },
    "loops": {
        "assembler",
        "closed_form",
        "closure_error",
        "constraints",
        "jacobian",
        "transmission_angle",
    },
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


def test_the_package_lists_its_public_names():
    """Those that are loaded when they are first used, too, and no imports of its own."""
    assert [name for name in dir(kempe) if not name.startswith("_")] == sorted(kempe.__all__)


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


def test_of_very_many_names_the_nearest_is_found_among_the_like(monkeypatch):
    """Letters of some hundred names are compared, not of all: 50 000 took 4 seconds for each wrong
    name.
    """
    names = [f"link_number_{i}" for i in range(30_000)]
    own = difflib.get_close_matches
    compared = list[int]()
    monkeypatch.setattr(
        difflib,
        "get_close_matches",
        lambda given, all, **how: (compared.append(len(all)), own(given, all, **how))[1],
    )
    for given, right in (
        ("link_nimber_29999", "link_number_29999"),
        ("lnk_number_1234", "link_number_1234"),
    ):
        assert f"did you mean {right!r}" in hint(given, names)
    assert max(compared) <= 500
