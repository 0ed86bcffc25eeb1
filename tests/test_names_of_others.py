"""Members and options by the names of other libraries, or mistyped: the message says what is meant."""

from __future__ import annotations

import copy
import pickle
import re

import pytest

import kempe
from kempe.errors import (
    DECLARATIONS_ELSEWHERE,
    MEMBERS_ELSEWHERE,
    MEMBERS_WITHIN,
    NAMES_ELSEWHERE,
    OPTIONS_ELSEWHERE,
    CallError,
    KempeError,
    MissingMemberError,
)

ARM = kempe.load("puma560")


def test_every_member_that_is_meant_exists():
    for name, meant in MEMBERS_ELSEWHERE.items():
        assert not hasattr(kempe.System, name)
        assert hasattr(kempe.System, meant)


@pytest.mark.parametrize("name", MEMBERS_ELSEWHERE)
def test_members_of_other_libraries(name):
    with pytest.raises(MissingMemberError, match=f"did you mean '{MEMBERS_ELSEWHERE[name]}'"):
        getattr(ARM, name)
    assert not hasattr(ARM, name)


@pytest.mark.parametrize("name", MEMBERS_WITHIN)
def test_members_of_parts_and_answers(name):
    meant = re.escape(MEMBERS_WITHIN[name])
    with pytest.raises(MissingMemberError, match=f"has no '{name}'; did you mean '{meant}'"):
        getattr(ARM, name)
    assert ARM.mechanism.lock({"q3": 0.5}).build().nq == 5
    assert ARM.reach.poses(ARM.fk(ARM.mid, "tool")[None], "tool").manipulability.shape == (1,)


@pytest.mark.parametrize("name", ["fk", "ik", "plot", "mobility", "trace", "fkine"])
def test_a_mechanism_has_to_be_built_first(name):
    meant = MEMBERS_ELSEWHERE.get(name, name)
    with pytest.raises(MissingMemberError, match=rf"call build\(\) first; {meant} is a member"):
        getattr(ARM.mechanism, name)


def test_mistyped_and_unknown_members():
    with pytest.raises(MissingMemberError, match="did you mean 'revolute'"):
        _ = ARM.mechanism.revolut
    with pytest.raises(MissingMemberError, match="'gravity'; there are: 'animate'"):
        _ = ARM.gravity
    with pytest.raises(AttributeError, match="has no '_private'"):
        _ = ARM._private


def test_errors_of_members_and_systems_can_be_copied():
    error = pytest.raises(MissingMemberError, getattr, ARM, "fkine").value
    assert isinstance(error, KempeError)
    assert str(pickle.loads(pickle.dumps(error))) == str(error)
    assert pickle.loads(pickle.dumps(ARM)) == copy.copy(ARM) == copy.deepcopy(ARM) == ARM


def test_the_error_of_a_property_is_its_own():
    class Broken(kempe.System):
        @property
        def weight(self):
            return ARM.missing_inside

    broken = Broken(ARM.mechanism)
    with pytest.raises(MissingMemberError, match="missing_inside"):
        _ = broken.weight


@pytest.mark.parametrize("name", DECLARATIONS_ELSEWHERE)
def test_declarations_of_other_libraries(name):
    with pytest.raises(MissingMemberError, match=f"did you mean '{DECLARATIONS_ELSEWHERE[name]}'"):
        getattr(ARM.mechanism, name)
    assert hasattr(kempe.Mechanism, DECLARATIONS_ELSEWHERE[name])


@pytest.mark.parametrize("name", NAMES_ELSEWHERE)
def test_names_of_modules_of_other_libraries(name):
    module = kempe if hasattr(kempe, NAMES_ELSEWHERE[name]) else kempe.spatial
    with pytest.raises(AttributeError, match=f"did you mean '{NAMES_ELSEWHERE[name]}'"):
        getattr(module, name)


@pytest.mark.parametrize("module", [kempe, kempe.constraints, kempe.tasks, kempe.spatial])
def test_mistyped_names_of_modules(module):
    for name in (
        module.__dir__()
        if module is kempe
        else module.__all__
        if hasattr(module, "__all__")
        else ("rot_x",)
    ):
        if name[0] != "_" and len(name) > 4:
            with pytest.raises(AttributeError, match=f"did you mean .*'{name}'"):
                getattr(module, name[:-1] + "q" + name[-1:])
    with pytest.raises(AttributeError, match="there are: '"):
        _ = module.zzzzzz
    assert not hasattr(module, "_private")


@pytest.mark.parametrize("name", OPTIONS_ELSEWHERE)
def test_options_of_other_libraries(name):
    meant = OPTIONS_ELSEWHERE[name].partition("=")[0]
    verb = "frame" if meant == "at" else "ik"
    with pytest.raises(
        CallError, match=rf"{verb} has no option '{name}'; (did you mean '|give ){meant}"
    ):
        if verb == "ik":
            ARM.ik([0.5, 0.2, 0.1], "tool", **{name: 1})
        ARM.mechanism.frame("f", "link1", **{name: (0, 0, 0)})
