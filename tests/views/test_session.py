"""What a page of the viewer shows and does, without a browser."""

from __future__ import annotations

import re

import numpy as np
import pytest
from hunts import some

import kempe
from kempe.equations.judge import closure_error, judge_configurations
from kempe.errors import InputError, UnknownNameError, UnsupportedError
from kempe.motion.transmission import compute_transmission_angle
from kempe.views.drawing.labels import fit_sentence
from kempe.views.viewer.dimensions import describe_four_bar, write_mechanism
from kempe.views.viewer.first_sight import FILL, fit_camera, is_in_sight
from kempe.views.viewer.overlays import Overlay, iterate_rounds, list_offered_overlays
from kempe.views.viewer.scene_nodes import Drawn
from kempe.views.viewer.session import Session, list_possible_motions
from kempe.views.viewer.sliders import format_end, group_by_limb

UP = np.array([0.0, 0.0, 1.0])
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
    return bool(judge_configurations(session.system, session.q))


@pytest.mark.parametrize("name", NAMES)
def test_sliders_are_the_freedoms_and_keep_loops_closed(name):
    """As many as there are freedoms without idle spins; a slider that was moved stands where it was
    put.
    """
    system = kempe.load(name)
    session = Session(system)
    freedoms = system.mobility(session.q)
    assert closed(session) and len(session.sliders) == freedoms.dof - freedoms.idle
    for slider in session.sliders:
        by = 0.02 * (slider.high - slider.low)
        wanted = slider.value + (by if slider.value + by <= slider.high else -by)
        session.set_coordinate(slider.name, wanted)
        assert closed(session) or session.status, slider
        if not session.status:
            assert dict((s.name, s.value) for s in session.sliders)[slider.name] == pytest.approx(
                wanted, abs=1e-9
            )


def test_limits_are_ends_of_sliders():
    system = kempe.load("panda")
    ends = np.array([(s.low, s.high) for s in Session(system).sliders])
    assert np.allclose(ends, system.structure.limits) and {
        s.unit for s in Session(system).sliders
    } == {"rad"}


