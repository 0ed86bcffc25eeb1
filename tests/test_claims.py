"""What the pages say in general, and no test of a part of Kempe hunts: each is looked at for a
counter-example.
"""

from __future__ import annotations

import inspect
import itertools
import json
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from command import Result
from linkages import four_bar
from typer.main import get_command

import kempe
from kempe import errors
from kempe.cli import app
from kempe.description.toml_writer import write_toml
from kempe.library import list_models as library_models

ARMS = (
    "panda",
    "puma560",
    "ur5",
    "iiwa14",
    "so101",
    "stanford",
    "cobra600",
    "two_link",
    "jaco2",
    "xarm6",
)
CLOSED = (
    "four_bar",
    "five_bar",
    "slider_crank",
    "stewart",
    "delta_ss",
    "bennett",
    "jansen",
    "three_rpr",
)


@pytest.fixture(scope="module")
def robots():
    return {name: kempe.load(name) for name in ARMS}


def tip(robot: kempe.System) -> str:
    return robot.frame_names[-1]


def inside(robot: kempe.System, q) -> bool:
    v = robot.structure.layout.vector_v
    x = np.asarray(q)[..., robot.structure.layout.vector_q]
    return bool(((x >= robot.lower[v] - 1e-9) & (x <= robot.upper[v] + 1e-9)).all())


# ---- the inverse model


def test_answers_are_inside_the_limits_and_judged_by_the_forward_model(robots, hunt):
    """Targets within reach and far outside, poses and points: limits, errors, success."""
    rng = hunt.rng()
    for _ in range(hunt.cases(60)):
        robot = robots[ARMS[rng.integers(len(ARMS))]]
        frame = tip(robot)
        size = 20
        X = robot.fk(robot.random(rng, size), frame)
        X[:, :3, 3] *= rng.choice([1.0, 1.0, 3.0], (size, 1))
        asks_pose = bool(rng.random() < 0.6) and robot.dim == 3
        target = X if asks_pose else X[:, : robot.dim, 3]
        s = robot.ik(
            target,
            frame,
            start=robot.random(rng),
            budget=kempe.Budget(starts=int(rng.choice([1, 20]))),
        )
        assert inside(robot, s.q)
        Y = robot.fk(s.q, frame)
        place = np.linalg.norm(Y[:, :3, 3] - X[:, :3, 3], axis=1)
        cosine = (
            np.trace(np.swapaxes(Y[:, :3, :3], 1, 2) @ X[:, :3, :3], axis1=1, axis2=2) - 1.0
        ) / 2.0
        turned = np.arccos(np.clip(cosine, -1.0, 1.0)) if asks_pose else np.zeros(size)
        np.testing.assert_allclose(s.position_error, place, atol=1e-9)
        np.testing.assert_allclose(s.orientation_error, turned, atol=1e-7)
        assert np.array_equal(s.success, (s.position_error <= 1e-6) & (s.orientation_error <= 1e-6))


def test_a_frame_that_moves_with_a_loop_is_answered_with_it_closed(hunt):
    """Reachable and far targets of bodies of closed mechanisms: limits, errors, loops by the
    closure error.
    """
    rng = hunt.rng()
    reached = 0
    for _ in range(hunt.cases(30)):
        system = kempe.load(str(rng.choice(CLOSED)))
        body = str(rng.choice([n for n in system.body_names if n != system.body_names[0]]))
        closed = system.assemble(start=system.random(rng))
        X = system.fk(closed.q, body)
        X[:3, 3] *= rng.choice([1.0, 1.0, 3.0])
        s = system.ik(
            X[: system.dim, 3], body, start=system.random(rng), budget=kempe.Budget(starts=10)
        )
        assert inside(system, s.q)
        off = np.linalg.norm(system.fk(s.q, body)[:3, 3] - X[:3, 3])
        assert s.position_error == pytest.approx(off, abs=1e-9)
        if s:
            reached += 1
            assert (
                off <= 1e-6 * (1.0 + 1e-6) and np.abs(system.loops.closure_error(s.q)).max() < 1e-7
            )
    assert reached > 0 or hunt.cases(30) < 20


def test_the_answer_is_that_of_the_first_start_that_reaches_the_target(robots, hunt):
    """Whoever allows no more starts than were needed, or many more, gets the same answer."""
    rng = hunt.rng()
    for _ in range(hunt.cases(300)):
        robot = robots[ARMS[rng.integers(len(ARMS))]]
        q = robot.random(rng)
        X = robot.fk(q, tip(robot))
        seed = q + rng.normal(size=robot.nq) * rng.choice([0.1, 0.5, 2.0])
        many = robot.ik(X, tip(robot), start=seed)
        assert many.success
        few = robot.ik(X, tip(robot), start=seed, budget=kempe.Budget(starts=many.starts))
        assert few.success and few.starts == many.starts and np.array_equal(few.q, many.q)


