"""The benchmark of all solutions: arms are the published ones, peers get the same arms, answers are
judged rightly.
"""

from __future__ import annotations

import importlib.util

import numpy as np
import pytest
from kempe_bench import analytic, analytic_arms, analytic_forms, analytic_peers, timing
from kempe_bench.analytic_arms import ARMS, judged
from kempe_bench.bench import Bench

from kempe import spatial
from kempe.errors import UnsupportedError

BY_TITLE = {arm.title: arm for arm in ARMS}
MODULES = {
    "EAIK": "eaik",
    "ik-geo": "ik_geo",
    "ssik": "ssik",
    "py-opw-kinematics": "py_opw_kinematics",
    "roboticstoolbox-python": "roboticstoolbox",
}
SOLVED = {
    "EAIK": {
        "Puma 560",
        "IRB 6640",
        "UR5",
        "UR10e",
        "Panda, joint 7 held",
        "iiwa 14, joint 3 held",
    },
    "ik-geo": {"Puma 560", "IRB 6640", "UR5", "UR10e", "iiwa 14, joint 3 held"},
    "py-opw-kinematics": {"Puma 560", "IRB 6640"},
}
NO_TABLE = ("UR10e calibrated", "PiPER", "iiwa 14, joint 3 held")
every_arm = pytest.mark.parametrize("title", BY_TITLE)


def has(package: str) -> bool:
    return importlib.util.find_spec(MODULES[package]) is not None


