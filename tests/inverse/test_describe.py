"""What is recognised in chains, and how many configurations are promised, against what is known of
these arms.
"""

from __future__ import annotations

import math
import sys
from pathlib import Path

import numpy as np
import pytest

import kempe
from kempe.errors import InputError, UnknownNameError, UnsupportedError
from kempe.inverse.describe import describe_plan

sys.path.insert(0, str(Path(__file__).parents[1]))
import arms

H = math.pi / 2

CLASSES = {
    # Lee and Ziegler (1984): eight postures of a Puma
    "puma560": ("closed form", 8),
    "irb6640": ("closed form", 8),
    "spherical_shoulder": ("closed form", 8),
    # Hawkins (2013), and many others: eight of a UR
    "ur5": ("closed form", 8),
    "ur10e": ("closed form", 8),
    "m1013": ("closed form", 8),
    # Stanford arm: Pieper (1968)
    "stanford": ("closed form", 8),
    "gantry6": ("closed form", 2),
    "cylindrical6": ("closed form", 4),
    "cobra600": ("closed form", 2),
    "scara_prrr": ("closed form", 2),
    "cartesian": ("closed form", 1),
    "planar2": ("closed form", 2),
    "planar3": ("closed form", 2),
    "youbot": ("closed form", 4),
    # three turns that place a point: four, Pieper (1968)
    "anthropomorphic3": ("closed form", 4),
    "orthogonal3_cuspidal": ("closed form", 4),
    "wrist3": ("closed form", 2),
    # six turns of any geometry: sixteen, Lee and Liang (1988); fewer with slides, Raghavan and Roth
    # (1993)
    "manseur_doty": ("elimination", 16),
    "jaco2": ("elimination", 16),
    "ur10e_1e-5": ("elimination", 16),
    "randomRPRRRR_1": ("elimination", 16),
    "randomRPRRPR_1": ("elimination", 8),
    "randomPRRPRP_2": ("elimination", 2),
}


def recognised(name: str):
    arm = arms.arms()[name]
    return describe_plan(arm.system, arm.frame, (arm.task, arm.axis), tuple(arm.held))


@pytest.mark.parametrize("name", CLASSES)
def test_method_and_largest_number(name):
    answer = recognised(name)
    assert (answer.method, answer.most) == CLASSES[name], answer


@pytest.mark.parametrize("name", arms.arms())
def test_no_more_solutions_are_known_than_promised(name):
    """Counts of the oracle, which knows nothing of structure."""
    counts = [n for _, n in arms.COUNTS.get(name, ())]
    answer = recognised(name)
    assert max(counts, default=1) <= answer.most <= 16
    assert answer.held == arms.arms()[name].held


def test_puma():
    answer = describe_plan(kempe.load("puma560"), "tool")
    assert answer.relations == (
        "the axes of q1 and q2 meet at right angles",
        "the axes of q2 and q3 are parallel, 0.4318 m apart",
        "the axes of q3 and q4 pass each other at right angles, 0.0203 m apart",
        "the axes of q4, q5 and q6 meet in one point, neighbours at right angles",
    )
    assert answer.steps == (
        (("q1",), "quadratic equation for the point that q4, q5 and q6 leave in place", 2),
        (("q3",), "quadratic equation", 2),
        (("q2",), "follows", 1),
        (("q4", "q5", "q6"), "orientation", 2),
    )


def test_three_parallel_axes():
    answer = describe_plan(kempe.load("ur5"), "tool")
    assert "the axes of shoulder_lift, elbow and wrist_1 are parallel" in answer.relations
    assert [step.values for step in answer.steps] == [2, 2, 1, 2]
    assert answer.steps[0].equation.endswith(
        "for the plane that shoulder_lift, elbow and wrist_1 move in itself"
    )


def chain(*joints, **options):
    m = kempe.Mechanism("chain")
    body = m.ground
    for k, (kind, place) in enumerate(joints):
        getattr(m, kind)(f"j{k + 1}", body, m.body(f"b{k + 1}"), **place)
        body = f"b{k + 1}"
    m.frame("tool", body, at=(0.1, 0.2, 0.3))
    return m.build()


TURN = {}
OVER = {"rpy": (H, 0.0, 0.0)}


@pytest.mark.parametrize(
    ("second", "said"),
    [
        ({"at": (0.3, 0, 0)}, "the axes of j1 and j2 are parallel, 0.3 m apart"),
        ({"at": (0, 0, 0.5)}, "the axes of j1 and j2 are one line"),
        ({"at": (0, 0, 0.5), "rpy": (H, 0, 0)}, "the axes of j1 and j2 meet at right angles"),
        ({"at": (0, 0, 0.5), "rpy": (H / 3, 0, 0)}, "the axes of j1 and j2 meet at 30 degrees"),
        (
            {"at": (0.2, 0, 0), "rpy": (H / 2, 0, 0)},
            "the axes of j1 and j2 pass each other at 45 degrees, 0.2 m apart",
        ),
        (
            {"at": (0.2, 0, 0), "rpy": (2.1e-4, 0, 0)},
            "the axes of j1 and j2 are 0.00021 rad from parallel: solved as what they are",
        ),
        (
            {"at": (0.001, 0, 0), "rpy": (H, 0, 0)},
            "the axes of j1 and j2 miss each other by 0.001 m, at right angles: solved as what "
            "they are",
        ),
    ],
)
def test_two_turns(second, said):
    system = chain(
        ("revolute", TURN),
        ("revolute", second),
        ("revolute", {"at": (0.4, 0.5, 0), "rpy": (0, 0.9, 0)}),
    )
    assert describe_plan(system, "tool", "position").relations[0] == said


