"""What the inverse model says of targets that it does not reach: proofs hold, all else is worded as
evidence.

Goals are made from one configuration inside the limits, so they can be reached; those that cannot
are judged by arguments of their own: distances between goals, and closed forms.
"""

from __future__ import annotations

import re

import numpy as np
import pytest
from robots import urdf_files

import kempe
from kempe import Mechanism, System, spatial, tasks
from kempe.status import PROOFS, Status

CLAIMS = ("blocked by", "contradictory", "outside the workspace", "outside the plane", "tilted out")
"""Words that claim a proof."""
FILES = {
    "centauro": ("centauro_description/urdf/centauro.urdf", ("arm1_8", "arm2_8")),
    "tiago_pro": (
        "tiago_pro_description/robots/tiago_pro.urdf",
        ("arm_left_tool_link", "arm_right_tool_link"),
    ),
    "alex": ("alex_description/urdf/alex_nub_hands.urdf", ("leftNub", "rightNub")),
    "baxter": ("baxter_description/urdf/baxter.urdf", ("left_gripper", "right_gripper")),
    "simple_humanoid": (
        "simple_humanoid_description/urdf/simple_humanoid.urdf",
        ("l_wrist", "r_wrist", "l_ankle", "r_ankle"),
    ),
}
FREE = ("simple_humanoid",)
AT_LIMITS = {"random": 0.0, "half": 0.5, "corner": 1.0}
"""Part of the coordinates that is put at a limit."""
_loaded: dict[str, System] = {}


def robot(name: str) -> System:
    if name not in _loaded:
        path = urdf_files().get(FILES[name][0])
        if path is None:
            pytest.skip("example-robot-data is not installed")
        _loaded[name] = kempe.load(path, base="free") if name in FREE else kempe.load(path)
    return _loaded[name]


def configurations(s: System, rng: np.random.Generator, n: int, kind: str) -> np.ndarray:
    """Configurations (n, nq) inside the limits, with some coordinates at them."""
    q = np.array(s.random(rng, n))
    at_q = s.structure.layout.vector_q
    at_v = s.structure.layout.vector_v
    low = s.lower[at_v]
    high = s.upper[at_v]
    at = (rng.random((n, len(at_q))) < AT_LIMITS[kind]) & np.isfinite(low) & np.isfinite(high)
    q[:, at_q] = np.where(at, np.where(rng.random(at.shape) < 0.5, low, high), q[:, at_q])
    return q


def tree(rng: np.random.Generator) -> System:
    """A body on a joint or free, with two to four arms of three to seven joints that turn or slide,
    all limited.
    """
    m = Mechanism("tree")
    free = rng.random() < 0.5
    if free:
        m.joint("base", "free", m.ground, m.body("torso"))
    else:
        m.revolute("base", m.ground, m.body("torso"), limits=(-2.0, 2.0))
    for arm in range(int(rng.integers(2, 5))):
        before = "torso"
        at = rng.normal(0.0, 0.3, 3)
        for k in range(int(rng.integers(3, 8))):
            link = m.body(f"{arm}.{k}")
            low = -rng.uniform(0.3, 3.0)
            make, limits = (
                (m.prismatic, (0.1 * low, 0.2))
                if rng.random() < 0.15
                else (m.revolute, (low, low + 3.0))
            )
            make(f"j{arm}.{k}", before, link, at=at, rpy=rng.normal(0.0, 1.5, 3), limits=limits)
            before = link
            at = rng.normal(0.0, 0.15, 3)
        m.frame(f"tip{arm}", before, at=at)
    return m.build()


def bundle(s: System, rng: np.random.Generator, q: np.ndarray) -> list[tasks.Task]:
    """Two to five tasks that q holds."""
    out: list[tasks.Task] = []
    frames = [f for f in s.frame_names if not s.structure.table.at[f][2]]
    for i in range(int(rng.integers(2, 6))):
        frame, other = (frames[k] for k in rng.choice(len(frames), 2, replace=False))
        X = s.fk(q, frame)
        Y = s.fk(q, other)
        n = rng.normal(size=3)
        make = [
            lambda: tasks.Pose(frame, X, name=f"t{i}"),  # noqa: B023
            lambda: tasks.Position(frame, X[:3, 3], name=f"t{i}"),  # noqa: B023
            lambda: tasks.Orientation(frame, X[:3, :3], name=f"t{i}"),  # noqa: B023
            lambda: tasks.Pointing(frame, X[:3, 2], name=f"t{i}"),  # noqa: B023
            lambda: tasks.RelativePose(frame, other, spatial.inverse(Y) @ X, name=f"t{i}"),  # noqa: B023
            lambda: tasks.OnPlane(frame, X[:3, 3], n, name=f"t{i}"),  # noqa: B023
            lambda: tasks.OnLine(frame, X[:3, 3], n, name=f"t{i}"),  # noqa: B023
            lambda: tasks.HalfSpace(frame, X[:3, 3], n, name=f"t{i}"),  # noqa: B023
        ]
        out.append(make[rng.integers(len(make))]())
    return out


