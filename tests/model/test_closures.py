"""What kernels are given of closures: functions of Python that fail, the order of equations."""

from __future__ import annotations

import ctypes
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import kempe
from kempe.model.constraint_program import Tie
from kempe.model.kernel_functions import Callback
from kempe.model.packed_loops import _order_nodes, _order_ties_by_level

NOWHERE = (-1, np.eye(4), False)


def test_where_a_function_fails_kernels_find_no_numbers_and_the_error_is_kept():
    def fails(q):
        raise ZeroDivisionError("at home")

    s = kempe.load("four_bar")
    made = Callback(s, 2, fails)
    q = s.mid.copy()
    value = np.full(2, 7.0)
    columns = np.zeros((s.nv, 2))
    numbers = ctypes.POINTER(ctypes.c_double)
    called = ctypes.CFUNCTYPE(None, numbers, numbers, numbers, ctypes.c_int64)(made.address)
    called(*(x.ctypes.data_as(numbers) for x in (q, value, columns)), 1)
    assert np.isnan(value).all() and repr(made.error) == "ZeroDivisionError('at home')"


def test_equations_of_one_coordinate_stand_before_the_first_that_moves_with_it():
    """They do if they are of the last level; all others stand in the order of levels."""

    def tie(name: str, **more: Any) -> Tie:
        return Tie(name, NOWHERE, NOWHERE, **more)

    def moved_by(*velocities: int) -> Any:
        return SimpleNamespace(support=velocities)

    first = [tie("2 first", function=moved_by(2)), tie("0 first", function=moved_by(0))]
    last = [
        tie("own 1", own=1),
        tie("own 0", own=0),
        tie("1 last", function=moved_by(1)),
        tie("own 3", own=3),
    ]
    table: Any = None
    found = _order_ties_by_level([*last, *first], table, lambda t: int("first" not in t.name), {})
    assert [t.name for t in found] == ["2 first", "own 0", "0 first", "own 1", "1 last", "own 3"]


@pytest.mark.parametrize("width", [1, 3])
def test_nodes_that_are_neighbours_are_near_each_other_in_the_order(width: int):
    """Two grids whose nodes are numbered at random: neighbours are a width and a bit apart."""
    rng = np.random.default_rng(0)
    number = rng.permutation(2 * 40 * width).reshape(2, 40, width)
    neighbours: list[set[int]] = [{k} for k in range(number.size)]
    for a, b in ((number[:, 1:], number[:, :-1]), (number[..., 1:], number[..., :-1])):
        for i, j in zip(a.ravel().tolist(), b.ravel().tolist(), strict=True):
            neighbours[i].add(j)
            neighbours[j].add(i)
    order = _order_nodes([sorted(x) for x in neighbours])
    place = {k: i for i, k in enumerate(order)}
    assert sorted(order) == list(range(number.size))
    assert max(abs(place[i] - place[j]) for i in place for j in neighbours[i]) <= width + 1
