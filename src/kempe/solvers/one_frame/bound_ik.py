"""The way of plain calls of `ik` for one target of one frame: all is looked up but the target and
the start.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np

from kempe.calls import quiet
from kempe.kernels.base.search_layout import ANSWER, STATUS
from kempe.kernels.compiled import maker, schedule
from kempe.kernels.forward.table_layout import HAS_QUATERNION
from kempe.solvers.common.targets import Z_AXIS
from kempe.solvers.one_frame import multi_start
from kempe.solvers.one_frame.multi_start import FEW, ITERATIONS, MOST, TOLERANCE, FrameProblem
from kempe.solvers.one_frame.solution import Solution
from kempe.spatial import Array
from kempe.status import Status, member

LENGTH, ANGLE = TOLERANCE


def bind(question: FrameProblem, task: str | None, shape: tuple[int, ...]) -> None:
    """Let calls like this one go by a `BoundIk` from now on, if they are plain enough."""
    system = question.system
    chain = question.chain
    key = (question.frame, task, len(shape))
    point = question.name == "position" and (
        task is not None or shape != (4, 4)
    )  # a turned particle is an error
    plain = (
        shape in ((4, 4), (3,), (2,))
        if point
        else (shape == (4, 4) and question.name != "position")
    )
    if (
        plain
        and question.axis == Z_AXIS
        and not chain.ints[HAS_QUATERNION]
        and key not in system._queries
    ):
        usual = replace(question, tolerance=TOLERANCE, starts=MOST, rng=0)
        system._queries[key] = BoundIk(
            usual, shape
        ).__call__  # a method, which takes less time to call


class BoundIk:
    """`ik` of single targets for one frame and task, with all looked up that can be: the way of
    plain calls.
    """

    def __init__(self, question: FrameProblem, shape: tuple[int, ...]):
        self.requested = question
        self.chain = question.chain
        self.rows = multi_start.rows_of(question)
        system = question.system
        self.size = len(question.chain.q_index)
        self.nq = system.nq
        first = int(self.chain.q_index[0]) if self.size else 0
        in_a_row = np.array_equal(self.chain.q_index, np.arange(first, first + self.size))
        self.part = slice(first, first + self.size) if in_a_row else self.chain.q_index
        self.whole = in_a_row and self.size == system.nq
        """Whether the chain has all coordinates of the system."""
        self.plain = system.nq == system.nv == len(system.structure.layout.vector_q)
        """Whether entry i of q and of the limits belong together."""
        self.lower = system.lower
        self.upper = system.upper
        self.unmoved = np.eye(4)[None]
        self.shape = shape
        self.posed = len(shape) == 2
        self.new = maker(1, self.size + ANSWER)
        self.reach = schedule.reach
        self.base = self.chain.base[0]
        self.no_seed = self.chain.no_seed

    def __reduce__(self) -> tuple[Any, ...]:
        return BoundIk, (self.requested, self.shape)

    def task(self, X: Array) -> FrameProblem:
        """The problem, for poses (1, 4, 4)."""
        return replace(self.requested, targets=X)

    def _pose(self, target: Array) -> Array:
        """A position as (1, 4, 4)."""
        X = self.unmoved.copy()
        X[0, : self.shape[0], 3] = target
        return X

    @quiet
    def _go_on(self, X: Array, seeds: Array, out: Array) -> None:
        """Search further, from other starts."""
        head = (self.chain.ints, self.chain.floats, self.chain.limits, self.rows, X, seeds, 0)
        multi_start.go_on(self.task(X), X, head, FEW, out)

    def __call__(self, target: Array, start: Any) -> Solution | None:
        """The answer for a target, None where target or seed need the general solver."""
        if target.shape != self.shape or not (self.posed or target.dtype == np.float64):
            return None
        chain = self.chain
        n = self.size
        if start is None:
            base = self.base
            seeds = self.no_seed
        else:
            if (
                start.__class__ is not np.ndarray
                or start.dtype != np.float64
                or start.shape != (self.nq,)
            ):
                return None
            if not (self.plain and start.flags.c_contiguous):
                return None
            base = start
            seeds = (start if self.whole else start[self.part]).reshape(1, 1, n)
        out = self.new()
        X = target.copy()[None] if self.posed else self._pose(target)  # the answer keeps it
        try:
            missed = self.reach(
                chain.ints,
                chain.floats,
                chain.limits,
                self.rows,
                X,
                seeds,
                0,
                0,
                FEW,
                ITERATIONS,
                LENGTH,
                ANGLE,
                0.0,
                out,
            )
        except TypeError:  # not float64
            return None
        row = out[0]
        if missed:
            self._go_on(X, seeds, out)
            if row[n + STATUS] == Status.BAD_INPUT:
                return None
        if self.whole:
            q = row[:n]
        else:
            q = np.maximum(base, self.lower) if self.plain else base.copy()
            if self.plain:
                np.minimum(q, self.upper, out=q)
            q[self.part] = row[:n]
            if not math.hypot(*base.tolist()) < math.inf:
                return None
        if not missed or row[n + STATUS] == Status.SOLVED:
            return Solution.reached((self, X), q, row)
        task = self.task(X)
        codes = np.array([Status.NOT_FOUND])
        quiet(multi_start.look_closer)(task, codes)
        linear, angular, _, steps, starts = row[n:].tolist()
        return Solution(q, False, member(codes[0]), linear, angular, int(steps), int(starts), task)