def claims(status: str) -> list[str]:
    return [words for words in CLAIMS if words in status]


# ---- what is reachable: found, and never said to be impossible


@pytest.mark.parametrize("kind, least", [("random", 0.99), ("half", 0.98), ("corner", 0.96)])
@pytest.mark.parametrize("name", list(FILES))
def test_hands_and_feet_at_goals_of_one_configuration(name, kind, least, hunt):
    s = robot(name)
    n = hunt.cases(25 if name in FREE else 50)
    q = configurations(s, hunt.rng(), n, kind)
    answer = s.ik([tasks.Pose(frame, s.fk(q, frame)) for frame in FILES[name][1]])
    assert answer.success.mean() >= least and not answer.proven.any()
    assert not any(claims(status) for status in answer.status[~answer.success])


@pytest.mark.slow
@pytest.mark.parametrize("kind", list(AT_LIMITS))
def test_nearly_all_goals_of_one_configuration_are_found(kind, hunt):
    """At least 999 of 1000, over all robots."""
    found = total = 0
    for name in FILES:
        s = robot(name)
        n = hunt.cases(60 if name in FREE else 200)
        q = configurations(s, hunt.rng(), n, kind)
        answer = s.ik([tasks.Pose(frame, s.fk(q, frame)) for frame in FILES[name][1]])
        assert not answer.proven.any(), name
        found = found + int(answer.success.sum())
        total = total + n
    assert found >= 0.999 * total - 1.0, (found, total)


@pytest.mark.parametrize("few", [None, 1, 5])
def test_bundles_that_one_configuration_holds_are_never_said_to_contradict(few, hunt):
    """Even where so few starts are tried that many bundles are not reached."""
    rng = hunt.rng()
    missed = 0
    n = hunt.cases(60)
    for k in range(n):
        s = tree(rng)
        q = configurations(s, rng, 1, list(AT_LIMITS)[k % 3])[0]
        wanted = bundle(s, rng, q)
        answer = s.ik(wanted, **({} if few is None else {"budget": kempe.Budget(starts=few)}))
        missed += not answer.success
        assert not answer.proven
        assert answer.success or not claims(answer.status), answer.status
    assert missed <= (0.01 * n + 1 if few is None else n)


@pytest.mark.slow
def test_bundles_on_real_robots(hunt):
    rng = hunt.rng()
    missed = 0
    n = hunt.cases(40)
    for name in FILES:
        s = robot(name)
        for k in range(n):
            q = configurations(s, rng, 1, list(AT_LIMITS)[k % 3])[0]
            answer = s.ik(bundle(s, rng, q))
            missed += not answer.success
            assert not answer.proven
            assert answer.success or not claims(answer.status), answer.status
    assert missed <= 0.002 * n * len(FILES) + 1


@pytest.mark.parametrize("name", ["so101", "panda", "ur5", "puma560", "cobra600", "youbot"])
@pytest.mark.parametrize("kind", AT_LIMITS)
def test_reachable_targets_of_one_frame_are_never_said_to_be_blocked(kind, name, hunt):
    s = kempe.load(name)
    rng = hunt.rng()
    frame = s.frame_names[-1]
    q = configurations(s, rng, hunt.cases(150), kind)
    X = s.fk(q, frame)
    answer = s.ik(X, frame, budget=kempe.Budget(starts=1, iterations=4))
    missed = np.flatnonzero(~answer.success)[:10]
    assert not np.isin(answer.code, PROOFS).any()
    for i in missed:
        one = s.ik(X[i], frame, budget=kempe.Budget(starts=1, iterations=4))
        assert one.success or (not one.proven and not claims(one.status)), one.status
    assert s.ik(X, frame).success.mean() >= 0.99