def test_a_slider_stops_where_the_loops_cannot_close():
    """A rocker stays between its dead centres, which a turn of the crank passes."""
    bar = kempe.load("four_bar")
    motion = bar.trace("A").q
    rocker = next(
        n
        for n, x in zip(bar.coordinate_names, motion.T, strict=True)
        if n != "A" and np.ptp(x) < 3.0
    )
    k = bar.coordinate_names.index(rocker)
    session = Session(bar, motion[len(motion) // 3])
    session.chart = bar.independent(session.q, [rocker])
    session.set_coordinate(rocker, motion[:, k].max() + 1.0)
    assert closed(session) and session.status
    assert motion[:, k].max() - 0.15 < session.q[k] < motion[:, k].max() + 1e-6


@pytest.mark.parametrize(
    "name", ["panda", "puma560", "two_link", "four_bar", "delta_uu", "stewart_sps", "car"]
)
def test_targets_are_reached_or_the_nearest_is_taken_with_the_reason(name):
    session = Session(kempe.load(name))
    X = session.pose.copy()
    session.go_to_random()
    there = session.pose.copy()
    assert (
        session.reach_pose(there)
        and np.allclose(session.pose, there, atol=1e-6)
        and session.target is None
    )
    far = X.copy()
    far[0, 3] += 30.0
    if name not in ("car", "stewart_sps"):  # these go anywhere: no limits
        assert not session.reach_pose(far, quick=False) and closed(session)
        assert session.target is far and len(session.status) > 20
        assert np.linalg.norm(session.pose[:3, 3] - far[:3, 3]) < 31.0


def test_solutions_hold_the_frame_and_can_be_chosen():
    """Of a UR5: all of them are those of `ik_all`, and choosing one leaves the frame where it was."""
    system = kempe.load("ur5")
    q = np.array([0.3, -1.2, 1.5, -0.6, -1.4, 0.2])
    session = Session(system, q)
    before = session.pose.copy()
    count = session.find_other_configurations()
    # eight in general position (Williams and others), one is this
    assert count == 7 and session.task == "pose"
    assert np.allclose(system.fk(session.solutions, "tool"), before, atol=1e-6)
    chosen = session.solutions[3].copy()
    session.choose_solution(3)
    assert np.array_equal(session.q, chosen) and np.array_equal(session.solutions[3], q)
    seen = {tuple(session.q.round(6))}
    for _ in range(7):
        session.choose_next_configuration()
        assert np.allclose(session.pose, before, atol=1e-6)
        seen.add(tuple(session.q.round(6)))
    assert len(seen) == 8
    with pytest.raises(InputError, match="9 is none of 7 other solutions"):
        session.choose_solution(9)


def test_assembly_modes_are_passed_in_turn():
    """A four-bar has two for a crank angle (Grashof); the second brings back the first."""
    session = Session(kempe.load("four_bar"))
    first = session.q.copy()
    A = session.sliders[0].value
    session.choose_next_configuration("mode")
    assert (
        closed(session)
        and not np.allclose(session.q, first)
        and session.sliders[0].value == pytest.approx(A)
    )
    session.choose_next_configuration("mode")
    assert np.allclose(session.q, first, atol=1e-6)


@pytest.mark.parametrize("name", NAMES)
def test_buttons_lead_to_closed_configurations(name):
    session = Session(kempe.load(name))
    for posture in session.postures:
        session.go_to_posture(posture)
        assert closed(session) or session.status, posture
    for _ in range(3):
        session.go_to_random()
        assert closed(session) or "none of" in session.status


def first(session: Session, name: str) -> Overlay:
    """The first round of what is laid over a session."""
    return next(iter(iterate_rounds(session, name)))


def test_curves_are_what_the_frame_passes():
    """A four-bar's coupler curve is the frame's place in its whole motion; a motion that is played
    goes before.
    """
    session = Session(kempe.load("four_bar"))
    assert "curve" in list_offered_overlays(session) and "curve" not in list_offered_overlays(
        Session(kempe.load("two_link"))
    )
    motion = session.system.trace(session.sliders[0].name, session.q)
    there = session.system.fk(motion.q, session.frame)[:, :3, 3]
    lines = first(session, "curve").lines
    assert np.allclose(lines[:, 0], there[:-1]) and np.allclose(lines[:, 1], there[1:])
    short = Session(session.system, path=motion.q[:5])
    assert len(first(short, "curve").lines) == 4


def test_the_workspace_of_a_planar_chain_is_its_annulus():
    """Two links of 1 m and 0.7 m without limits: the triangles cover pi ((1 + 0.7)^2 - (1 -
    0.7)^2).
    """
    m = kempe.Mechanism("arm", dim=2)
    one = m.body("one")
    two = m.body("two")
    m.revolute("A", m.ground, one)
    m.revolute("B", one, two, at=(1.0, 0.0))
    m.frame("tip", two, at=(0.7, 0.0))
    surfaces = first(Session(m.build()), "workspace").surfaces
    a, b, c = np.concatenate([corners[triangles] for corners, triangles, _ in surfaces]).transpose(
        1, 0, 2
    )[..., :2]
    area = 0.5 * np.abs((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]).sum()
    assert area == pytest.approx(np.pi * (1.7**2 - 0.3**2), rel=5e-3)


@pytest.mark.parametrize("name", some(["panda", "delta_uu", "five_bar"], 3))
def test_workspaces_lie_around_what_is_reached(name):
    """Cells of a first round hold the frame at random configurations, on the side that is shown."""
    session = Session(kempe.load(name))
    low, high = first(session, "workspace").extent
    for _ in range(5):
        before = session.pose[1, 3]
        other = Session(session.system, session.q)
        other.go_to_random()
        p = other.pose[:3, 3]
        edge = 0.2 * (high - low)
        assert p[1] < before or ((low - edge <= p) & (p <= high + edge)).all()


def test_a_motion_with_the_frame_at_rest_can_be_played():
    system = kempe.load("iiwa14")
    session = Session(system, system.mid + 0.2)
    before = session.pose.copy()
    assert "frame at rest" in list_possible_motions(session) and session.find_motion(
        "frame at rest"
    )
    assert session.motion is not None and len(session.motion.q) > 10
    for part in (0.0, 0.4, 1.0):
        session.go_to_time(part * session.motion.duration)
        assert np.allclose(session.pose, before, atol=1e-5)


def test_a_path_is_played():
    """Without times of its own in 4 s, evenly; with times at these."""
    bar = kempe.load("four_bar")
    path = bar.trace("A")
    session = Session(bar, path=path.q)
    session.go_to_time(2.0)
    assert closed(session) and np.array_equal(session.q, path.q[round(0.5 * (len(path.q) - 1))])


def test_a_ball_falls_and_bounces_and_a_car_manoeuvres():
    """A fall from a height h without spin lands after sqrt(2 h / g); a manoeuvre ends where the car
    was put.
    """
    session = Session(kempe.load("ball"))
    assert list_possible_motions(session) == ("fall",) and session.find_motion("fall")
    motion = session.motion
    assert motion is not None and motion.timed and motion.duration == pytest.approx(3.0, abs=0.1)
    assert motion.q[:, 2].min() > -1e-6
    car = Session(kempe.load("car"))
    assert "manoeuvre" in list_possible_motions(car)
    car.reach_pose(
        car.pose @ np.array([[1, 0, 0, 0.5], [0, 1, 0, 0.2], [0, 0, 1, 0], [0, 0, 0, 1.0]])
    )
    there = car.q.copy()
    assert car.find_motion("manoeuvre") and car.motion is not None
    assert np.allclose(car.motion.q[0], car.home, atol=1e-6) and np.allclose(
        car.motion.q[-1], there, atol=1e-3
    )


def test_rods_hold_while_a_target_is_dragged():
    """Of particles on rods: no joint closes a loop, and yet all lengths stay."""
    m = kempe.Mechanism("chain of rods", dim=2)
    for name in "pq":
        m.translation(f"J{name}", m.ground, m.particle(name))
    m.distance("hook", m.ground, "p", length=0.3)
    m.distance("rod", "p", "q", length=0.5)
    session = Session(m.build())
    for step in ([0.1, 0.0, 0.0], [0.0, 0.1, 0.0], [2.0, 2.0, 0.0]):
        X = session.pose.copy()
        X[:3, 3] += step
        session.reach_pose(X)
        p = session.q[:2]
        q = session.q[2:]
        assert abs(np.hypot(*p) - 0.3) < 1e-6 and abs(np.hypot(*(q - p)) - 0.5) < 1e-6


def test_a_motion_through_open_loops_is_shown_and_said():
    bar = kempe.load("four_bar")
    q = bar.q("closed")
    session = Session(bar, path=np.stack([q, q + 0.3]))
    session.go_to_time(4.0)
    assert np.array_equal(session.q, q + 0.3)
    assert (
        session.compose_text().startswith("the loops are open")
        and session.compute_residual() > 0.01
    )


def test_only_motions_that_there_can_be_are_offered():
    """A manoeuvre is known of what rolls without further equations: a car in the plane, not a wheel
    on a floor.
    """
    m = kempe.Mechanism("wheel")
    m.free("J", m.ground, m.body("wheel"))
    m.rolls("floor", "wheel", radius=0.2, shape="disc")
    with pytest.raises(UnsupportedError):
        m.build().manoeuvre(m.build().assemble().q, m.build().assemble().q)
    assert "manoeuvre" not in list_possible_motions(
        Session(m.build())
    ) and "manoeuvre" in list_possible_motions(Session(kempe.load("car")))


def test_what_is_said_names_residual_singularity_and_freedoms():
    session = Session(kempe.load("four_bar"))
    assert session.compose_text() == "" and session.compute_residual() < 1e-12
    assert session.describe_mobility() == "1 degree of freedom (Grübler count: 1)"
    delta = Session(kempe.load("delta_uu"))
    assert delta.describe_mobility() == (
        "3 degrees of freedom to order 8 (Grübler count: -3; 6 redundant constraints)"
    )
    stretched = Session(kempe.load("ur5"), np.zeros(6), "tool")
    stretched.aim_frame("tool", "pose")
    assert "tool is singular here" in stretched.compose_text()


def test_what_has_no_freedoms_is_shown_and_said():
    m = kempe.Mechanism("table", dim=2)
    m.fixed("F", m.ground, m.body("top"), at=(0.3, 0.7))
    session = Session(m.build())
    session.go_to_random()
    assert (
        session.sliders == ()
        and "no freedoms" in Session(m.build()).status
        and session.q.shape == (0,)
    )


@pytest.mark.parametrize(
    "system", [kempe.load("joint_fixed"), kempe.Mechanism("nothing").build()], ids=lambda s: s.name
)
@pytest.mark.parametrize("kind", ["solution", "mode"])
def test_what_cannot_move_has_no_other_solutions(system, kind):
    """Without coordinates there is nothing to go to, and a sentence says so."""
    session = Session(system)
    assert session.find_other_configurations(kind) == 0 and session.status
    session.go_to_random()
    session.choose_next_configuration(kind)
    assert session.q.shape == (0,)


def test_wrong_calls_are_refused_by_name():
    arm = kempe.load("two_link")
    with pytest.raises(UnknownNameError, match="nix"):
        Session(arm, frame="nix")
    with pytest.raises(InputError, match="q"):
        Session(arm, [0.0] * 5)
    with pytest.raises(InputError, match="no independent coordinate"):
        Session(arm).set_coordinate("nix", 0.0)
    with pytest.raises(UnknownNameError):
        Session(arm).go_to_posture("nix")


# ---- systems that are hard to show


def test_what_has_no_freedoms_is_shown_and_says_so():
    """A body that is fixed to the ground is in the picture; overlays end with the reason."""
    m = kempe.Mechanism("statue")
    m.fixed("screws", m.ground, m.body("figure"), at=(0, 0, 1))
    statue = m.build()
    session = Session(statue)
    points = Drawn(statue, statue.neutral).points
    assert np.allclose(points[:, :2].mean(axis=0), 0.0, atol=0.1)
    assert points[:, 2].max() > 0.8 and session.frame == "figure"
    with pytest.raises(InputError, match="does not move"):
        list(iterate_rounds(session, "singular configurations"))


def test_long_words_fit_the_panel():
    assert fit_sentence(f"{'a' * 40} is singular here") == f"{'a' * 15}…{'a' * 16} is singular here"


def test_a_camera_has_all_of_a_motion_in_sight():
    """A slide by 4 m of a bar of 1 m: both ends are among the points that are framed."""
    m = kempe.Mechanism("slide", dim=2)
    m.prismatic("x", m.ground, m.body("bar"), axis="x")
    m.frame("end", "bar", at=(1.0, 0.0))
    system = m.build()
    still, moving = (
        Drawn(system, np.zeros(1), way) for way in (None, np.linspace(0.0, 4.0, 100)[:, None])
    )
    assert np.ptp(moving.points[:, 0]) > np.ptp(still.points[:, 0]) + 3.9
    ends = moving.rigid.compute_poses(np.array([[0.0], [4.0]]))[:, 1, 0, 3] + [0.0, 1.0]
    assert moving.points[:, 0].min() <= ends.min() and ends.max() <= moving.points[:, 0].max()


# ---- what is seen at first


@pytest.mark.parametrize("aspect", [0.3, 0.5, 0.8, 1.0, 2.0])
def test_the_nearest_camera_has_all_points_in_its_frame(aspect):
    """Projected by a formula of its own: one direction is filled, and nothing is beyond it."""
    rng = np.random.default_rng(0)
    points = rng.normal(size=(200, 3)) * [3.0, 1.0, 0.5] + [5.0, -2.0, 1.0]
    below = 0.6 if aspect < 0.75 else 0.0
    camera, at = fit_camera(points, np.array([0.6, -0.85, 0.4]), UP, 1.3, aspect)
    assert is_in_sight(points, camera, at, UP, 1.3, aspect)
    z = (at - camera) / np.linalg.norm(at - camera)
    x = np.cross(z, UP) / np.linalg.norm(np.cross(z, UP))
    deep = (points - camera) @ z
    half = deep * np.tan(0.65)
    across = (points - camera) @ x / (half * aspect)
    # 1 is the upper edge of the picture, -1 the upper edge of what covers it
    up = ((points - camera) @ np.cross(x, z) / half - below) / (1.0 - below)
    assert np.abs(across).max() <= FILL + 1e-9 and np.abs(up).max() <= FILL + 1e-9
    assert any(np.allclose([v.min(), v.max()], [-FILL, FILL]) for v in (across, up))
    assert not is_in_sight(points + 9.0 * x, camera, at, UP, 1.3, aspect)


@pytest.mark.parametrize("name", ["two_link", "ur5", "puma560", "stanford", "panda"])
def test_arms_begin_inside_their_limits_and_far_from_singular(name):
    session = Session(kempe.load(name))
    system = session.system
    assert np.all((system.lower <= session.q) & (session.q <= system.upper))
    assert not session.describe_singularity() and session.pose[system.dim - 1, 3] > 0.0
    J = session._compute_rates(session.q)
    values = np.linalg.svd(J[: 2 if system.dim == 2 else 6], compute_uv=False)
    assert values[-1] > 0.02 * values[0]


def test_postures_come_before_computed_ones():
    panda = kempe.load("panda")
    assert np.array_equal(Session(panda).q, panda.q("ready"))
    jansen = kempe.load("jansen")
    assert np.allclose(Session(jansen).q, jansen.q("closed"))


def test_what_has_limbs_stands_in_its_neutral_configuration():
    """Two arms on a torso with three joints each; a hand of three fingers on an arm is no body with
    limbs.
    """

    def make_tree(trunk: int) -> kempe.System:
        m = kempe.Mechanism("tree")
        at = m.ground
        for k in range(trunk):
            body = m.body(f"trunk {k}")
            m.revolute(f"t{k}", at, body, at=(0, 0, 0.1), axis="y", limits=(-1.0, 2.0))
            at = body
        for side in "ab":
            last = at
            for k in range(3):
                body = m.body(f"{side}{k}")
                m.revolute(f"{side}{k}", last, body, at=(0.2, 0, 0), axis="xyz"[k], limits=(-1, 2))
                last = body
        return m.build()

    body, arm = make_tree(1), make_tree(6)
    assert not Session(body).q.any() and Session(arm).q.any()


def test_the_tool_is_dragged_not_a_finger():
    m = kempe.Mechanism("gripper")
    m.revolute("q", m.ground, m.body("arm"))
    m.fixed("wrist", "arm", m.body("robot_hand"))
    m.prismatic("f", "robot_hand", m.body("hand_left_finger"), axis="x", limits=(0, 0.1))
    m.frame("camera tool", "arm")
    m.frame("elbow", "arm")
    assert Session(m.build()).frames[0] == "robot_hand"
    m.frame("robot_tcp", "robot_hand")
    assert Session(m.build()).frames[0] == "robot_tcp"


# ---- sliders


def test_sliders_are_the_motors_where_these_move_the_system():
    """Of a five-bar A and D, after a random configuration as well; of a Stewart platform the legs."""
    session = Session(kempe.load("five_bar"))
    assert [s.name for s in session.sliders] == ["A", "D"]
    session.go_to_random()
    assert [s.name for s in session.sliders] == ["A", "D"]
    legs = [s.name for s in Session(kempe.load("stewart")).sliders]
    assert legs == [f"leg{k}" for k in range(1, 7)]


@pytest.mark.parametrize(
    ("value", "unit", "text"),
    [
        (np.pi, "rad", "π"),
        (-2 * np.pi, "rad", "-2π"),
        (1.5708, "rad", "π/2"),
        (-2.8973, "rad", "-2.9"),
        (0.0, "rad", "0"),
        (-180.00000000000003, "deg", "-180"),
        (0.0698, "m", "0.0698"),
    ],
)
def test_ends_of_sliders_are_written_as_people_write_them(value, unit, text):
    assert format_end(value, unit) == text


def test_sliders_of_many_joints_stand_in_limbs():
    """A torso, a head and two arms; each slider is in one group."""
    m = kempe.Mechanism("body")
    at = m.ground
    for name in ("torso_1", "torso_2"):
        m.revolute(name, at, m.body(f"{name} link"), axis="z")
        at = f"{name} link"
    for limb, count in (("head", 2), ("arm_left", 5), ("arm_right", 5)):
        last = at
        for k in range(count):
            m.revolute(f"{limb}_{k}", last, m.body(f"{limb} {k}"), axis="y", at=(0.1, 0, 0))
            last = f"{limb} {k}"
    m.revolute("wheel", m.ground, m.body("wheel link"), axis="y")
    session = Session(m.build())
    groups = group_by_limb(session.system, session.sliders)
    assert [(name, len(group)) for name, group in groups] == [
        ("torso", 2),
        ("head", 2),
        ("arm left", 5),
        ("arm right", 5),
        ("others", 1),
    ]


def test_what_is_out_of_reach_is_said_in_plain_words():
    """A coupler point leaves no curve, an arm not its reach; how far away is computed otherwise."""
    bar = Session(kempe.load("four_bar"))
    X = bar.pose.copy()
    X[0, 3] += 0.025
    bar.reach_pose(X)
    gap = 1e3 * np.linalg.norm(bar.pose[:3, 3] - X[:3, 3])
    assert bar.status == (
        f"coupler_point follows its curve (1 freedom): nearest is {float(f'{gap:.2g}'):g} mm away"
    )
    arm = Session(kempe.load("two_link"))
    X = np.eye(4)
    X[0, 3] = 10.0
    reach = np.linalg.norm(arm.system.fk(np.zeros(2), "e")[:3, 3])
    arm.reach_pose(X, quick=False)
    assert arm.status == f"out of reach: nearest is {float(f'{10.0 - reach:.2g}'):g} m away"


# ---- dimensions

CHANGED = (
    ("watt_six_bar", "b", "m"),
    ("four_bar", "b", "m"),
    ("jansen", "k", "m"),
    ("slider_crank", "l", "m"),
    ("rssr", "coupler", "m"),
    ("bricard_line_symmetric", "alpha", "rad"),
    ("stewart", "base_angle", "rad"),
    ("watt_six_bar", "bend", "rad"),
    ("panda", "d3", "m"),
)


@pytest.mark.parametrize(("name", "parameter", "unit"), some(CHANGED, 5))
def test_dimensions_change_with_closed_loops(name, parameter, unit):
    """A parameter is led down by a third and back: loops are closed to 1e-9 at each step, the
    parameter is what was wanted, and coordinates that lead stay where they can.
    """
    system = kempe.load(name)
    session = Session(system)
    (first,) = (d for d in session.dimensions if d.name == parameter)
    assert first.unit == unit and first.low < first.value < first.high
    leads = [s.name for s in session.sliders]
    for part in (*np.linspace(1.0, 0.7, 7), 1.0):
        session.set_dimension(parameter, part * first.value)
        assert np.abs(closure_error(session.system, session.q)).max(initial=0.0) < 1e-9
        assert judge_configurations(session.system, session.q)
        if not session.status:
            assert session.system.structure.parameters[parameter] == part * first.value
    assert [s.name for s in session.sliders] == leads
    session.reset_dimensions()
    assert session.system is system and closed(session)


@pytest.mark.parametrize(("name", "parameter", "unit"), some(CHANGED, 3))
def test_changes_of_dimensions_are_undone_and_redone_one_by_one(name, parameter, unit):
    """Random changes of random parameters: each step back and forward has the values of then, with
    closed loops; a change after steps back is the last one.
    """
    system = kempe.load(name)
    session = Session(system)
    rng = np.random.default_rng(0)
    first = {d.name: d.value for d in session.dimensions}
    states = [dict(session.system.structure.parameters)]
    for _ in range(6):
        one = str(rng.choice([*first]))
        for _ in range(2):  # a drag is one step
            session.set_dimension(one, first[one] * rng.uniform(0.8, 1.1))
        session.dimension_steps.end_step()
        if session.system.structure.parameters != states[-1]:
            states.append(dict(session.system.structure.parameters))
    for step, way in (
        (session.undo_dimensions, states[-2::-1]),
        (session.redo_dimensions, states[1:]),
    ):
        for state in way:
            step()
            assert session.system.structure.parameters == state
            assert judge_configurations(session.system, session.q)
        with pytest.raises(InputError, match=r"nothing to (undo|redo)"):
            step()
    session.undo_dimensions()
    session.reset_dimensions()
    assert session.system is system
    with pytest.raises(InputError, match="nothing to redo"):
        session.redo_dimensions()
    session.undo_dimensions()
    assert session.system.structure.parameters == states[-2]


def test_dimensions_stay_the_last_that_close():
    """A coupler that gets too long for its four-bar stops where the other bars are stretched to it,
    by the triangle that they then are.
    """
    session = Session(kempe.load("four_bar"))
    session.set_dimension("b", 2.0)
    sizes = session.system.structure.parameters
    # the crank may turn, and the open chain of the other three bars reaches a + c + d
    assert 0.85 < sizes["b"] <= 0.9 and closed(session)
    assert "do not close" in session.status and "b = 2" in session.status
    session.set_dimension("b", 0.5)
    assert not session.status and closed(session)


def test_a_system_without_parameters_has_no_dimensions():
    assert Session(kempe.load("two_link")).dimensions
    assert not Session(kempe.load("car")).dimensions


FOUR_BARS = (
    ((0.1, 0.5, 0.4, 0.4), "Crank-rocker"),
    ((0.4, 0.5, 0.4, 0.1), "Double-crank"),
    ((0.4, 0.1, 0.45, 0.4), "Double-rocker"),
    ((0.4, 0.5, 0.1, 0.4), "Rocker-crank"),
    ((0.3, 0.32, 0.4, 0.5), "Triple-rocker"),
    ((0.2, 0.4, 0.2, 0.4), "Change-point"),
)


@pytest.mark.parametrize(("lengths", "kind"), FOUR_BARS)
def test_a_four_bar_is_named_by_grashof_with_its_transmission_angle(lengths, kind):
    """The extremes are those of the angle along the whole motion."""
    system = kempe.load("four_bar").with_parameters(**dict(zip("abcd", lengths, strict=True)))
    q = system.assemble(start=system.q("closed")).q
    said = describe_four_bar(system, q, "A")
    assert said.startswith(kind)
    here, least, most = map(float, re.findall(r"([\d.]+)°", said))
    angle = np.rad2deg(compute_transmission_angle(system, system.trace("A", start=q).q, "C"))
    assert here == pytest.approx(np.rad2deg(compute_transmission_angle(system, q, "C")), abs=0.051)
    assert least - 0.051 <= angle.min() < least + 3.0
    assert most + 0.051 >= angle.max() > most - 3.0


def test_what_is_said_of_four_bars_is_said_of_them_only():
    for name in ("watt_six_bar", "slider_crank", "five_bar", "bennett", "panda"):
        session = Session(kempe.load(name))
        assert not session.describe_dimensions()


def test_a_changed_mechanism_is_written_with_postures_that_close():
    session = Session(kempe.load("watt_six_bar"))
    session.set_dimension("b", 0.3)
    again = kempe.read(write_mechanism(session.system)).build()
    assert again.structure.parameters == session.system.structure.parameters
    assert judge_configurations(again, again.q("closed"))
