"""The benchmark of closed loops: other libraries get the same mechanisms, and answers are judged
rightly. No timing.
"""

from __future__ import annotations

import inspect
import tomllib
from pathlib import Path

import kempe_bench as benchmark
import numpy as np
import pytest
from kempe_bench import crank_peers, cranks, freedoms, loops, motions, peers, timing
from kempe_bench.loop_solvers import Assembler, Mujoco, Pinocchio, SparseMujoco
from kempe_bench.loop_trees import Tree, mjcf

import kempe
from kempe.errors import UnsupportedError

PEERS = {"mujoco": Mujoco, "pinocchio": Pinocchio}
MORE = ("goldberg_5r", "three_rps", "delta_uu", "three_upu", "stephenson_six_bar", "stewart_sps")


def assembled(s: kempe.System, n: int) -> np.ndarray:
    """Closed configurations (n, nq) around the posture 'closed'."""
    q = s.configuration_space.integrate(
        s.q("closed"), 0.3 * np.random.default_rng(3).normal(size=(n, s.nv))
    )
    answer = s.assemble(start=q)
    assert answer.success.all()
    return answer.q


def gaps(s: kempe.System, q: np.ndarray) -> np.ndarray:
    """Distances (n, closures) of the centres of the cut joints, whose own coordinates turn only."""
    return np.linalg.norm(kempe.spatial.exp_se3(s.loops.closure_error(q))[..., :3, 3], axis=-1)


def points_tell(tree: Tree) -> bool:
    """Whether the gaps of the centres are all that can be open."""
    return tree.system.dim == 2 or all(c.joint.type.type_name == "spherical" for c in tree.cuts)


@pytest.mark.parametrize("name", [*loops.MECHANISMS, *MORE])
def test_the_tree_is_the_systems(name):
    s = kempe.load(name)
    tree = Tree(s)
    q = s.random(2, 5)
    np.testing.assert_allclose(
        np.stack(tree.poses(tree.coordinates(q)), axis=-3), s.fk(q), atol=1e-12
    )


@pytest.mark.parametrize("name", [*loops.MECHANISMS, *MORE])
def test_openings_agree_with_the_closure_error(name):
    s = kempe.load(name)
    tree = Tree(s)
    assert tree.opening(tree.coordinates(assembled(s, 5))).max() < 1e-9
    q = tree.guesses(0.2, 20)
    opening = tree.opening(tree.coordinates(q))
    assert opening.min() > 1e-4
    if points_tell(tree):
        np.testing.assert_allclose(opening, gaps(s, q).max(axis=-1), atol=1e-12)


def test_a_hinge_is_open_when_tilted_or_upside_down():
    s = kempe.load("bennett")
    tree = Tree(s)
    cut = tree.cuts[0]
    X = [np.eye(4)[None] for _ in s.body_names]

    def opening(R):
        X[cut.b] = (
            X[cut.a] @ cut.X_a @ kempe.spatial.pose(R) @ kempe.spatial.inverse(cut.X_b)
        ).reshape(1, 4, 4)
        return float(cut.opening(X)[0])

    assert opening(kempe.spatial.rot_z(1.0)) < 1e-12
    assert opening(kempe.spatial.rot_x(0.3)) == pytest.approx(np.sin(0.3), abs=1e-12)
    assert opening(kempe.spatial.rot_x(np.pi)) == 2.0


@pytest.mark.parametrize("library", PEERS)
@pytest.mark.parametrize("name", [*loops.MECHANISMS, "goldberg_5r", "three_rps"])
def test_peers_find_kempes_configurations_closed(name, library):
    """Residuals in the other library are zero where Kempe closed, and the gaps of the cut joints
    elsewhere.
    """
    pytest.importorskip(library)
    s = kempe.load(name)
    tree = Tree(s)
    peer = PEERS[library](tree)
    for x in peer.ready(assembled(s, 5)):
        assert np.abs(peer.equations(x)[0]).max() < 1e-9
    q = tree.guesses(0.2, 5)
    assert np.max(peer.opening(peer.ready(q)) - tree.opening(tree.coordinates(q))) == 0.0
    if points_tell(tree):
        sizes = [np.linalg.norm(peer.equations(x)[0]) for x in peer.ready(q)]
        np.testing.assert_allclose(sizes, np.linalg.norm(gaps(s, q), axis=-1), atol=1e-12)