@pytest.mark.slow
def test_answers_do_not_depend_on_batch_or_threads():
    """Neither those of the first starts nor those that took thousands."""
    s = robot("centauro")
    frames = FILES["centauro"][1]
    q = configurations(s, np.random.default_rng(5), 60, "corner")
    L, R = (s.fk(q, frame) for frame in frames)
    whole = s.ik([tasks.Pose(frames[0], L), tasks.Pose(frames[1], R)])
    threaded = s.ik(
        [tasks.Pose(frames[0], L), tasks.Pose(frames[1], R)], budget=kempe.Budget(threads=3)
    )
    assert np.array_equal(whole.q, threaded.q) and np.array_equal(whole.starts, threaded.starts)
    hard = np.argsort(whole.starts)[-4:]
    assert whole.starts[hard].min() > 60
    for i in [*hard, 0, 1]:
        one = s.ik([tasks.Pose(frames[0], L[i]), tasks.Pose(frames[1], R[i])])
        assert np.array_equal(one.q, whole.q[i]) and one.starts == whole.starts[i]


# ---- what is not: proofs


def test_contradictions_are_proven_and_their_sizes_true(hunt):
    """Pairs made to exclude each other by more than the tolerances, and the same pair where it just
    does not.
    """
    rng = hunt.rng()
    for _ in range(hunt.cases(30)):
        s = tree(rng)
        q = np.array(s.random(rng))
        X = s.fk(q, "tip0")
        n = rng.normal(size=3)
        off = 10.0 ** rng.uniform(-4, 0)
        n /= np.linalg.norm(n)
        turned = X.copy()
        turned[:3, :3] = spatial.exp_so3(off * n) @ X[:3, :3]
        cases = [
            (
                tasks.Position("tip0", X[:3, 3], name="a"),
                tasks.Position("tip0", X[:3, 3] + off * n, name="b"),
            ),
            (
                tasks.Position("tip0", X[:3, 3], name="a"),
                tasks.HalfSpace("tip0", X[:3, 3] + off * n, n, name="b"),
            ),
            (
                tasks.Position("tip0", X[:3, 3], name="a"),
                tasks.OnPlane("tip0", X[:3, 3] + off * n, n, name="b"),
            ),
            (tasks.Orientation("tip0", X, name="a"), tasks.Orientation("tip0", turned, name="b")),
            (tasks.Pose("tip0", X, name="a"), tasks.Position("tip0", X[:3, 3] + off * n, name="b")),
        ]
        for pair in cases:
            answer = s.ik(list(pair), budget=kempe.Budget(starts=2))
            assert (
                not answer.success
                and answer.proven
                and answer.code in (Status.CONTRADICTORY, Status.OUT_OF_REACH)
            )
            if answer.code == Status.CONTRADICTORY:
                assert "contradictory: 'a' and 'b'" in answer.status
                assert float(
                    re.findall(r"([\d.e-]+) (?:m|rad) (?:apart|away)", answer.status)[0]
                ) == pytest.approx(off, rel=1e-4)
        alone = s.ik([cases[0][0], tasks.HalfSpace("tip0", X[:3, 3] - off * n, n)])
        assert not alone.proven


def test_hands_farther_apart_than_the_links_between_them_are_long(hunt):
    """The bound is never below the distance of the tips in any configuration, and is what the
    sentence says.
    """
    rng = hunt.rng()
    for _ in range(hunt.cases(30)):
        s = tree(rng)
        q = configurations(s, rng, 300, "half")
        apart = np.linalg.norm(s.fk(q, "tip0")[:, :3, 3] - s.fk(q, "tip1")[:, :3, 3], axis=1).max()
        far = rng.uniform(5.0, 20.0)
        answer = s.ik(
            [tasks.Position("tip0", [far, 0, 0]), tasks.Position("tip1", [-far, 0, 0])],
            budget=kempe.Budget(starts=2),
        )
        assert answer.proven
        if answer.code == Status.CONTRADICTORY:
            assert apart <= float(re.findall(r"at most ([\d.e-]+) m", answer.status)[0]) * (
                1.0 + 1e-5
            )


