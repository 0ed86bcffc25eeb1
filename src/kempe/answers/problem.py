"""Problems about a system, and the choice of a solver: the first solver in a table that accepts."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

from kempe.answers.targets import Z_AXIS
from kempe.budget import Budget
from kempe.errors import UnsupportedError
from kempe.model.model import store_answer

if TYPE_CHECKING:
    from kempe.model.model import Model

AnswerType = TypeVar("AnswerType")
TaskOf = tuple[str, tuple[float, float, float]]
"""What of a frame's target counts, and the axis of the tool that it points."""


NOTHING: Mapping[str, Any] = MappingProxyType({})


class Problem(NamedTuple):
    """Problem about a `system`: the checked arguments of a call, as input for the solvers.

    `requested` is "one" configuration, "all" of them, a "path" of them, or a "set" that is
    continuous. `known` are coordinates, and places of frames, by name. `targets` (N, 4, 4) are
    those of a `frame`, of which `task` names what counts, with the axis of the tool that is
    pointed; `lead` is their leading shape. `wanted` are tasks of any frames. The search begins at
    `start`. `parameter` is what a sweep goes along, and its reference. `options` are what only this
    verb reads, by the names of its arguments.
    """

    system: Model
    requested: str
    known: Mapping[str, Any] = NOTHING
    start: Any = None
    prefer: Any = None
    limits: bool | str = True
    tolerance: Any = None
    budget: Budget | None = None
    options: Mapping[str, Any] = NOTHING
    frame: str | None = None
    task: TaskOf = ("", Z_AXIS)
    targets: Any = None
    lead: tuple[int, ...] = ()
    wanted: Any = None
    method: str = "numeric"
    parameter: tuple[Any, Any] = (None, None)

    @property
    def structure(self) -> tuple[Any, ...]:
        """Part of the problem that selects the solver: all arguments but the numbers of a call."""
        names = tuple(self.known), tuple(self.options)
        fields = self.requested, self.frame, self.task, self.method, self.parameter
        return (*fields, self.prefer is None, *names)


class Solver(NamedTuple):
    """A row of the table of solvers: its name, its method in words, and two functions.

    `refuses` says in a sentence why it is not for a problem, None where it is; it looks at the
    problem's `structure` only, not at numbers that differ from call to call. `run` answers.
    """

    name: str
    how: str
    refuses: Callable[[Problem], str | None]
    run: Callable[[Problem], Any]

    def make_choice(self, refused: Sequence[tuple[str, str]] = ()) -> Choice:
        """Make the `Choice` of this solver, with the solvers `refused` before it."""
        return Choice(self.name, self.how, tuple(refused))


class Choice(NamedTuple):
    """Solver that answered, its method, and why the solvers before it in the table did not answer.

    `refused` are pairs of names and sentences.
    """

    name: str
    how: str
    refused: tuple[tuple[str, str], ...]

    def __str__(self) -> str:
        return "\n".join(
            [f"{self.name}: {self.how}", *(f"  not {name}: {why}" for name, why in self.refused)]
        )


def select_solver(rows: Sequence[Solver], problem: Problem) -> tuple[Solver, Choice]:
    """Choose the first solver that does not refuse the problem.

    Errors: `UnsupportedError` with the reason of the first solver, if all refuse.
    """
    kept: dict[Any, Any] = problem.system._kept.setdefault(select_solver, {})
    key = (tuple(rows), problem.structure)
    found = kept.get(key)
    return store_answer(kept, key, _find_solver(rows, problem)) if found is None else found


def _find_solver(rows: Sequence[Solver], problem: Problem) -> tuple[Solver, Choice]:
    """Find the first solver that does not refuse the problem, without a cache."""
    refused: list[tuple[str, str]] = []
    for solver in rows:
        why = solver.refuses(problem)
        if why is None:
            return solver, solver.make_choice(refused)
        refused.append((solver.name, why))
    raise UnsupportedError(refused[0][1])


def solve_problem(rows: Sequence[Solver], problem: Problem) -> Any:
    """Solve a problem with the first solver that does not refuse it, and record the choice."""
    solver, choice = select_solver(rows, problem)
    return record_choice(solver.run(problem), choice)


def accept_all_problems(problem: Problem) -> None:
    """Accept every problem: the `refuses` of the last solver of a table."""


def record_choice(answer: AnswerType, choice: Choice) -> AnswerType:
    """Record in an answer which solver gave it, and return the answer."""
    answer.__dict__["_choice"] = choice
    return answer
