"""What a page of the viewer shows and does, without a browser."""

from __future__ import annotations

import numpy as np
import pytest

import kempe
from kempe.errors import InputError, UnknownNameError
from kempe.kinematics.measure import judge
from kempe.views.viewer.session import Session

NAMES = (
    "panda",
    "ur5",
    "two_link",
    "four_bar",
    "slider_crank",
    "peaucellier",
    "delta_uu",
    "stewart_sps",
    "car",
    "ball",
)


def closed(session: Session) -> bool:
    return bool(judge(session.system, session.q))


@pytest.mark.parametrize("name", NAMES)
def test_sliders_are_the_freedoms_and_keep_loops_closed(name):
    """As many as there are freedoms without idle spins; a slider that was moved stands where it was put."""
    system = kempe.load(name)
    session = Session(system)
    freedoms = system.mobility(session.q)
    assert closed(session) and len(session.sliders) == freedoms.dof - freedoms.idle
    for slider in session.sliders:
        by = 0.02 * (slider.high - slider.low)
        wanted = slider.value + (by if slider.value + by <= slider.high else -by)
        session.set(slider.name, wanted)
        assert closed(session) or session.status, slider
        if not session.status:
            assert dict((s.name, s.value) for s in session.sliders)[slider.name] == pytest.approx(wanted, abs=1e-9)


def test_limits_are_ends_of_sliders():
    system = kempe.load("panda")
    ends = np.array([(s.low, s.high) for s in Session(system).sliders])
    assert np.allclose(ends, system.structure.limits) and {s.unit for s in Session(system).sliders} == {"rad"}


def test_a_slider_stops_where_the_loops_cannot_close():
    """A rocker stays between its dead centres, which a turn of the crank passes."""
    bar = kempe.load("four_bar")
    motion = bar.trace("A").q
    rocker = next(n for n, x in zip(bar.coordinate_names, motion.T, strict=True) if n != "A" and np.ptp(x) < 3.0)
    k = bar.coordinate_names.index(rocker)
    session = Session(bar, motion[len(motion) // 3])
    session.chart = bar.independent(session.q, [rocker])
    session.set(rocker, motion[:, k].max() + 1.0)
    assert closed(session) and session.status
    assert motion[:, k].max() - 0.15 < session.q[k] < motion[:, k].max() + 1e-6


@pytest.mark.parametrize("name", ["panda", "puma560", "two_link", "four_bar", "delta_uu", "stewart_sps", "car"])
def test_targets_are_reached_or_the_nearest_is_taken_with_the_reason(name):
    session = Session(kempe.load(name))
    X = session.pose.copy()
    session.random()
    there = session.pose.copy()
    assert session.reach(there) and np.allclose(session.pose, there, atol=1e-6) and session.target is None
    far = X.copy()
    far[0, 3] += 30.0
    if name not in ("car", "stewart_sps"):  # these go anywhere: no limits
        assert not session.reach(far, quick=False) and closed(session)
        assert session.target is far and len(session.status) > 20
        assert np.linalg.norm(session.pose[:3, 3] - far[:3, 3]) < 31.0


def test_solutions_hold_the_frame_and_can_be_chosen():
    """Of a UR5: all of them are those of `ik_all`, and choosing one leaves the frame where it was."""
    system = kempe.load("ur5")
    q = np.array([0.3, -1.2, 1.5, -0.6, -1.4, 0.2])
    session = Session(system, q)
    before = session.pose.copy()
    count = session.solve()
    assert count == 7 and session.task == "pose"  # eight in general position (Williams and others), one is this
    assert np.allclose(system.fk(session.solutions, "tool"), before, atol=1e-6)
    chosen = session.solutions[3].copy()
    session.choose(3)
    assert np.array_equal(session.q, chosen) and np.array_equal(session.solutions[3], q)
    seen = {tuple(session.q.round(6))}
    for _ in range(7):
        session.next_solution()
        assert np.allclose(session.pose, before, atol=1e-6)
        seen.add(tuple(session.q.round(6)))
    assert len(seen) == 8
    with pytest.raises(InputError, match="7 other solutions; 9"):
        session.choose(9)


def test_assembly_modes_are_passed_in_turn():
    """A four-bar has two for a crank angle (Grashof); the second brings back the first."""
    session = Session(kempe.load("four_bar"))
    first, A = session.q.copy(), session.sliders[0].value
    session.next_mode()
    assert closed(session) and not np.allclose(session.q, first) and session.sliders[0].value == pytest.approx(A)
    session.next_mode()
    assert np.allclose(session.q, first, atol=1e-6)


@pytest.mark.parametrize("name", NAMES)
def test_buttons_lead_to_closed_configurations(name):
    session = Session(kempe.load(name))
    for posture in session.postures:
        session.go(posture)
        assert closed(session) or session.status, posture
    for _ in range(3):
        session.random()
        assert closed(session) or "none of" in session.status


def test_curves_are_what_the_frame_passes():
    """Peaucellier's inversor draws a line; a two-link arm stays within its lengths."""
    watt = Session(kempe.load("four_bar"))
    curve = watt.curve()
    assert watt.is_curve and len(curve) > 20
    motion = watt.system.trace(watt.sliders[0].name, watt.q)
    assert np.allclose(curve, watt.system.fk(motion.q, watt.frame)[:, :3, 3])
    arm = Session(kempe.load("two_link"))
    points = arm.curve()
    reach = sum(v for k, v in arm.system.structure.parameters.items() if k.startswith("l"))
    assert not arm.is_curve and np.linalg.norm(points, axis=1).max() <= reach + 1e-9


def test_a_motion_with_the_frame_at_rest_can_be_played():
    system = kempe.load("iiwa14")
    session = Session(system, system.mid + 0.2)
    before = session.pose.copy()
    assert session.self_motion() and session.path is not None and len(session.path) > 10
    for part in (0.0, 0.4, 1.0):
        session.at(part)
        assert np.allclose(session.pose, before, atol=1e-5)


def test_a_path_is_played():
    bar = kempe.load("four_bar")
    path = bar.trace("A")
    session = Session(bar, path=path)
    session.at(0.5)
    assert np.array_equal(session.q, path.q[round(0.5 * (len(path.q) - 1))]) and closed(session)


def test_what_is_said_names_residual_singularity_and_freedoms():
    session = Session(kempe.load("four_bar"))
    assert "closed to" in session.said() and session.residual() < 1e-12 and "regular" in session.said()
    assert session.mobility().startswith("1 degree of freedom: Gruebler says 1")
    stretched = Session(kempe.load("ur5"), np.zeros(6), "tool")
    stretched.aim("tool", "pose")
    assert "tool is singular here" in stretched.said()


def test_what_has_no_freedoms_is_shown_and_said():
    m = kempe.Mechanism("table", dim=2)
    m.fixed("F", m.ground, m.body("top"), at=(0.3, 0.7))
    session = Session(m.build())
    session.random()
    assert session.sliders == () and "no freedoms" in Session(m.build()).status and session.q.shape == (0,)


def test_wrong_calls_are_refused_by_name():
    arm = kempe.load("two_link")
    with pytest.raises(UnknownNameError, match="nix"):
        Session(arm, frame="nix")
    with pytest.raises(InputError, match="q"):
        Session(arm, [0.0] * 5)
    with pytest.raises(InputError, match="no independent coordinate"):
        Session(arm).set("nix", 0.0)
    with pytest.raises(UnknownNameError):
        Session(arm).go("nix")
