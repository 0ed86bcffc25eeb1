"""The judge: against the kernels' equations and long-double poses, and that it exposes equations
that are wrong.
"""

from __future__ import annotations

import html
import io

import closed_graphs
import numpy as np
import pytest
import reference

import kempe
from kempe import Mechanism, library
from kempe.assemble import bound
from kempe.cli import terminal
from kempe.equations.judge import Poses, judge_configurations, multiply_primitives
from kempe.joints import TYPES, make_joint_type
from kempe.status import Status


def text(answer) -> str:
    file = io.StringIO()
    terminal.print_answer(answer, file=file)
    return file.getvalue()


# ---- poses


@pytest.mark.parametrize("name", TYPES)
def test_motions_of_joints(name, hunt):
    rng = hunt.rng()
    kind = TYPES[name]
    options = {"pitch": 0.3} if name == "helical" else {}
    for dim in (2, 3) if kind.planar else (3,):
        names, primitives = make_joint_type(name, **options).layout(dim)
        for _ in range(hunt.cases(20)):
            q = rng.uniform(-3.0, 3.0, len(names))
            wanted = reference.joint_pose(name, q.tolist(), dim=dim, **options)
            np.testing.assert_allclose(
                multiply_primitives(primitives, q), wanted.astype(float), atol=1e-14
            )


@pytest.mark.parametrize("name", library.list_models())
def test_poses_are_those_of_the_forward_model(name):
    system = kempe.load(name)
    q = np.stack([system.random(k) for k in range(5)])
    np.testing.assert_allclose(Poses(system, q)(None), system.fk(q), atol=1e-12)


# ---- what is declared


def test_joints_that_close_loops(hunt):
    """Open loops of random joints and products: the kernels' twists have lengths and angles that
    the judge finds.
    """
    rng = hunt.rng()
    kinds = set()
    for _ in range(hunt.cases(100)):
        made = closed_graphs.random_closed(rng)
        system = made.system()
        q = np.stack([made.values(system), system.random(rng)])
        found = judge_configurations(system, q)
        error = system.loops.closure_error(q)
        size = np.stack([np.linalg.norm(error[..., 3:], axis=-1)], axis=-1)
        np.testing.assert_allclose(np.moveaxis(found.errors, 0, 1)[..., 1:], size, atol=2e-7)
        place = np.array([made.open_by(system, x) for x in q], dtype=float)
        assert found.holds.tolist() == (place < 1e-6).tolist() == [True, False]
        kinds |= {
            system.structure.joints[n].type.type_name.split("(")[0]
            for n in system.structure.closures
        }
    assert len(kinds) >= 6


def test_couplings_with_several_sources():
    m = Mechanism("differential")
    for name in "abc":
        m.revolute(f"J{name}", m.ground, m.body(name))
    m.couple("Ja", {"Jb": 2.0, "Jc": -3.0}, 0.5)
    found = judge_configurations(m.build(), [[0.5, 0.0, 0.0], [0.8, 0.0, 0.0]])
    np.testing.assert_allclose(found.errors, [[[0.0, 0.0], [0.0, 0.1]]], atol=1e-15)
    assert found.names == ("Ja",) and found.holds.tolist() == [True, False]


# ---- nothing certifies itself


def test_a_kernel_that_closes_nothing_is_exposed(monkeypatch):
    """A residual that is always zero is believed by the solver; the report of its success says that
    it is wrong.
    """
    system = kempe.load("four_bar")

    def blind(*given):
        q, residual, info = given[-3:]
        q[:] = given[4]
        residual[:] = 0.0
        info[:] = (Status.SOLVED, 1, 1)
        return 0

    monkeypatch.setattr(bound.loop_closing, "assemble_loops", blind)
    answer = system.assemble({"A": 0.3}, start=system.neutral)
    assert answer.success and answer.residual == 0.0 and not answer.judged.holds
    said = "success is contradicted; independent check: 'C' is missed by"
    for shown in (
        str(answer),
        html.unescape(answer._repr_html_()),
        text(answer),
    ):
        assert said in shown
    data = answer.data()["judged"]
    assert data["holds"] is False and max(data["errors"]["C"]) > 1e-3
    many = system.assemble({"A": [0.3, 0.5]}, start=system.neutral)
    assert "2 are contradicted by an independent check" in text(many)


def test_a_forward_model_that_is_wrong_is_exposed(monkeypatch):
    """An `ik` that believes a tool to be where it is not is contradicted by the poses that the
    joints give.
    """
    system = kempe.load("two_link")
    answer = system.ik([0.6, 0.3], "e")
    assert answer.judged and "independent check" in text(answer)
    moved = object.__new__(type(answer))
    moved.__dict__.update(answer.__dict__, q=answer.q + 0.01)
    moved.__dict__.pop("judged")
    assert moved.success and not moved.judged
    assert "success is contradicted" in str(moved) and "success is contradicted" in text(moved)
    assert moved.data()["judged"]["holds"] is False


def test_what_is_open_is_not_said_to_be_contradicted():
    answer = kempe.load("four_bar").assemble({"A": 0.3, "D": 0.0})
    assert not answer and answer.verdict == "" and not answer.judged


def test_paths_and_batches():
    system = kempe.load("jansen")
    path = system.trace("O")
    assert (
        path.judged
        and path.judged.errors.shape == (3, len(path), 2)
        and "independent check" in text(path)
    )
    batch = system.assemble({"O": [0.1, np.nan, 0.4]})
    assert batch.judged.holds.tolist() == [True, False, True] and batch.verdict == ""
