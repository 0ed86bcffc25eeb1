"""What a report of mobility says can be read at once, and nothing of it contradicts the rest."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hunts import Hunt, some
from known_truths import dead_centres
from literature import look, trammel
from world_mechanisms import World

import kempe
from kempe.mobility import local_dimension
from kempe.mobility.mobility import mobility

LIBRARY = sorted(p.stem for p in (Path(kempe.__file__).parent / "library").glob("*.toml"))


# ---- what is not surely zero


def parallel_rods(rng: np.random.Generator, off: float) -> World:
    """A plate on three or four rods of one length and direction but for an error: rigid."""
    w = World("rods", 2)
    v = rng.normal(size=2)
    for k, p in enumerate(rng.normal(size=(int(rng.integers(3, 5)), 2))):
        w.turn("ground", f"rod{k}", p)
        w.turn(f"rod{k}", "plate", p + v + off * rng.normal(size=2))
    return w


def two_balls_of_hinges(rng: np.random.Generator, off: float) -> World:
    """Two balls of three hinges each that miss each other by an error: rigid."""
    w = World("hinges")
    bodies = ["ground", *"abcde", "ground"]
    for i, center in enumerate(np.repeat(rng.normal(size=(2, 3)), 3, axis=0)):
        w.turn(bodies[i], bodies[i + 1], center + off * rng.normal(size=3), rng.normal(size=3))
    return w


def check_doubt(hunt: Hunt, kind, cases: int) -> None:
    rng = hunt.rng()
    answers = set()
    for _ in range(hunt.cases(cases)):
        off = 10.0 ** rng.uniform(-10.5, -7)
        system = kind(rng, off).build()
        m = mobility(system, system.neutral)
        assert m.dof == 0 or ("probably" in m.sentence and not m.certain), (off, m.sentence)
        answers.add(m.dof)
    assert 1 in answers  # beyond what can be distinguished: the doubt is needed


@pytest.mark.slow
@pytest.mark.parametrize("kind", [parallel_rods, two_balls_of_hinges])
def test_a_singular_value_above_rounding_makes_the_answer_probable(kind, hunt):
    check_doubt(hunt, kind, 15)


@pytest.mark.slow
@pytest.mark.parametrize("kind", [parallel_rods, two_balls_of_hinges])
def test_a_singular_value_above_rounding_makes_many_answers_probable(kind, hunt):
    check_doubt(hunt, kind, 80)


# ---- count, rank and truth


@pytest.mark.parametrize(
    ("name", "said"),
    [
        (
            "shaky_3r",
            "0 degrees of freedom (Grübler count: 0); the rank says 1, a velocity that leads to no "
            "motion",
        ),
        (
            "pendulum_dead_centre",
            "1 degree of freedom (Grübler count: 1); the rank says 2, but 1 of these is a velocity "
            "that leads to no motion",
        ),
        ("bennett", "1 degree of freedom (Grübler count: -2; 3 redundant constraints)"),
        (
            "wunderlich",
            "2 degrees of freedom (Grübler count: 1; the largest of 13 branches found here has 2 "
            "dimensions)",
        ),
    ],
)
def test_the_sentence(name, said):
    assert mobility(kempe.load(name)).sentence == said


def test_velocities_without_a_motion_are_no_redundant_constraints_of_the_sentence():
    """Two dead centres in space: six of eight constraints are redundant because all moves in a
    plane.
    """
    w = World("side by side")
    for k in range(2):
        w.turn("ground", f"a{k}", (0, 3 * k, 0), (0, 0, 1))
        w.turn(f"a{k}", f"b{k}", (1, 3 * k, 0), (0, 0, 1))
        w.turn(f"b{k}", "ground", (2.5, 3 * k, 0), (0, 0, 1))
    system = w.build()
    m = mobility(system, system.neutral)
    assert (m.gruebler, m.dof, m.redundant) == (-6, 0, 8)
    assert m.sentence == (
        "0 degrees of freedom (Grübler count: -6; 8 redundant constraints, 2 of them to first order "
        "only); the rank says 2, but all of these are velocities that lead to no motion"
    )


@pytest.mark.parametrize("name", some(LIBRARY, 3))
def test_the_numbers_of_a_sentence_add_up(name):
    """The count and the redundant constraints are the rank's; less velocities without a motion they
    are the truth.
    """
    m = mobility(kempe.load(name))
    false = max(m.generic_rank_dof - m.dof, 0)
    assert m.gruebler + m.redundant == m.generic_rank_dof
    assert m.sentence.removeprefix("probably ").startswith(f"{m.dof} degree")
    assert f"(Grübler count: {m.gruebler}" in m.sentence
    assert ("redundant" in m.sentence) == (m.redundant > false)
    assert ("no motion" in m.sentence) == (false > 0)
    assert ("probably" in m.sentence or "to order" in m.sentence) == (not m.certain)


def test_a_proven_number_ends_in_no_doubt(monkeypatch):
    """What is not known of branches is said of them."""
    monkeypatch.setattr(local_dimension, "MOST_STARTS", 32)
    m = mobility(kempe.load("wunderlich"))
    assert m.certain and m.data()["how"].endswith("dimensions") and not m.local.doubts
    assert m.local.more and m.kind.endswith("so there may be more branches")


def test_one_is_not_written_as_many():
    assert "1 coordinate, no equations: 1 freedom\n" in str(mobility(kempe.load("joint_revolute")))


def test_dead_centres_that_hide_their_order_are_known_to_an_order():
    system = dead_centres(np.random.default_rng(0), 5)[0].build()
    assert "to order 8" in mobility(system, system.neutral).sentence


def test_counts_are_sentences():
    m = kempe.load("four_bar").mechanism
    m.lock({"A": m.postures["closed"]["A"]})
    assert "1 locked coordinate takes away one" in mobility(m.build()).counting.steps[-1]
    assert "5 on-line constraints x 1" in look(trammel(5)).counting.steps[1]


def test_control_says_that_it_counts_to_first_order():
    """The slider is not driven by the pendulum, but the dead centre keeps it: P alone is what truly
    moves.
    """
    report = mobility(kempe.load("pendulum_dead_centre"), actuated=["P"])
    assert (report.control.controlled, report.control.useful) == (1, 2)
    assert "counted to first order, where the rank sees 2 freedoms; truly there is 1" in str(report)


@pytest.mark.parametrize(("wheels", "words"), [(1, "how 'w0' bends"), (2, "how 'w0', 'w1' bend")])
def test_what_bends_is_said_of_one_and_of_several(wheels, words):
    m = kempe.Mechanism("axle")
    m.free("J", m.ground, m.body("axle"))
    for k in range(wheels):
        m.revolute(f"spin{k}", "axle", m.body(f"wheel{k}"), at=(0, 0.5 * k, 0), axis="y")
        m.rolls(f"w{k}", f"wheel{k}", radius=0.2, shape="disc")
    assert words in str(m.build().mobility()) and f"{words}s" not in str(m.build().mobility())


def test_mobility_says_where_it_is_folded():
    """A scissor of two stages flat on the ground has a freedom more than one that is raised."""
    m = kempe.Mechanism("scissor", dim=2)
    m.revolute("O", m.ground, m.body("u0"), child_at=(-1, 0))
    m.prismatic("S", m.ground, m.body("shoe"), axis="x")
    m.revolute("toe", "shoe", m.body("v0"), child_at=(-1, 0))
    m.revolute("X0", "u0", "v0")
    m.revolute("X1", m.body("u1"), m.body("v1"))
    m.revolute("r0", "u0", "v1", at=(1, 0), child_at=(-1, 0))
    m.revolute("l0", "v0", "u1", at=(1, 0), child_at=(-1, 0))
    system = m.build()
    folded = system.mobility()
    raised = system.mobility(system.assemble({"S": 1.2}).q)
    assert folded.dof > raised.dof == 1
    assert "folded here, where r0 and l0 coincide: ask at another position" in folded.sentence
    assert "folded" not in raised.sentence