@pytest.mark.parametrize("library", PEERS)
@pytest.mark.parametrize("name", ["slider_crank", "bennett", "stewart", "delta_ss"])
def test_peers_jacobians_are_those_of_their_residuals(name, library):
    pytest.importorskip(library)
    tree = Tree(kempe.load(name))
    peer = PEERS[library](tree)
    x = peer.ready(tree.guesses(0.2, 1))[0]
    h = 1e-6
    J = peer.equations(x)[1].copy()
    for i, e in enumerate(np.eye(peer.nv)):
        ahead, behind = (peer.equations(peer.add(x, way * h * e))[0].copy() for way in (1.0, -1.0))
        np.testing.assert_allclose((ahead - behind) / (2 * h), J[:, i], atol=1e-8)


@pytest.mark.parametrize("library", PEERS)
@pytest.mark.parametrize("name", loops.KNOWN)
def test_what_is_known_stays(name, library):
    pytest.importorskip(library)
    tree = Tree(kempe.load(name))
    peer = PEERS[library](tree, loops.KNOWN[name])
    q = tree.guesses(0.1, 10, loops.KNOWN[name])
    columns = [tree.columns[n] for n in loops.KNOWN[name]]
    assert np.ptp(q[:, columns], axis=0).max() == 0.0 and np.ptp(q, axis=0).max() > 0.1
    places = [
        peer.place[i]
        for i, move in zip(tree.firsts, tree.moves, strict=False)
        if move.column in columns
    ]
    answers = [peer.call(x) for x in peer.ready(q)]
    assert peer.opening(answers).max() < 1e-8 and len(places) == len(columns)
    np.testing.assert_array_equal(np.array(answers)[:, places], np.array(peer.ready(q))[:, places])


def test_sparse_equations_are_the_dense_ones():
    pytest.importorskip("mujoco")
    s = cranks.four_bars(12)
    tree = Tree(s)
    q = s.random(0)
    dense = Mujoco(tree)
    sparse = SparseMujoco(tree, ("A0",))
    (r, J), (rs, Js) = (p.equations(p.ready(q[None])[0]) for p in (dense, sparse))
    np.testing.assert_array_equal(r, rs)
    np.testing.assert_allclose(Js.toarray(), J, atol=1e-15)
    q = s.configuration_space.integrate(s.neutral, 0.1 * np.random.default_rng(0).normal(size=s.nv))
    answer = sparse.call(sparse.ready(q[None])[0])
    assert sparse.opening([answer])[0] < 1e-8 and s.assemble({"A0": 0.2}, start=q)


def test_what_has_no_counterpart_is_refused():
    tree = Tree(kempe.load("delta_uu"))
    with pytest.raises(UnsupportedError, match="universal"):
        mjcf(tree)
    m = kempe.Mechanism("geared", dim=2)
    for name in ("a", "b"):
        m.body(name)
        m.revolute(name.upper(), m.ground, name)
    m.gear("B", "A", -2.0)
    with pytest.raises(UnsupportedError, match="'?B'? is tied"):
        Tree(m.build())


@pytest.mark.parametrize("name", ["four_bar", "slider_crank", "bennett", "stewart"])
def test_drake_gets_the_same_mechanism(name):
    pytest.importorskip("pydrake")
    from kempe_bench.loop_peers import Drake

    s = kempe.load(name)
    tree = Tree(s)
    peer = Drake(tree)
    q = assembled(s, 3)
    for x in peer.ready(q):
        for binding in peer.program.GetAllConstraints():
            assert binding.evaluator().CheckSatisfied(x, 1e-9)
    off = tree.guesses(0.2, 3)
    np.testing.assert_allclose(
        peer.opening(peer.ready(off)), tree.opening(tree.coordinates(off)), atol=1e-12
    )
    assert (
        peer.opening([peer.call(x) for x in peer.ready(tree.guesses(0.1, 3))]).max()
        < peer.tolerance
    )