def test_slides():
    system = chain(
        ("prismatic", {}),
        ("revolute", {}),
        ("revolute", {"at": (0.4, 0, 0)}),
        ("prismatic", {}),
        ("prismatic", {"rpy": (H, 0, 0)}),
    )
    assert describe_plan(system, "tool").relations == (
        "the axes of j2 and j3 are parallel, 0.4 m apart, and j1 and j4 slide along them",
        "j4 and j5 slide at right angles to each other",
    )


def test_a_wrist_that_misses():
    """Axes that meet in pairs, in points 0.3 mm apart, are no spherical wrist."""
    wrist = [
        ("revolute", {"at": (0.3, 0, 0), "rpy": (0, H, 0)}),
        ("revolute", OVER),
        ("revolute", {"at": (0, 0, 3e-4), "rpy": (-H, 0, 0)}),
    ]
    arm = [
        ("revolute", {}),
        ("revolute", {"at": (0, 0, 0.4), **OVER}),
        ("revolute", {"at": (0.4, 0.1, 0)}),
    ]
    answer = describe_plan(chain(*arm, *wrist), "tool")
    assert any(
        r.startswith("the axes of j4, j5 and j6 miss a common point by 0.0003 m")
        for r in answer.relations
    )
    assert answer.method == "elimination" and answer.most == 16
    wrist[2] = ("revolute", {"rpy": (-H, 0, 0)})
    answer = describe_plan(chain(*arm, *wrist), "tool")
    assert (
        "the axes of j4, j5 and j6 meet in one point, neighbours at right angles"
        in answer.relations
    )
    assert answer.method == "closed form" and answer.most == 8


def test_the_facts_do_not_depend_on_frames():
    """Origins along the axes, flipped axes and another base leave the axes where they are."""
    plain = [
        ("revolute", {}),
        ("revolute", {"at": (0, 0, 0.4), **OVER}),
        ("revolute", {"at": (0.4, 0.1, 0)}),
    ]
    base = ("fixed", {"at": (1, -2, 3), "rpy": (0.4, 0.5, 0.6)})
    shifted = [
        base,
        ("revolute", {"at": (0, 0, 0.7), "axis": (0, 0, -1)}),
        ("revolute", {"at": (0, 0, -0.3), **OVER}),
        ("revolute", {"at": (0.4, 0.1, 5.0)}),
    ]
    one, other = (describe_plan(chain(*joints), "tool", "position") for joints in (plain, shifted))
    assert [
        r.replace("j3", "j4").replace("j2", "j3").replace("j1", "j2") for r in one.relations
    ] == list(other.relations)


def test_redundant_and_short_chains():
    iiwa = kempe.load("iiwa14")
    assert describe_plan(iiwa, "tool").held == ("q5",)
    assert describe_plan(iiwa, "tool", fixed=["q3"]).steps[0] == (
        ("q3",),
        "held at given values",
        1,
    )
    assert describe_plan(iiwa, "tool", fixed={"q3": 0.1}).held == ("q3",)
    scara = describe_plan(kempe.load("cobra600"), "tool")
    assert scara.steps[-1].equation.startswith("2 equations left over")
    assert all(step.joints for step in describe_plan(iiwa, "tool", "position").steps)
    planar = kempe.load("two_link")
    assert describe_plan(planar, "e", "position").steps == (
        (("q1", "q2"), "motion within the plane", 2),
    )


def test_one_joint_and_two_joints():
    """A pose fixes one or two joints that do not move as one; a point in space two circles."""
    one = chain(("revolute", {}))
    two = chain(("revolute", {}), ("revolute", {"at": (0.4, 0, 0)}))
    assert [describe_plan(one, "tool", task).most for task in ("pose", "position")] == [1, 1]
    assert [describe_plan(two, "tool", task).most for task in ("pose", "position")] == [1, 2]
    assert describe_plan(one, "tool").relations == ("j1 is the only joint",)


def test_text_html_data():
    answer = describe_plan(kempe.load("puma560"), "tool", ("position_axis", (1, 0, 0)))
    text = str(answer)
    assert text.startswith(
        "inverse model of tool of puma560, task position_axis\n  joints     q1, q2"
    )
    assert max(map(len, text.splitlines())) <= 110
    flat = " ".join(text.split())
    assert all(" ".join(p.split()) in flat for p in (*map(str, answer.steps), *answer.relations))
    html = answer._repr_html_()
    assert html.count("<tr>") == html.count("</tr>") == 5 and "meet in one point" in html
    data = answer.data()
    assert (
        data["most"] == 8
        and data["joints"] == [f"q{k}" for k in range(1, 7)]
        and data["method"] == "closed form"
    )
    assert answer == describe_plan(kempe.load("puma560"), "tool", ("position_axis", (1, 0, 0)))


def test_what_is_refused():
    puma = kempe.load("puma560")
    with pytest.raises(InputError, match="task"):
        describe_plan(puma, "tool", "poses")
    with pytest.raises(UnknownNameError, match="q9"):
        describe_plan(puma, "tool", fixed=["q9"])
    with pytest.raises(UnknownNameError, match="tol"):
        describe_plan(puma, "tol")
    with pytest.raises(UnsupportedError, match="loop"):
        describe_plan(kempe.load("five_bar"), "tip")


def test_names_of_held_joints_only_count():
    assert describe_plan(
        kempe.load("panda"), "panda_hand_tcp", fixed=["panda_joint7"]
    ) == describe_plan(kempe.load("panda"), "panda_hand_tcp", fixed={"panda_joint7": np.pi})