def test_one_hand_farther_from_the_other_than_the_links_between_them_are_long(hunt):
    """A pose relative to another hand: never below what is missed, and none for what is held."""
    rng = hunt.rng()
    proven = 0
    for _ in range(hunt.cases(30)):
        s = tree(rng)
        q = configurations(s, rng, 1, "half")[0]
        X = spatial.inverse(s.fk(q, "tip1")) @ s.fk(q, "tip0")
        few = kempe.Budget(starts=2)
        assert not s.ik([tasks.RelativePose("tip0", "tip1", X)], budget=few).proven
        X[:3, 3] *= rng.uniform(1.0, 20.0) / np.linalg.norm(X[:3, 3])
        answer = s.ik([tasks.RelativePose("tip0", "tip1", X)], budget=few)
        if answer.code == Status.OUT_OF_REACH:
            proven += 1
            assert answer.proven and "outside the workspace" in answer.status
            off = float(re.findall(r"by at least ([\d.e-]+) m", answer.status)[0])
            q = np.vstack([configurations(s, rng, 300, "half"), answer.q])
            Y = spatial.inverse(s.fk(q, "tip1")) @ s.fk(q, "tip0")
            far = np.linalg.norm(Y[:, :3, 3] - X[:3, 3], axis=1)
            assert "with this orientation" in answer.status or off <= far.min() * (1.0 + 1e-5)
    assert proven


@pytest.mark.slow
def test_two_link_arms_are_blocked_only_where_both_elbows_are(hunt):
    """The closed form judges: where it has no solution inside the limits that is proven, else
    never.
    """
    rng = hunt.rng()
    blocked = 0
    for _ in range(hunt.cases(120)):
        a, b = rng.uniform(0.3, 1.0, 2)
        limits = [tuple(sorted(rng.uniform(-3.0, 3.0, 2))) for _ in range(2)]
        m = Mechanism("two links", dim=2)
        m.revolute("q1", m.ground, m.body("upper"), limits=limits[0])
        m.revolute("q2", "upper", m.body("lower"), at=(a, 0.0), limits=limits[1])
        m.frame("tip", "lower", at=(b, 0.0))
        r = rng.uniform(abs(a - b), a + b)
        turn = rng.uniform(-np.pi, np.pi)
        cosine = np.clip((r * r - a * a - b * b) / (2.0 * a * b), -1.0, 1.0)
        room = -np.inf
        for elbow in (np.arccos(cosine), -np.arccos(cosine)):
            first = turn - np.arctan2(b * np.sin(elbow), a + b * cosine)
            angles = np.array([(first + np.pi) % (2.0 * np.pi) - np.pi, elbow])
            inside = [min(x - low, high - x) for x, (low, high) in zip(angles, limits, strict=True)]
            room = max(room, min(inside))
        answer = m.build().ik([r * np.cos(turn), r * np.sin(turn)], "tip")
        assert answer.success == (room >= 0.0) or abs(room) < 1e-5
        if not answer.success and answer.code == Status.NOT_FOUND:
            assert answer.proven == ("blocked by" in answer.status)
            assert not answer.proven or room < 0.0
            blocked += answer.proven
            assert answer.proven or room > -0.01
    assert blocked > 0


# ---- bounds and misses


@pytest.mark.parametrize("name", ["panda", "ur5", "puma560", "stanford", "iiwa14", "two_link"])
def test_a_bound_is_never_above_the_miss_of_the_same_quantity(name, hunt):
    s = kempe.load(name)
    rng = hunt.rng()
    frame = s.frame_names[-1]
    X = np.array(s.fk(s.random(rng, hunt.cases(60)), frame))
    way = rng.normal(size=(len(X), 3)) * ([1, 1, 0] if s.dim == 2 else [1, 1, 1])
    X[:, :3, 3] += way * rng.uniform(0.5, 4.0, (len(X), 1))
    answer = s.ik(X, frame, budget=kempe.Budget(starts=64))
    seen = 0
    place = s.ik(
        X[:, : s.dim, 3] if s.dim == 2 else X[:, :3, 3],
        frame,
        task="position",
        budget=kempe.Budget(starts=64),
    )
    for i in np.flatnonzero(answer.code == Status.OUT_OF_REACH):
        status = answer.status[i]
        missed = float(re.findall(r"misses it by ([\d.e+-]+) m", status)[0])
        whole = re.findall(r"outside the workspace by at least ([\d.e+-]+) m", status)
        with_turn = re.findall(r"with this orientation by at least ([\d.e+-]+) m", status)
        assert whole or with_turn
        seen += 1
        for bound in whole:  # of the place alone, whatever the orientation: nothing comes nearer
            assert (
                float(bound)
                <= min(missed, float(f"{place.position_error[i]:.6g}")) * (1.0 + 1e-9) + 1e-9
            )
        for bound in with_turn:  # only what has the orientation is as far as that
            assert float(bound) <= missed * (1 + 1e-9) or answer.orientation_error[i] > 1e-6
    assert seen > 5


