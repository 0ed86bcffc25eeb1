"""Derivatives of loop equations by the dimensions of a mechanism, against differences."""

from __future__ import annotations

import numpy as np
import pytest
from hunts import some
from shipped import shipped, with_loops

import kempe
from kempe.assemble.dimensions import Dimensions, Relations
from kempe.equations.closure_rows import evaluate_constraints
from kempe.model.packed_loops import get_packed_loops

LOOPS = [name for name in with_loops() if shipped()[name].nv <= 20]
STEP = 1e-5


def slot(dim: int) -> kempe.System:
    """A particle on a slide and on a bar, with a point kept on a line: constraints and particles
    have places, too.
    """
    m = kempe.Mechanism("slot", dim=dim)
    bar = m.body("bar")
    bead = m.particle("bead")
    block = m.body("block")
    m.revolute("A", m.ground, bar, at=(0.1, 0.2, 0.0)[:dim])
    m.prismatic("S", m.ground, block, at=(0.0, 0.3, 0.0)[:dim], axis=(1.0, 0.5, 0.0)[:dim])
    m.translation("T", block, bead)
    m.distance("rod", bar, bead, length=0.4, at=(0.3, 0.0, 0.0)[:dim])
    return m.build()


@pytest.mark.parametrize("system", some([*LOOPS, slot(2), slot(3)], 8), ids=str)
def test_derivatives_by_dimensions_are_those_by_differences(system, hunt):
    """Open loops included, at dimensions that are changed already, all lengths in the unit of the
    given mechanism.
    """
    rng = hunt.rng()
    system = kempe.load(system) if isinstance(system, str) else system
    shape = Dimensions(system)
    p = 0.01 * rng.normal(size=shape.size)
    layout = system.structure.layout
    q = layout.integrate_velocity(
        np.tile(system.neutral, (2, 1)), 0.3 * rng.normal(size=(2, system.nv))
    )

    def equations(p: np.ndarray) -> np.ndarray:
        changed = shape.change_dimensions(p)
        loops = get_packed_loops(
            changed, frozenset(changed.structure.closures), length=shape.length
        )
        return evaluate_constraints(changed, q, False, loops=loops)[0]

    found = shape.differentiate_equations(p, q)
    some = rng.choice(shape.size, min(shape.size, 24), replace=False)
    for k, e in zip(some, np.eye(shape.size)[some], strict=True):
        wanted = (equations(p + STEP * e) - equations(p - STEP * e)) / (2.0 * STEP)
        assert np.abs(found[..., k] - wanted).max() < 1e-8


@pytest.mark.parametrize("name", ["slider_crank", "ladder", "three_rpr", "scissor"])
def test_changes_of_a_planar_mechanism_stay_in_the_plane(name, hunt):
    """Of slides, too, whose direction is the z of their frames."""
    shape = Dimensions(kempe.load(name))
    system = shape.change_dimensions(0.1 * hunt.rng().normal(size=shape.size))
    X = system.fk(system.random(0, 5))
    assert np.abs(X[..., 2, :2]).max() < 1e-12 and np.abs(X[..., 2, 3]).max() < 1e-12
    rows = np.linalg.matrix_rank(
        shape.differentiate_equations(np.zeros(shape.size), system.random(0, 1))[0]
    )
    assert rows == len(evaluate_constraints(system, system.neutral, False, True)[0])


@pytest.mark.parametrize(
    "name", some(["four_bar", "sarrus", "bennett", "slider_crank", "bricard_line_symmetric"], 3)
)
def test_derivatives_of_relations_are_those_by_differences(name, hunt):
    shape = Dimensions(kempe.load(name))
    relations = Relations(shape, 1e-3)
    p = 0.01 * hunt.rng().normal(size=shape.size)
    values = relations.compute_values(p)
    found = relations.differentiate_values(p)
    assert len(values) == len(found) > 0
    wanted = [
        relations.compute_values(p + STEP * e) - relations.compute_values(p - STEP * e)
        for e in np.eye(shape.size)
    ]
    assert np.abs(found - np.stack(wanted, axis=-1) / (2.0 * STEP)).max() < 1e-6