@pytest.mark.parametrize(
    "name", ["four_bar", "slider_crank", "stewart", "bennett", "sarrus", "three_upu", "shaky_3r"]
)
def test_exudyn_gets_the_same_mechanism(name):
    """Its rank at Kempe's closed configurations is Kempe's, and its own answers are closed."""
    pytest.importorskip("exudyn")
    from kempe_bench.loop_peers import Exudyn

    from kempe.equations.closure_rows import compute_jacobian

    s = kempe.load(name)
    tree = Tree(s)
    q = s.q("closed")
    values = np.linalg.svd(compute_jacobian(s, q), compute_uv=False)
    peer = Exudyn(tree, q)
    assert peer.freedoms() == s.nv - int(np.sum(values > 1e-8 * values.max()))
    assert peer.opening(peer.ready(assembled(s, 3) if name != "shaky_3r" else q[None])).max() < 1e-9
    off = tree.guesses(0.2, 3)
    np.testing.assert_allclose(
        peer.opening(peer.ready(off)), tree.opening(tree.coordinates(off)), atol=1e-9
    )
    if name in loops.MECHANISMS and name not in loops.UNFIT:
        assert peer.opening([peer.call(x) for x in peer.ready(tree.guesses(0.05, 3))]).max() < 1e-8


@pytest.mark.parametrize("name", crank_peers.DRIVES)
def test_pylinkage_draws_what_kempe_draws(name, monkeypatch):
    pytest.importorskip("pylinkage")
    s = kempe.load(name)
    drive = crank_peers.DRIVES[name]
    n = 400
    reported = crank_peers.linkage(s, n)
    drawn = reported.model.step_fast(iterations=n)
    start = s.assemble({drive.crank: drive.start}, start=s.q("closed")).q
    monkeypatch.setattr(cranks, "STEPS", n)
    given = cranks.turn(s, drive)
    np.testing.assert_array_equal(given["start"], start)
    answer = s.assemble({drive.crank: given["values"]}, branch=given["branch"])
    assert answer.success.all() and drawn.shape == (n, len(reported.spots), 2)
    for i, spot in enumerate(reported.spots):
        np.testing.assert_allclose(crank_peers.place(s, answer.q, spot), drawn[:, i], atol=1e-8)
    one = given["bound"]({drive.crank: given["one"]}, given["start"]).q
    i = np.abs(given["values"] - given["one"]).argmin()
    assert given["one"] == pytest.approx(given["values"][i], abs=1e-12)
    np.testing.assert_allclose(
        crank_peers.place(s, one, spot), crank_peers.place(s, answer.q[i], spot), atol=1e-8
    )
    reported.reset()
    np.testing.assert_allclose(reported.model.step_fast(iterations=n), drawn, atol=1e-11)


def test_a_failure_is_neither_timed_nor_counted():
    class Half(Assembler):
        """Closes even guesses only."""

        def ready(self, q):
            return list(range(len(q)))

        def call(self, guess, /):
            return guess

        def opening(self, answers):
            return np.array([1.0 if a % 2 else 1e-9 for a in answers])

    class Never(Half):
        def opening(self, answers):
            return np.full(len(answers), np.inf)

    rows = loops.timed({"half": Half(), "never": Never()}, np.zeros((10, 4)))
    assert set(rows) == {"half"} and rows["half"][0] >= rows["half"][1] > 0
    assert loops.share(Half().opening(range(10)), 1e-8) == 50.0
    s = kempe.load("four_bar")
    tree = Tree(s)
    own = loops.Kempe(tree, lambda q: s.assemble({"A": 0.5, "D": 3.0}, start=q))
    closed = loops.Kempe(tree, lambda q: s.assemble(start=q))
    q = tree.guesses(0.1, 1)[0]
    assert np.isinf(own.opening([own.call(q)])[0]) and closed.opening([closed.call(q)])[0] < 1e-9


