"""Targets that were rounded, for chains of few joints: the tolerance that is named accepts them."""

from __future__ import annotations

import re

import numpy as np
import pytest

import kempe


def arm(rng: np.random.Generator, joints: int) -> kempe.System:
    """A chain of few joints with links of about half a metre."""
    rows = [
        (
            *rng.uniform(0.2, 0.8, 1),
            float(rng.choice([0, 1.5707963, -1.5707963, 0.4])),
            rng.uniform(-0.3, 0.3),
            0.0,
        )
        for _ in range(joints)
    ]
    return kempe.from_dh(rows).build()


def advice(sentence: str) -> tuple[float, float]:
    """The tolerance that a sentence names."""
    found = re.search(
        r"a target that was rounded needs a larger tolerance: tolerance=\(([^,]+), ([^)]+)\) "
        r"accepts it",
        sentence,
    )
    assert found, sentence
    return float(found[1]), float(found[2])


def hunted(rng: np.random.Generator, count: int) -> int:
    """How many rounded targets were not reached; the tolerance named for each is enough, and not a
    tenth of it.
    """
    missed = 0
    for _ in range(count):
        s = arm(rng, int(rng.integers(2, 6)))
        q = rng.uniform(-1.5, 1.5, s.nq)
        X = s.fk(q, "tool")
        X[:3, 3] = X[:3, 3].round(4)
        a = s.ik(X, "tool", start=q)
        if a.success:
            continue
        missed += 1
        tolerance = advice(a.status)
        again = s.ik(X, "tool", start=q, tolerance=tolerance)
        E = np.linalg.inv(s.fk(again.q, "tool")) @ X
        turned = np.arccos(np.clip((np.trace(E[:3, :3]) - 1) / 2, -1, 1))
        assert (
            again.success
            and np.linalg.norm(E[:3, 3]) <= tolerance[0]
            and turned <= tolerance[1] + 1e-7
        )
        errors = np.maximum([a.position_error, a.orientation_error], 1e-6)
        assert np.all(np.array(tolerance) <= 2.1 * errors)
    return missed


def test_the_tolerance_that_is_named_accepts_the_target(hunt):
    assert hunted(hunt.rng(), cases := hunt.cases(25)) > cases // 5


@pytest.mark.slow
def test_the_tolerance_that_is_named_accepts_many_targets(hunt):
    assert hunted(hunt.rng(), cases := hunt.cases(500)) > cases // 5


def test_far_targets_are_not_called_rounded():
    s = kempe.from_dh([(0.4, 1.5707963, 0.1, 0), (0.3, 0, 0, 0), (0.3, 0, 0, 0)]).build()
    X = s.fk([0.3, 0.4, 0.5], "tool")
    X[:3, 3] += 0.02
    assert "rounded" not in s.ik(X, "tool").status


def rounded() -> tuple[kempe.System, np.ndarray]:
    """An arm and a pose that it reaches, rounded to a tenth of a millimetre."""
    s = kempe.from_dh([(0.4, 1.5707963, 0.1, 0), (0.3, 0, 0, 0), (0.3, 0, 0, 0)]).build()
    X = s.fk([0.3, 0.4, 0.5], "tool")
    X[:3, 3] = X[:3, 3].round(4)
    return s, X


def test_tasks_name_a_tolerance_that_accepts_it():
    s, X = rounded()
    wanted = [kempe.tasks.Pose("tool", X)]
    assert s.ik(wanted, tolerance=advice(s.ik(wanted).status)).success


def test_ik_all_names_a_tolerance_that_accepts_it():
    s, X = rounded()
    found = re.search(
        r"needs a larger tolerance: tolerance=(\S+) accepts it", s.ik_all(X, "tool").status
    )
    assert found and s.ik_all(X, "tool", tolerance=float(found[1]))