def test_the_analytic_answer_is_the_nearest_of_all_solutions(robots, hunt):
    rng = hunt.rng()
    for _ in range(hunt.cases(100)):
        robot = robots[str(rng.choice(["puma560", "ur5"]))]
        X = robot.fk(robot.random(rng), tip(robot))
        seed = robot.random(rng)
        s = robot.ik(X, tip(robot), start=seed, method="analytic")
        a = robot.ik_all(X, tip(robot), limits="turns")
        assert s.success == bool(len(a))
        if len(a):
            least = np.linalg.norm(a.q - seed, axis=1).min()
            assert np.linalg.norm(s.q - seed) <= least + 1e-9


def test_steps_stay_in_the_limits_of_place_and_speed(robots, hunt):
    rng = hunt.rng()
    for _ in range(hunt.cases(300)):
        robot = robots[str(rng.choice(["panda", "puma560", "so101", "stanford"]))]
        fastest = float(rng.choice([0.1, 1.0, 10.0]))
        q = robot.random(rng)
        twist = rng.normal(size=6) * rng.choice([0.1, 1.0, 30.0])
        s = robot.ik_step(q, twist, tip(robot), 0.01, velocity_limits=fastest)
        assert np.abs(s.velocity).max() <= fastest * (1.0 + 1e-9) and inside(robot, s.q)


# ---- closed loops


def test_a_branch_is_never_answered_by_another_one(hunt):
    """Four-bars of random lengths: the branch that is requested, or no success, by the side of the
    middle joint.
    """
    rng = hunt.rng()
    both = [0, 0]
    for _ in range(hunt.cases(300)):
        a, b, c, d = rng.uniform(0.2, 1.0, 4)
        system = four_bar(a, b, c, d, cut=None)
        A = float(rng.uniform(-3.1, 3.1))
        for sign in "+-":
            s = system.assemble({"A": A}, branch=sign)
            B = a * np.exp(1j * A)
            closes = abs(b - c) <= abs(d - B) <= b + c
            assert (
                bool(s) == closes
                or abs(abs(d - B) - (b + c)) < 1e-9
                or abs(abs(d - B) - abs(b - c)) < 1e-9
            )
            both[bool(s)] += 1
            if s:
                C = B + b * np.exp(1j * (A + system.q_dict(s.q)["B"]))
                side = ((d - B).conjugate() * (C - B)).imag
                assert abs(abs(C - d) - c) < 1e-9 and (side > 0.0) == (sign == "+")
    assert min(both) > 0 or hunt.cases(300) < 50


def test_a_drive_holds_where_its_input_cannot_be(hunt):
    """Slider-cranks of random lengths: held where the slider is wanted beyond crank and rod in
    line, else there.
    """
    rng = hunt.rng()
    held = 0
    for _ in range(hunt.cases(5)):
        a = float(rng.uniform(0.1, 0.5))
        b = a * float(rng.uniform(1.3, 3.0))
        m = kempe.Mechanism("slider-crank", dim=2)
        m.revolute("A", m.ground, m.body("crank"))
        m.revolute("B", "crank", m.body("rod"), at=(a, 0))
        m.prismatic("S", m.ground, m.body("slider"), axis=(1, 0))
        m.revolute("C", "rod", "slider", at=(b, 0))
        system = m.build()
        start = system.assemble({"S": float(np.sqrt(a * a + b * b))}, start={"A": 1.5, "B": -2.0}).q
        s0 = system.q_dict(start)["S"]
        wave = s0 + np.concatenate(
            [[0.0], rng.uniform(0.3, 1.6) * a * np.sin(np.linspace(0.1, 9.0, 60))]
        )
        motion = system.drive({"S": wave}, start=start)
        S = motion.values("S")
        A = motion.values("A")
        beyond = (wave > a + b + 1e-9) | (wave < b - a - 1e-9)
        assert (
            np.array_equal(motion.held, beyond)
            and np.abs(system.loops.closure_error(motion.q)).max() < 1e-9
        )
        np.testing.assert_allclose(S[~beyond], wave[~beyond], atol=1e-9)
        for k in np.flatnonzero(beyond[1:]) + 1:
            assert abs(S[k] - S[k - 1]) < 1e-12 or not beyond[k - 1]
        np.testing.assert_allclose(
            b * b, (S - a * np.cos(A)) ** 2 + (a * np.sin(A)) ** 2, atol=1e-8
        )
        held += int(beyond.sum())
    assert held > 0


# ---- numbers, files, commands


BAD = (np.nan, np.inf, -np.inf)
VERBS = {
    "fk": lambda r, q, X: r.fk(q, tip(r)),
    "jacobian": lambda r, q, X: r.jacobian(q, tip(r)),
    "fk of all": lambda r, q, X: r.fk(q),
    "ik": lambda r, q, X: r.ik(X, tip(r)),
    "ik_all": lambda r, q, X: r.ik_all(X, tip(r)),
    "integrate": lambda r, q, X: r.configuration_space.integrate(q, np.zeros(r.nv)),
    "difference": lambda r, q, X: r.configuration_space.difference(q, r.neutral),
}


