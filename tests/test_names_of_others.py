"""Members and options by the names of other libraries, or mistyped: the message says what is meant."""

from __future__ import annotations

import copy
import pickle
import re

import pytest

import kempe
from kempe.errors import (
    MEMBERS_ELSEWHERE,
    MEMBERS_WITHIN,
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


@pytest.mark.parametrize("name", OPTIONS_ELSEWHERE)
def test_options_of_other_libraries(name):
    meant = OPTIONS_ELSEWHERE[name].partition("=")[0]
    with pytest.raises(
        CallError, match=rf"ik has no option '{name}'; (did you mean '|give ){meant}"
    ):
        ARM.ik([0.5, 0.2, 0.1], "tool", **{name: 1})
