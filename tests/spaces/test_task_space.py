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
    assert ("no solution unless" in found.status) == (m > n) and ("redundant" in found.status) == (
        n > rank and m <= n
    )


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
    arm = kempe.load("two_link")
    bar = kempe.load("four_bar")
    with pytest.raises(UnknownNameError):
        arm.task_space("nowhere")
    with pytest.raises(InputError, match="task is 'size'"):
        arm.task_space("e", task="size")
    with pytest.raises(InputError, match="does not close the loops"):
        bar.task_space("coupler_point", np.full(4, 0.2))
    with pytest.raises(InputError, match="leave it out"):
        arm.task_space(tasks.Position("e", (0.1, 0.1)), task="pose")


@pytest.mark.parametrize("wrong", [[1, [2, 3]], ["tool"], (None,)])
def test_what_is_no_task_is_refused(wrong):
    with pytest.raises(InputError, match="is no task; see kempe.tasks"):
        kempe.load("bennett").task_space(wrong)


def arm(size: float, held: bool = False, offset: float = 0.0, at: float = 0.0) -> kempe.System:
    """A chain of three hinges in the plane of this size, far from the origin by `at`, whose wrist
    may be held.
    """
    m = kempe.Mechanism("arm", dim=2)
    last = m.ground
    place = (at, 0.3 * at)
    for k in range(3):
        m.revolute(f"j{k}", last, m.body(f"L{k}"), at=place)
        last = f"L{k}"
        place = (size, 0.2 * size)
    m.frame("end", last, at=(0.7 * size, offset * size))
    m.frame("hub", "L0", at=(offset * size, 0.0))
    if held:
        m.constrain(tasks.Position("end", [at + 1.2 * size, 0.3 * at + 0.9 * size]), "held")
    return m.build()


@pytest.mark.parametrize("size", [1e-3, 0.1, 1.0, 30.0, 1e3, 1e6])
@pytest.mark.parametrize("at", [0.0, 10.0])
def test_rounding_is_no_rank(size, at):
    """A point that is held does not move; one on an axis, at any place and of any size, neither."""
    still = arm(size, held=True, at=at * size).task_space(
        "end", task="position", budget=Budget(starts=16)
    )
    assert (still.n, still.rank, still.generic_rank) == (1, 0, 0), still.status
    turned = arm(size, held=True, at=at * size).task_space(
        "end", task="pose", budget=Budget(starts=16)
    )
    assert (turned.rank, turned.generic_rank) == (1, 1)
    free = arm(size, at=at * size)
    assert free.task_space("hub", task="position").generic_rank == 0
    assert free.task_space("hub", task="pose").generic_rank == 1
    assert free.task_space("end", task="pose").generic_rank == 3


@pytest.mark.parametrize("offset", [1e-9, 1e-6, 1e-3])
@pytest.mark.parametrize("size", [1e-3, 1.0, 1e6])
def test_a_frame_beside_its_axis_moves(size, offset):
    assert arm(size, offset=offset).task_space("hub", task="position").generic_rank == 1


def scaled(rng: np.random.Generator, f: float) -> tuple[kempe.System, int]:
    """A random chain in space of hinges and slides, its lengths times f, and the rank of its pose
    by numpy.
    """
    m = kempe.Mechanism("chain")
    last = "ground"
    drawn = []
    n = int(rng.integers(1, 7))
    for k in range(n):
        kind = "prismatic" if rng.random() < 0.3 else "revolute"
        at = rng.choice([0.0, 0.3, 0.5], 3)
        axis = rng.choice(["x", "y", "z"])
        m.joint(
            f"j{k}",
            kind,
            m.ground if k == 0 else last,
            m.body(f"b{k}"),
            at=tuple(f * at),
            axis=axis,
            limits=(-f, f) if kind == "prismatic" else None,
        )
        last = f"b{k}"
        drawn.append((kind, at, axis))
    return m.build(), n


def test_ranks_do_not_depend_on_the_unit_of_length(hunt):
    """The same chain in units of length from 1e-3 to 1e6: the same ranks, those of the columns by
    numpy at size 1.
    """
    rng = hunt.rng()
    for _ in range(hunt.cases(24)):
        seed = int(rng.integers(2**31))
        found = []
        for f in (1.0, 1e-3, 1e3, 1e6):
            system, n = scaled(np.random.default_rng(seed), f)
            space = [
                system.task_space(f"b{n - 1}", task=task, budget=Budget(starts=8))
                for task in ("pose", "position")
            ]
            found.append([(s.rank, s.generic_rank) for s in space])
            if f == 1.0:
                J = np.asarray(
                    system.jacobian(system.random(np.random.default_rng(1), 8), f"b{n - 1}")
                )
                ranks = [
                    max(np.linalg.matrix_rank(j, 1e-9) for j in part) for part in (J, J[:, :3])
                ]
                assert [s.generic_rank for s in space] == ranks
        assert all(x == found[0] for x in found), found


@pytest.mark.parametrize("name", ["sarrus", "scissor", "wunderlich", "bennett"])
def test_freedoms_are_the_least_of_all_configurations(name):
    """Singular configurations among those that were drawn have more; the least is what the linkage
    has: one.
    """
    system = kempe.load(name)
    assert system.task_space(system.body_names[-1]).n == 1


@pytest.mark.parametrize("size", [1e-3, 1.0, 1e3])
def test_a_small_body_that_floats_far_off_is_closed(size):
    """A free body pinned in one point: random starts are thousands of its lengths away where it is
    small.
    """
    m = kempe.Mechanism("pinned")
    body = m.body("body")
    m.free("F", m.ground, body)
    m.frame("pin", body, at=(size, 0, 0))
    m.constrain(kempe.constraints.Position("pin", (0, 0, size)))
    system = m.build()
    assert system.task_space("pin", task="position").generic_rank == 0
    assert system.task_space("body", task="position").generic_rank == 2
    assert system.configuration_space.dimension == 3