def test_grid():
    rows = [
        timing.Row("Kempe", "a", 1.0, 0.5),
        timing.Row("pin", "b", 30.0),
        timing.Row("Kempe", "b", 2.0),
    ]
    grid = timing.Grid("T", "mechanism", rows)
    assert grid.columns() == (["mechanism", "Kempe", "pin"], [["a", "1", "-"], ["b", "2", "30"]])
    assert "| mechanism | Kempe | pin |\n| --- | --: | --: |\n| a | 1 | - |" in grid.markdown()
    assert grid.best("Kempe", "a") == 0.5


def test_a_line_that_is_behind_says_so():
    rows = [
        timing.Row("Kempe, batch", "a", 1.0),
        timing.Row("Kempe, one", "a", 9.0),
        timing.Row("p, fast", "a", 3.0),
        timing.Row("p", "a", 30.0),
        timing.Row("Kempe, one", "b", 8.0),
        timing.Row("Kempe, one", "c", 1.0),
        timing.Row("r", "c", 0.5),
    ]
    said = timing.Grid("T", "us", rows).behind()
    assert said == ["behind: Kempe, one: a (3 times as long as p, fast); c (2 times as long as r)"]
    assert not timing.Grid("T", "%", rows).behind() and not timing.Table("T", "us", rows).behind()


def test_sections_call_what_users_call():
    """Nothing that is timed of Kempe begins at a module that users are not shown."""
    source = inspect.getsource(cranks)
    assert "kempe.solvers" not in source and "plan.solve" not in source


def test_pylinkage_is_installed_with_its_compiler():
    text = Path(__file__).parents[2].joinpath("pyproject.toml").read_text(encoding="utf-8")
    bench = tomllib.loads(text)["project"]["optional-dependencies"]["bench"]
    assert any(entry.startswith("pylinkage[numba]") for entry in bench)


@pytest.mark.slow
@pytest.mark.parametrize("everybody", [True, False])
def test_sections_run(monkeypatch, everybody):
    for module, name, value in (
        (timing, "ROUNDS", 1),
        (timing, "TURN", 1e-6),
        (loops, "GUESSES", 4),
        (loops, "SLOW_GUESSES", 1),
        (loops, "BATCH", 8),
        (loops, "TURNS", 1),
        (loops, "MECHANISMS", ("four_bar", "stewart", "bennett")),
        (cranks, "STEPS", 20),
        (cranks, "SINGLE_STEPS", 5),
        (cranks, "ROWS", (3, 5)),
        (motions, "SAMPLES", 5),
        (motions, "LONG", 3),
        (motions, "MECHANISMS", {"four_bar": "A"}),
        (motions, "TURNS", 1),
        (freedoms, "TRUTH", {"four_bar": 1, "shaky_3r": 0, "delta_uu": 3}),
        (freedoms, "TIMED", ("delta_uu",)),
        (freedoms, "LARGE", ("delta_uu",)),
    ):
        monkeypatch.setattr(module, name, value)
    wanted = [
        p for p in ("pin", "mujoco", "drake", "exudyn", "pylinkage") if p in peers.installed()
    ] * everybody
    sections = ["assembly", "success", "dyads", "row", "motions", "chains", "dof", "mobility"]
    assembly, success, _, _, _, _, dof, _ = tables = list(benchmark.benchmark(sections, wanted))
    assert all(np.isfinite(row.value) and table.goals for table in tables for row in table.rows)
    lines = {row.call for row in assembly.rows}
    assert lines >= {"four_bar, 0.1, crank known", "stewart, 0.1, legs known", "bennett, 1"}
    assert all(row.value == 100.0 for row in success.rows if row.library == loops.USUAL)
    assert dof.value(freedoms.TRUE, "right") == 3.0 and dof.goals[0].met
    if "exudyn" in wanted:
        assert dof.value("Exudyn", "shaky_3r") == 1.0 and dof.value("Exudyn", "right") == 2.0
    assert benchmark.page(tables, wanted).count("\n## ") == len(sections)
