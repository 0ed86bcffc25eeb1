"""Names of branches: against published solutions and plain geometry, and in hunts over random arms."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

import kempe
from kempe import spatial
from kempe.errors import InputError, UnknownNameError
from kempe.inverse.closed_forms.branch_names import NEITHER, SEVEN, SLIDING, SPATIAL, name_branches

WORDS = [word for choice in SPATIAL for word in choice[:2]]
LINKS = [f"link{k}" for k in range(1, 6)]
ALL, ALL_SLIDING, ALL_SEVEN = (
    {", ".join(words) for words in itertools.product(*(choice[:2] for choice in kind))}
    for kind in (SPATIAL, SLIDING, SEVEN)
)


def names_of(system: kempe.System, frame: str, Q: np.ndarray) -> list[str]:
    """The names of configurations, by the same function of q that answers use."""
    a = system.ik_all(system.fk(Q[0], frame), frame)
    lines = a.plan.lines
    assert a._kind is not None
    return name_branches(a._kind, lines, lines.compute_theta(Q[:, lines.q_index])).tolist()


# ---- the arm of the lecture


def planar_arm(rng: np.random.Generator, count: int) -> tuple[kempe.System, np.ndarray]:
    """An arm in the plane, anywhere, its joints with any zero; the offsets of these zeros."""
    m = kempe.Mechanism("arm", dim=2)
    zeros = rng.uniform(-3, 3, count)
    body = m.ground
    for k in range(count):
        at = rng.uniform(-1, 1, 2) if k == 0 else (rng.uniform(0.2, 1.0), 0.0)
        body_k = m.body(f"b{k}")
        m.revolute(f"q{k + 1}", body, body_k, at=at, rpy=(0, 0, zeros[k]))
        body = body_k
    m.frame("e", body, at=(rng.uniform(0.2, 1.0), 0.0))
    return m.build(), zeros


@pytest.mark.parametrize("count", [2, 3])
def test_elbows_in_the_plane_are_the_lectures(hunt, count):
    """sin q2 < 0 is elbow-up, q2 counted from the stretched arm."""
    rng = hunt.rng()
    for _ in range(hunt.cases(60)):
        system, zeros = planar_arm(rng, count)
        q = rng.uniform(-3, 3, count)
        X = system.fk(q, "e")
        a = system.ik_all(X[:2, 3] if count == 2 else X, "e")
        assert sorted(a.names) == ["elbow-down", "elbow-up"]
        for row, name in zip(a.q, a.names, strict=True):
            assert name == ("elbow-up" if np.sin(row[1] + zeros[1]) < 0 else "elbow-down")


@pytest.mark.parametrize("slide", range(4))
@pytest.mark.parametrize("axis", ["z", "-z", (0.3, -0.4, 0.8)])
def test_elbows_of_a_scara_are_those_of_the_plane(slide, axis):
    """Its slide at any place: the elbow is to the left or right, seen from where the axes point to,
    of the way on.
    """
    m = kempe.Mechanism("scara")
    rng = np.random.default_rng(slide)
    body = m.ground
    turns = []
    for k in range(4):
        at = (0.0, 0.0, 0.4) if k == 0 else rng.uniform(0.1, 0.5, 3)
        (m.prismatic if k == slide else m.revolute)(
            f"q{k}", body, m.body(f"b{k}"), at=at, axis=axis
        )
        turns += [] if k == slide else [f"b{k}"]
        body = f"b{k}"
    m.frame("tip", body, at=(0.1, 0.2, -0.3))
    system = m.build()
    up = spatial.unit(np.array({"z": (0, 0, 1), "-z": (0, 0, -1)}.get(axis, axis), dtype=float))
    for q in system.random(rng, 10):
        a = system.ik_all(system.fk(q, "tip"), "tip")
        assert sorted(a.names) == ["elbow-down", "elbow-up"]
        for row, name in zip(a.q, a.names, strict=True):
            p = system.fk(row, turns)[:, :3, 3]
            # of the way from the first axis to the third
            left = up @ np.cross(p[2] - p[0], p[1] - p[0]) > 0
            assert name == ("elbow-up" if left else "elbow-down")


def test_the_arm_of_the_lecture():
    arm = kempe.load("two_link")
    a = arm.ik_all([0.6, 0.3], "e")
    assert a.names.tolist() == ["elbow-down", "elbow-up"]
    assert np.sin(a.q[a.find_branch("elbow-up")][0, 1]) < 0
    assert "q2 = -1.47062891, note = elbow-up" in str(a) and "elbow-up" in a._repr_html_()
    for point in ([0.9, 0.0], [0.0, 0.1]):
        assert arm.ik_all(point, "e").names.tolist() == ["elbow singular"]
    batch = arm.ik_all([[0.6, 0.3], [5.0, 0.0]], "e")
    assert batch.names.shape == batch.mask.shape
    assert (batch.names != "").tolist() == batch.mask.tolist()
    assert batch.find_branch("elbow-up").sum() == 1 and batch.q[
        batch.find_branch("elbow-up")
    ].shape == (1, 2)


# ---- published solutions, and chains without names


def test_the_puma_as_its_books_name_it():
    """Corke, Robotics, Vision and Control: `ikine6s` of the nominal pose gives 'lun' without, and
    qn with 'ru'.
    """
    puma = kempe.load("puma560")
    qn = np.array([0, np.pi / 4, -np.pi, 0, np.pi / 4, 0])  # the sign of q3 differs by a turn
    a = puma.ik_all(puma.fk(qn, "tool"), "tool", start=qn)
    (lun,) = a.q[a.find_branch("shoulder left, elbow up, no flip")]
    (run,) = a.q[a.find_branch(["shoulder right", "elbow up", "no flip"])]
    turns = np.array([2.6486, -3.9270, 0.0940, 2.5326, 0.9743, 0.3734])
    np.testing.assert_allclose(np.angle(np.exp(1j * (lun - turns))), 0, atol=6e-5)
    np.testing.assert_allclose(np.angle(np.exp(1j * (run - qn))), 0, atol=1e-9)
    assert set(a.names) == ALL


@pytest.mark.parametrize(
    ("robot", "frame"), [("ur5", "tool"), ("ur10e", "tool"), ("irb6640", "tool0")]
)
def test_shipped_robots_have_eight_names(robot, frame, hunt):
    system = kempe.load(robot)
    Q = system.random(hunt.rng(), 50)
    a = system.ik_all(system.fk(Q, frame), frame)
    for names in a.names:
        names = [n for n in names if n]
        assert len(set(names)) == len(names) and set(names) <= ALL


def test_the_stanford_arm_has_eight_names(hunt):
    """Those inside its limits have the slide ahead, as it is built."""
    stanford = kempe.load("stanford")
    Q = stanford.configuration_space.sample(50, hunt.rng()).q
    a = stanford.ik_all(stanford.fk(Q, "tool"), "tool")
    for names, inside in zip(a.names, a.inside, strict=True):
        assert set(names) - {""} == ALL_SLIDING and all(
            "slide ahead" in name for name in names[inside]
        )
    assert a.find_branch("slide back").sum() == 4 * len(Q)
    assert (
        stanford.ik_all(stanford.fk([0.3, 0.7, 0.0, 0.2, 0.9, -0.4], "tool"), "tool")
        .find_branch("slide singular")
        .all()
    )


def test_three_slides_and_a_wrist_have_flips():
    m = kempe.Mechanism("gantry")
    body = "ground"
    for k, (kind, axis) in enumerate(zip("PPPRRR", ("x", "y", "z", "z", "y", "z"), strict=True)):
        (m.prismatic if kind == "P" else m.revolute)(f"q{k}", body, m.body(f"b{k}"), axis=axis)
        body = f"b{k}"
    m.frame("tool", body, at=(0, 0, 0.1))
    gantry = m.build()
    q = [0.1, 0.2, 0.3, 0.4, 0.5, 0.6]
    a = gantry.ik_all(gantry.fk(q, "tool"), "tool", start=q)
    assert a.names.tolist() == ["no flip", "flip"]
    with pytest.raises(UnknownNameError):
        a.find_branch("elbow +")


def test_arms_of_seven_joints_are_named_by_the_signs_of_three(hunt):
    """Of iiwa 14, which is stretched at zero: of sin q2, q4 and q6; at one arm angle all eight
    differ.
    """
    iiwa = kempe.load("iiwa14")
    rng = hunt.rng()
    for q in iiwa.random(rng, hunt.cases(5)):
        X = iiwa.fk(q, "tool")
        a = iiwa.ik_all(X, "tool")
        assert len(a) and set(a.names) <= ALL_SEVEN
        for row, name in zip(a.q, a.names, strict=True):
            assert [word[-1] for word in name.split(", ")] == [
                "+-"[int(s < 0)] for s in np.sin(row[[1, 3, 5]])
            ]
        sweep = iiwa.inverse.sweep(X, "tool")
        one = sweep.at(float(rng.uniform(-3, 3)))
        names = names_of(iiwa, "tool", one.q)
        assert len(set(names)) == len(one.q) == 8
        for name, branch in zip(names, one.branch, strict=True):  # the same signs
            assert [w[-1] for w in name.split(", ")] == [
                w[-1] for w in sweep.labels[branch].split()
            ]
    assert names_of(iiwa, "tool", np.array([[0.3, 0.6, -0.4, 0.0, 0.5, 0.8, 0.1]])) == [
        "shoulder +, elbow singular, wrist +"
    ]


@pytest.mark.parametrize(
    ("robot", "frame"), [("xarm6", "tool"), ("so101", "tool"), ("hc10", "tool0")]
)
def test_chains_without_names(robot, frame):
    system = kempe.load(robot)
    a = system.ik_all(system.fk(system.random(1), frame), frame)
    assert len(a) and not any(a.names)
    with pytest.raises(InputError, match="have no names"):
        a.find_branch("elbow up")


def test_hyphens_and_spaces_are_alike():
    """A word is understood in both spellings, of planar arms and of spatial ones; "elbow -" is not
    "elbow".
    """
    arm = kempe.load("two_link")
    puma = kempe.load("puma560")
    a = arm.ik_all([0.6, 0.3], "e")
    for other in ("elbow up", "elbow-up", " elbow  up "):
        assert (
            a.find_branch(other).tolist() == a.find_branch("elbow-up").tolist()
            and a.find_branch(other).sum() == 1
        )
    b = puma.ik_all(puma.fk(puma.random(1), "tool"), "tool")
    for word in WORDS:
        assert (
            b.find_branch(word.replace(" ", "-")).tolist() == b.find_branch(word).tolist()
            and b.find_branch(word).sum() == len(b) / 2
        )
    with pytest.raises(UnknownNameError):
        b.find_branch("elbow")


def test_words_that_do_not_exist():
    puma = kempe.load("puma560")
    a = puma.ik_all(puma.fk(puma.random(1), "tool"), "tool")
    with pytest.raises(UnknownNameError, match="did you mean 'elbow up'"):
        a.find_branch("elbow upp")
    for word in WORDS:
        assert a.find_branch(word).sum() == len(a) / 2
    assert not a.find_branch(["elbow up", "elbow down"]).any()


# ---- random arms


def arm_rows(rng: np.random.Generator, kind: str) -> list[dict[str, float]]:
    """A random Denavit-Hartenberg table: a spherical wrist, three parallel axes, or a slide and a
    wrist.
    """

    def right():
        return float(rng.choice([-1, 1])) * (
            np.pi / 2 if rng.random() < 0.6 else rng.uniform(0.5, 2.6)
        )

    some = lambda: float(rng.choice([0.0, rng.uniform(-0.4, 0.4)]))  # noqa: E731
    along = lambda: float(rng.choice([0.0, np.pi]))  # noqa: E731
    row1 = {"a": some(), "alpha": right(), "d": some()}
    row2 = {"a": float(rng.uniform(0.3, 1.0)), "alpha": along(), "d": some()}
    last = {"a": some(), "alpha": right(), "d": some()}
    if kind == "slide":
        row2 = {"a": some(), "alpha": float(rng.choice([-1, 1])) * np.pi / 2, "d": some()}
        row3 = {
            "type": "prismatic",
            "a": some(),
            "alpha": float(rng.uniform(-1, 1)),
            "theta": float(rng.uniform(-3, 3)),
        }
        return [row1, row2, row3, {"alpha": right(), "d": some()}, {"alpha": right()}, last]
    if kind == "wrist":
        row3 = {"a": float(rng.uniform(-0.3, 0.3)), "alpha": right(), "d": some()}
        return [
            row1,
            row2,
            row3,
            {"alpha": right(), "d": float(rng.uniform(0.3, 1.0))},
            {"alpha": right()},
            last,
        ]
    row3 = {"a": float(rng.uniform(0.3, 1.0)), "alpha": along(), "d": some()}
    row4 = {"a": some() if rng.random() < 0.3 else 0.0, "alpha": right(), "d": some()}
    return [row1, row2, row3, row4, {"alpha": right(), "d": some()}, last]


def random_pose(rng: np.random.Generator) -> np.ndarray:
    return spatial.pose(spatial.exp_so3(rng.normal(size=3)), rng.uniform(-1, 1, 3))


def turns(x: np.ndarray) -> np.ndarray:
    """Angles modulo a turn, around zero."""
    return np.angle(np.exp(1j * x))


def seen(system: kempe.System, q: np.ndarray, kind: str) -> str:
    """The name by plain geometry, from the poses of the bodies alone: what a viewer along axis 1
    sees.

    Body k of a standard table has the axis of joint k + 1 as its z; body 5 begins where axes 5 and
    6 meet.
    """
    first = system.structure.joints["q1"]
    X = [
        system.fk(q, first.parent) @ first.X_PF.evaluate_pose(system.structure.parameters),
        *system.fk(q, LINKS),
    ]
    z = [Y[:3, 2] for Y in X]
    p = [Y[:3, 3] for Y in X]
    wrist = X[5][:3, 3]
    n = np.cross(z[0], z[1])
    ahead = float((wrist - p[0]) @ n)
    # the offset of the arm's plane, from where the common normal of axes 1 and 2 leaves axis 1
    foot = p[0] + z[0] * np.linalg.solve(np.stack([z[0], -z[1], n], axis=1), p[1] - p[0])[0]
    offset = float((wrist - foot) @ z[1])
    side = 1.0 if abs(offset) < 1e-7 else np.sign(offset)
    shoulder = ahead * side < 0
    flip = np.cross(z[3], z[5]) @ z[4] < 0
    if kind == "slide":
        middle = "slide ahead" if (wrist - p[1]) @ z[2] > 0 else "slide back"
        return (
            f"shoulder {'left' if shoulder else 'right'}, {middle}, {'flip' if flip else 'no flip'}"
        )
    # in the plane across axis 2, seen with the wrist to the right: is the elbow above the way from
    # shoulder to wrist
    elbow = p[2] - p[1]
    end = (p[3] if kind == "parallel" else wrist) - p[1]
    above = float(np.cross(end, elbow) @ z[1]) * np.sign(ahead)
    return ", ".join(
        [
            "shoulder left" if shoulder else "shoulder right",
            "elbow up" if above > 0 else "elbow down",
            "flip" if flip else "no flip",
        ]
    )


def check_arm(rng: np.random.Generator, kind: str) -> int:
    """One random arm and pose: names differ, agree with the eye, and do not depend on zeros, base
    or tool.
    """
    rows = arm_rows(rng, kind)
    plain = kempe.from_dh(rows).build()
    q = rng.uniform(-np.pi, np.pi, 6)
    a = plain.ik_all(plain.fk(q, "tool"), "tool")
    alone = a.multiplicity == 1
    assert len(a) and set(a.names[alone]) <= (ALL_SLIDING if kind == "slide" else ALL)
    assert len(set(a.names[alone])) == alone.sum()
    for row, name in zip(a.q, a.names, strict=True):
        assert name == seen(plain, row, kind)
    zeros = rng.uniform(-3, 3, 6)
    base = random_pose(rng)
    tool = random_pose(rng)
    moved = kempe.from_dh(
        [
            {**r, ("d" if "type" in r else "theta"): float(x)}
            for r, x in zip(rows, zeros, strict=True)
        ],
        base=base,
        tool=tool,
    )
    moved = moved.build()
    b = moved.ik_all(moved.fk(q - zeros, "tool"), "tool")
    assert len(b) == len(a)
    slides = np.array(["type" in r for r in rows])
    for row, name in zip(a.q, a.names, strict=True):
        off = b.q - (row - zeros)
        away = np.abs(np.where(slides, off, turns(off))).max(axis=1)
        assert away.min() < 1e-5 and b.names[np.argmin(away)] == name
    return len(a)


@pytest.mark.parametrize("kind", ["wrist", "parallel", "slide"])
def test_names_of_random_arms(kind, hunt):
    rng = hunt.rng()
    assert sum(check_arm(rng, kind) for _ in range(hunt.cases(40))) > 0


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["wrist", "parallel", "slide"])
def test_names_of_many_random_arms(kind, hunt):
    rng = hunt.rng()
    assert sum(check_arm(rng, kind) for _ in range(hunt.cases(1000))) > 0


def smallest(system: kempe.System, q: np.ndarray) -> float:
    """Smallest singular value of the Jacobian of the tool; lengths are about one metre."""
    J = system.jacobian(q, "tool")
    return float(np.linalg.svd(J, compute_uv=False)[-1])


@pytest.mark.parametrize("kind", ["wrist", "parallel", "slide"])
def test_names_change_at_singular_configurations_only(kind, hunt):
    rng = hunt.rng()
    changes = 0
    for _ in range(hunt.cases(8)):
        system = kempe.from_dh(arm_rows(rng, kind), base=random_pose(rng)).build()
        way = rng.uniform(-3, 3, (2, 6))
        Q = way[0] + np.linspace(0, 1, 300)[:, None] * (way[1] - way[0])
        names = names_of(system, "tool", Q)
        for k in range(len(Q) - 1):
            if names[k] == names[k + 1]:
                continue
            low = Q[k]
            high = Q[k + 1]
            changes = changes + 1
            while np.abs(high - low).max() > 1e-13:
                middle = 0.5 * (low + high)
                if (names_of(system, "tool", middle[None]) == [names[k]]) and not np.array_equal(
                    middle, low
                ):
                    low = middle
                elif np.array_equal(middle, low) or np.array_equal(middle, high):
                    break
                else:
                    high = middle
            assert smallest(system, high) < 1e-6, f"{names[k]} -> {names[k + 1]}"
    assert changes


@pytest.mark.parametrize("kind", ["wrist", "parallel"])
def test_singular_configurations_are_called_so(kind, hunt):
    """On the border a name says so, and never one of its sides."""
    rng = hunt.rng()
    for _ in range(hunt.cases(20)):
        rows = arm_rows(rng, kind)
        system = kempe.from_dh(rows).build()
        q = rng.uniform(-3, 3, 6)
        if kind == "wrist":
            q[4] = 0.0  # the wrist is stretched where axes 4 and 6 are on one line
            rows[4]["alpha"] = -rows[3]["alpha"]
            system = kempe.from_dh(rows).build()
            assert names_of(system, "tool", q[None])[0].endswith("wrist singular")
        else:
            q[2] = 0.0  # stretched: a row with alpha = 0 or pi is a link straight on
            assert "elbow singular" in names_of(system, "tool", q[None])[0]


def test_where_the_shoulder_is_singular_the_elbow_has_a_sign(hunt):
    """Straight above the shoulder up and down cannot be distinguished; two solutions still have two
    names.
    """
    right = np.pi / 2
    rng = hunt.rng()
    wrist = [{"d": 0.5, "alpha": right}, {"alpha": -right}, {}]
    system = kempe.from_dh(
        [{"alpha": right}, {"a": 0.6}, {"a": 0.1, "alpha": -right, "d": 0.15}, *wrist]
    ).build()
    for _ in range(hunt.cases(20)):
        q = rng.uniform(-2, 2, 6)
        # the wrist in the plane of axes 1 and 2: turn joint 2 until it is there
        w = system.fk(q, "link4")[:3, 3]
        c = np.cos(q[0])
        s = np.sin(q[0])
        x = w @ (c, s, 0)
        height = w[2]
        q[1] += np.pi / 2 - np.arctan2(height, x)
        a = system.ik_all(system.fk(q, "tool"), "tool")
        on = ["shoulder singular" in name for name in a.names]
        assert any(on) and len(set(a.names)) == len(a)
        for name in a.names[on]:
            assert name.split(", ")[1] in (*NEITHER, "elbow singular")