def poe(h: np.ndarray, p: np.ndarray, home: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Pose by axes h (6, 3) and steps p (7, 3) between points on them, at q = 0, and the tool's
    rotation there.
    """
    R = np.eye(3)
    at = p[0]
    for axis, step, angle in zip(h, p[1:], q, strict=True):
        R = R @ spatial.exp_so3(axis * angle)
        at = at + R @ step
    return spatial.pose(R @ home, at)


@every_arm
def test_chains_are_the_systems(title):
    arm = BY_TITLE[title]
    q = analytic_arms.random(5)
    whole = np.empty((5, arm.system.nq))
    whole[:] = [arm.held.get(name, 0.0) for name in arm.system.coordinate_names]
    whole[:, arm.free] = q
    np.testing.assert_allclose(arm.chain.pose(q), arm.system.fk(whole, "tool"), atol=1e-13)
    np.testing.assert_allclose(
        arm.chain.pose(np.zeros((1, 6)))[0], arm.chain.frames[-1], atol=1e-13
    )


@pytest.mark.parametrize(
    ("title", "place"),
    [
        (
            "UR10e",
            (-1.18425, -0.2907, 0.06085),
        ),  # what the controller shows with all joints at zero
        ("xArm 6", (0.207, 0.0, 0.112)),  # its user manual, zero position
        (
            "IRB 6640",
            (0.32 + 1.1425 + 0.2, 0.0, 0.78 + 1.075 + 0.2),
        ),  # drawing of the product specification
        ("CRX-10iA", (0.54 + 0.16, -0.15, 0.54)),  # reach, offset of the wrist, upper arm
        ("iiwa 14, joint 3 held", (0.0, 0.0, 0.36 + 0.42 + 0.4 + 0.126)),  # its height, 1306 mm
        ("Panda, joint 7 held", (0.088, 0.0, 0.333 + 0.316 + 0.384 - 0.107)),
    ],
)
def test_arms_at_zero(title, place):
    np.testing.assert_allclose(BY_TITLE[title].chain.frames[-1, :3, 3], place, atol=1e-12)


def between(X: np.ndarray) -> np.ndarray:
    """Angles and distances of neighbouring axes, which no choice of frames and zeros changes."""
    h = X[:6, :3, 2]
    o = X[:6, :3, 3]
    across = np.cross(h[:-1], h[1:])
    step = np.diff(o, axis=0)
    sine = np.linalg.norm(across, axis=-1)
    beside = np.linalg.norm(step - np.sum(step * h[:-1], axis=-1)[:, None] * h[:-1], axis=-1)
    skew = np.abs(np.sum(step * across, axis=-1)) / np.maximum(sine, 1e-12)
    return np.stack([sine, np.where(sine < 1e-4, beside, skew)])


@pytest.mark.parametrize("title", [arm.title for arm in ARMS if arm.prebuilt])
def test_ssik_describes_the_same_arms(title):
    ssik = pytest.importorskip("ssik")
    arm = BY_TITLE[title]
    theirs = analytic_forms.chain_of(ssik.Manipulator.from_prebuilt(arm.prebuilt).kinbody)
    q = analytic_arms.random(3)
    np.testing.assert_allclose(between(arm.chain.frames), between(theirs.frames), atol=1e-5)
    want = [ssik.Manipulator.from_prebuilt(arm.prebuilt).fk(row) for row in q]
    np.testing.assert_allclose(theirs.pose(q), want, atol=1e-13)


def test_the_calibrated_arm_is_near_the_nominal_one_and_generic():
    near = BY_TITLE["UR10e calibrated"].chain.frames
    nominal = BY_TITLE["UR10e"].chain.frames
    assert 1e-4 < np.max(np.abs(near - nominal)) < 20 * analytic_arms.ERRORS
    for i, j in ((1, 2), (2, 3), (1, 3)):
        assert np.linalg.norm(np.cross(near[i, :3, 2], near[j, :3, 2])) > 1e-4


@pytest.mark.parametrize("title", NO_TABLE)
def test_what_is_no_table_of_turns_is_refused(title):
    with pytest.raises(UnsupportedError, match="six freedoms"):
        analytic_forms.dh_table(BY_TITLE[title].chain)


@pytest.mark.parametrize("title", [t for t in BY_TITLE if t not in NO_TABLE])
def test_tables_are_the_chains(title):
    chain = BY_TITLE[title].chain
    rows, zeros, base, tool = analytic_forms.dh_table(chain)
    for q, want in zip(
        analytic_arms.random(3), base @ chain.pose(analytic_arms.random(3)) @ tool, strict=True
    ):
        X = np.eye(4)
        for (a, alpha, d), theta in zip(rows, q + zeros, strict=True):
            X = (
                X
                @ spatial.pose(spatial.rot_z(theta), [0, 0, d])
                @ spatial.pose(spatial.rot_x(alpha), [a, 0, 0])
            )
        np.testing.assert_allclose(X, want, atol=1e-13)


@pytest.mark.parametrize("title", sorted(SOLVED["ik-geo"]))
def test_axes_are_the_chains(title):
    chain = BY_TITLE[title].chain
    family, h, p = analytic_forms.decomposed(chain)
    for q, want in zip(analytic_arms.random(3), chain.pose(analytic_arms.random(3)), strict=True):
        np.testing.assert_allclose(poe(h, p, chain.frames[-1, :3, :3], q), want, atol=1e-13)
    meet = [not np.any(np.abs(step) > 1e-12) for step in p[1:6]]
    assert meet[4] and (meet[3] or family.startswith("three"))


@pytest.mark.parametrize("package", SOLVED)
@every_arm
def test_peers_find_the_arms_configurations(package, title):
    if not has(package):
        pytest.skip(f"{package} is not installed")
    make = analytic_peers.SOLVERS[package][1]
    if title not in SOLVED[package]:
        with pytest.raises(UnsupportedError):
            make(BY_TITLE[title])
    else:
        check(make(BY_TITLE[title]))


@pytest.mark.parametrize("title", ["IRB 6640", "UR10e", "Jaco 2", "CRX-10iA", "xArm 6", "PiPER"])
def test_ssik_finds_the_arms_configurations(title):
    pytest.importorskip("ssik")
    check(analytic_peers.Ssik(BY_TITLE[title]))


@pytest.mark.slow
def test_the_toolbox_finds_the_arms_configurations():
    pytest.importorskip("roboticstoolbox.robot.symbolic_ik_rr")
    check(analytic_peers.Toolbox(BY_TITLE["Puma 560"]))


def check(solver: analytic_peers.Solver) -> None:
    """The configurations that poses were made from are among the answers, and all answers reach."""
    q = analytic_arms.random(20)
    targets = solver.chain.pose(q)
    verdict = judged(solver.chain, q, [solver.read(solver.call(x)) for x in solver.ready(targets)])
    assert (verdict.found, verdict.wrong) == (20, 0) and verdict.answers >= 40
    if solver.batches:
        again = judged(
            solver.chain, q, solver.read_batch(solver.call_batch(solver.ready_batch(targets)))
        )
        assert again == verdict


def test_answers_are_judged():
    chain = BY_TITLE["Puma 560"].chain
    q = analytic_arms.random(6)
    answers = [
        np.array([q[0], q[0] + 1e-9]),
        np.array([q[1] + 2 * np.pi]),  # the same configuration
        np.array([q[2] + 1e-5]),  # neither found nor right
        np.empty((0, 6)),
        np.array([np.full(6, np.nan)]),
        np.array([q[5] + 1.0, q[5]]),
    ]
    verdict = judged(chain, q, answers)
    assert verdict == analytic_arms.Verdict(poses=6, found=3, answers=7, wrong=3)


def test_a_section_runs(monkeypatch):
    arms = ("Puma 560", "UR10e", "random 6R", "Panda, joint 7 held")
    for module, name, value in (
        (timing, "ROUNDS", 1),
        (timing, "TURN", 1e-6),
        (analytic, "TIMED", 5),
        (analytic, "JUDGED", 10),
        (analytic, "BATCH", 20),
        (analytic, "GENERAL_BATCH", 5),
        (analytic, "PREPARATIONS", 1),
        (analytic, "ARMS", [BY_TITLE[title] for title in arms]),
        (analytic, "PATIENT", ()),
    ):
        monkeypatch.setattr(module, name, value)
    bench = Bench([])
    bench.versions = {p: "" for p in ("EAIK", "ik-geo", "py-opw-kinematics") if has(p)}
    for section, title in ((analytic.closed, "UR10e"), (analytic.general, "random 6R")):
        table = section(bench)
        assert table.value("Kempe", f"{title}: {analytic.FOUND}") == 100.0
        assert table.value("Kempe", f"{title}: {analytic.WRONG}") == 0.0
        assert table.value("Kempe", f"{title}: {analytic.MANY}") > 0.0
        assert all(g.met for g in table.goals if "found" in g.text or "wrong" in g.text)
        assert len(table.goals) in (5, 10) and all(np.isfinite(row.value) for row in table.rows)
        if "EAIK" in bench.versions and title == "UR10e":
            assert table.value("EAIK", f"{title}: {analytic.ONE_RATIO}") > 0.0
            assert table.value("EAIK", f"{title}: {analytic.FOUND}") == 100.0
