"""Task spaces: dimensions against those that textbooks give, images against closed forms."""

from __future__ import annotations

import numpy as np
import pytest

import kempe
from kempe import Budget, tasks
from kempe.errors import InputError, UnknownNameError

# system, frame, what counts, m, n, generic rank
CASES = [
    ("two_link", "e", "position", 2, 2, 2),
    ("two_link", "e", "pose", 3, 2, 2),
    ("puma560", "tool", "pose", 6, 6, 6),
    ("iiwa14", "tool", "pose", 6, 7, 6),
    ("four_bar", "coupler_point", "position", 2, 1, 1),
    ("five_bar", "tip", "position", 2, 2, 2),
    ("stewart", "platform", "pose", 6, 6, 6),
]


@pytest.mark.parametrize(("name", "frame", "task", "m", "n", "rank"), CASES)
def test_dimensions(name, frame, task, m, n, rank):
    system = kempe.load(name)
    found = system.task_space(frame, task=task)
    assert (found.m, found.n, found.generic_rank) == (m, n, rank)
    assert (found.redundancy, found.dependent) == (n - rank, m - rank)
    assert "m = " in found.status and f"n = {n}" in found.status
    assert ("no solution unless" in found.status) == (m > n) and ("redundant" in found.status) == (n > rank and m <= n)


def test_the_rank_drops_where_the_arm_is_straight():
    arm = kempe.load("two_link")
    straight, bent = (arm.task_space("e", [0.3, x], task="position") for x in (0.0, 1.0))
    assert (straight.rank, bent.rank, straight.singular, bent.singular) == (1, 2, True, False)
    assert "singular" in straight.status


def test_the_image_lies_within_the_annulus_and_fills_it():
    arm = kempe.load("two_link")
    for found in (arm.task_space("e"), arm.task_space("e", budget=Budget(starts=1, rng=1))):
        for low, high in found.image.values():
            assert -0.9 <= low < -0.88 and 0.88 < high <= 0.9


def test_tasks_are_counted_together():
    arm = kempe.load("iiwa14")
    at = arm.fk(arm.mid, "tool")
    two = arm.task_space([tasks.Position("tool", at[:3, 3]), tasks.Orientation("tool", at[:3, :3])])
    assert (two.m, two.n, two.generic_rank) == (6, 7, 6) and not two.image


def test_wrong_calls():
    arm, bar = kempe.load("two_link"), kempe.load("four_bar")
    with pytest.raises(UnknownNameError):
        arm.task_space("nowhere")
    with pytest.raises(InputError, match="task is 'size'"):
        arm.task_space("e", task="size")
    with pytest.raises(InputError, match="not closed"):
        bar.task_space("coupler_point", np.full(4, 0.2))
    with pytest.raises(InputError, match="leave it out"):
        arm.task_space(tasks.Position("e", (0.1, 0.1)), task="pose")


@pytest.mark.parametrize("wrong", [[1, [2, 3]], ["tool"], (None,)])
def test_what_is_no_task_is_refused(wrong):
    with pytest.raises(InputError, match="is no task; see kempe.tasks"):
        kempe.load("bennett").task_space(wrong)