def test_a_bound_that_needs_the_orientation_says_so():
    s = kempe.load("panda")
    X = np.array(s.fk(s.mid, "panda_hand_tcp"))
    X[0, 3] += 3.0
    answer = s.ik(X, "panda_hand_tcp")
    place, turned = (float(x) for x in re.findall(r"by at least ([\d.]+) m", answer.status))
    assert (
        "workspace by at least" in answer.status
        and "with this orientation by at least" in answer.status
    )
    assert (
        place <= answer.position_error < turned and answer.orientation_error > 0.1 and answer.proven
    )


@pytest.mark.parametrize("beyond", [1e-6, 1e-7, 1e-8])
def test_a_near_miss_of_all_solutions_is_given_as_it_is(beyond):
    s = kempe.load("two_link")
    longest = np.abs(s.fk([0.0, 0.0], "e")[0, 3])
    answer = s.ik_all([longest + beyond, 0.0], "e")
    assert not answer.success
    assert (
        f"no solution within 1e-09, but a configuration within {beyond:g} of the target"
        in answer.status
    )


# ---- singular starts


@pytest.mark.parametrize("target", [(0.6, 0.0), (-0.6, 0.0)])
def test_a_singular_start_is_said_to_be_one(target):
    s = kempe.load("two_link")
    answer = s.ik(target, "e", start=[0.0, 0.0], budget=kempe.Budget(starts=1))
    assert not answer.success and not answer.proven
    assert "stuck at a singular configuration; more starts find an answer" in answer.status
    assert "workspace" not in answer.status and s.ik(target, "e", start=[0.0, 0.0]).success


def test_stretched_arms_inside_the_workspace_are_never_said_to_be_outside(hunt):
    rng = hunt.rng()
    for _ in range(hunt.cases(40)):
        m = Mechanism("arm", dim=2)
        n = int(rng.integers(2, 5))
        total = 0.0
        before = m.ground
        at = 0.0
        for k in range(n):
            m.revolute(f"q{k}", before, m.body(f"b{k}"), at=(at, 0.0))
            before = f"b{k}"
            at = rng.uniform(0.3, 1.0)
            total += at
        m.frame("tip", before, at=(at, 0.0))
        s = m.build()
        straight = np.zeros(n)
        straight[0] = rng.uniform(-3.0, 3.0)
        q = np.array(s.random(rng))
        p = s.fk(q, "tip")[:2, 3]
        along = np.array([np.cos(straight[0]), np.sin(straight[0])]) * np.linalg.norm(p)
        answer = s.ik(along, "tip", start=straight, budget=kempe.Budget(starts=1))
        assert answer.success or (
            "outside" not in answer.status and "find an answer" in answer.status
        )


@pytest.mark.parametrize(
    ("arm", "reasons"), [("revolute", ""), ("prismatic", " and the limits of 'l', 'r'")]
)
def test_slides_that_move_both_frames_are_no_reason(arm, reasons):
    """The lift of a torso does not change the distance between its two hands; slides of arms do."""
    m = kempe.Mechanism("two arms", dim=3)
    torso = m.body("torso")
    m.prismatic("lift", m.ground, torso, limits=(0, 1))
    for side, y in (("l", 0.2), ("r", -0.2)):
        m.joint(side, arm, torso, m.body(f"{side} arm"), at=(0, y, 0), limits=(-1, 1))
        m.frame(f"{side} hand", f"{side} arm", at=(0.5, 0, 0))
    far = tasks.RelativePosition("l hand", "r hand", (9, 0, 0))
    answer = m.build().ik([far], budget=kempe.Budget(starts=2))
    assert f"by the lengths of the links{reasons}; q is" in answer.status, answer.status
    assert "lift" not in answer.status