@pytest.mark.parametrize("verb", VERBS)
def test_a_wrong_number_never_becomes_a_plausible_one(robots, verb, hunt):
    """One number is NaN or infinite: alone it is refused, in a batch its row is NaN and the others
    stay as they are.
    """
    rng = hunt.rng()
    do = VERBS[verb]
    of_target = verb in ("ik", "ik_all")
    for _ in range(hunt.cases(40)):
        robot = robots[
            str(
                rng.choice(
                    ["puma560", "ur5"] if verb == "ik_all" else ["panda", "puma560", "stanford"]
                )
            )
        ]
        Q = robot.random(rng, 5)
        T = robot.fk(Q, tip(robot))
        row = int(rng.integers(5))
        bad = BAD[rng.integers(3)]
        Q2 = Q.copy()
        T2 = T.copy()
        Q2[row, rng.integers(robot.nq)] = bad
        T2[row, rng.integers(3), rng.integers(4)] = bad
        if verb in ("integrate", "difference"):
            assert not np.isfinite(do(robot, Q2[row], T2[row])).all()
        else:
            with pytest.raises(errors.InputError):
                do(robot, Q[row] if of_target else Q2[row], T2[row])
        clean = do(robot, Q, T)
        spoilt = do(robot, Q if of_target else Q2, T2)
        clean, spoilt = (x if isinstance(x, np.ndarray) else x.q for x in (clean, spoilt))
        others = np.arange(5) != row
        if verb == "fk of all":
            assert np.isnan(spoilt[row, 1:]).any()  # bodies before the joint stay as they are
        else:
            assert not np.isfinite(spoilt[row]).all()
        k = min(clean.shape[1], spoilt.shape[1])
        assert np.array_equal(clean[others][:, :k], spoilt[others][:, :k], equal_nan=True)


RAISED = [
    n
    for n, c in vars(errors).items()
    if inspect.isclass(c) and issubclass(c, Exception) and not issubclass(c, Warning)
]


@pytest.mark.parametrize("name", RAISED)
def test_all_errors_have_one_base(name):
    assert issubclass(getattr(errors, name), errors.KempeError)


def test_unknown_keys_of_files_are_errors(hunt):
    """A key that no table has, put anywhere into a shipped model."""
    rng = hunt.rng()
    models = sorted(library_models())
    for _ in range(hunt.cases(120)):
        lines = write_toml(kempe.read(str(rng.choice(models)))).splitlines()
        heads = [i for i, line in enumerate(lines) if line.startswith("[[")]
        at = int(rng.choice([0, *heads])) + 1
        key = str(rng.choice(["limts", "colour", "x", "Name", "parents", "format2"]))
        text = "\n".join([*lines[:at], f"{key} = 1", *lines[at:]])
        with pytest.raises(errors.DescriptionError, match=f"unknown key '{key}'"):
            kempe.read(text)


COMMANDS = sorted(get_command(app).commands)  # type: ignore[attr-defined]


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_takes_json_and_help(name):
    found = get_command(app).commands[name]  # type: ignore[attr-defined]
    options = {o for p in found.params for o in p.opts}
    assert "--json" in options and Result(name, "--help").code == 0
    if any(p.name == "file" for p in found.params):
        assert {"--base", "--root", "--package-dir", "--xacro"} <= options or name in (
            "library",
            "check",
        )


def test_numbers_in_json_have_all_their_digits(robots, hunt):
    rng = hunt.rng()
    for _ in range(hunt.cases(15)):
        name = ARMS[rng.integers(len(ARMS))]
        robot = robots[name]
        q = robot.random(rng)
        numbers = ",".join(map(repr, q.tolist()))
        said = json.loads(Result("fk", name, "--frame", tip(robot), "--q", numbers, "--json").out)
        assert any(np.array_equal(x, robot.fk(q, tip(robot))) for x in matrices(said))


def matrices(x):
    """All 4x4 lists of numbers in nested data."""
    if isinstance(x, dict):
        yield from itertools.chain.from_iterable(map(matrices, x.values()))
    elif isinstance(x, list):
        if len(x) == 4 and all(isinstance(r, list) and len(r) == 4 for r in x):
            yield np.array(x, dtype=float)
        else:
            yield from itertools.chain.from_iterable(map(matrices, x))


def test_threads_of_python_may_use_one_system(robots, hunt):
    """Mixed calls to one system from eight threads give what they give one after the other."""
    rng = hunt.rng()
    robot = robots["puma560"]
    Q = robot.random(rng, hunt.cases(200))
    fresh = kempe.load("puma560")

    def work(system, k):
        q = Q[k]
        X = system.fk(q, "tool")
        return (
            X,
            system.jacobian(q, "tool"),
            system.ik(X, "tool", start=Q[k - 1]).q,
            system.ik_all(X, "tool").q,
        )

    with ThreadPoolExecutor(8) as pool:
        many = list(pool.map(lambda k: work(fresh, k), range(len(Q))))
    for k, found in enumerate(many):
        assert all(np.array_equal(a, b) for a, b in zip(found, work(robot, k), strict=True))
