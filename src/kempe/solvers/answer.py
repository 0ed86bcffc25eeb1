"""What all answers of solvers share: truth value, sentence, text and HTML."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar, Self, TypeVar

import numpy as np

from kempe.calls import explained_methods, place_in
from kempe.errors import NoSolutionError
from kempe.kinematics.measure import Judgement, judge
from kempe.kinematics.tabular import Tabular
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.model.system import System
    from kempe.solvers.ideal import Idealised


Found = TypeVar("Found")


def expected(answer: Found) -> Found:
    """The answer, where it is a success. Errors: `NoSolutionError`, with the answer as its `solution`."""
    if not answer:
        raise NoSolutionError(answer)
    return answer


@explained_methods
class Answer(Tabular):
    """Configurations `q` (..., nq) of a `system`, with `success` (...) and, by `sentence`, why. Base of answers."""

    q: Array
    success: Any
    what: ClassVar[str] = ""
    """What is counted of a batch: "3 of 4 targets reached"."""

    @property
    def system(self) -> System:
        """The system that was asked."""
        raise NotImplementedError

    @property
    def within(self) -> Idealised | None:
        """The nearest mechanism that closes exactly, which was asked in place of the given one; None: it was itself."""
        return self.system._ideal

    def sentence(self, index: tuple[int, ...] | int = ()) -> str:
        """The sentence for one configuration, by its place in a batch. Errors: `InputError`."""
        return self._sentence(place_in(index, np.shape(self.success)))

    def _sentence(self, index: tuple[int, ...]) -> str:
        raise NotImplementedError

    @cached_property
    def status(self) -> Any:
        """The sentence for a single answer; an array of sentences for a batch. Made when asked for."""
        more = "" if self.within is None else f"; {self.within.sentence}"
        if np.ndim(self.success) == 0:
            return self._sentence(()) + more
        out = np.empty(np.shape(self.success), dtype=object)
        for index in np.ndindex(out.shape):
            out[index] = self._sentence(index) + more
        return out

    @cached_property
    def judged(self) -> Judgement:
        """How far `q` misses what is declared and asked for, by poses multiplied out in numpy, when first asked for.

        It shares nothing with the equations by which kernels say `success`.
        """
        return judge(self.system, self.q, self._asked(), self._left())

    def _asked(self) -> Sequence[tuple[Any, Any, Any]]:
        """The tasks that must hold, with their goals and tolerances."""
        return ()

    def _left(self) -> Any:
        """What (...) is left of the equations of a success, as solvers say."""
        return 0.0

    @property
    def verdict(self) -> str:
        """What the judge says of a success, in one sentence; '' where nothing succeeded, or there is nothing to judge.

        Of a batch only what contradicts a success is said.
        """
        success = np.asarray(self.success)
        if not success.any() or not self.judged.names:
            return ""
        if success.ndim == 0:
            return f"success is contradicted, {self.judged}" if not self.judged else str(self.judged)
        false = int((success & ~np.asarray(self.judged.holds)).sum())
        return f"{false} are contradicted by poses multiplied out in numpy" if false else ""

    def table(self) -> tuple[list[str], Array]:
        """Names and columns (n, nq) for a file: the coordinates of each row of `q`, in radians and metres."""
        return list(self.system.coordinate_names), np.reshape(self.q, (-1, self.system.nq))

    def expect(self) -> Self:
        """The answer itself, where it is a success. Errors: `NoSolutionError`, with the answer as its `solution`."""
        return expected(self)

    def __bool__(self) -> bool:
        return bool(np.all(self.success))

    def __len__(self) -> int:
        return len(self.success)

    def __str__(self) -> str:
        if np.ndim(self.success):
            return f"{int(np.sum(self.success))} of {np.size(self.success)} {self.what}"
        lines = [self.status]
        lines += [f"  {name} = {x:.9g}" for name, x in zip(self.system.coordinate_names, self.q, strict=True)]
        lines += [f"  {said}"] if (said := self.verdict) else []
        return "\n".join(lines)

    def _repr_html_(self) -> str:
        from html import escape

        if np.ndim(self.success):
            return f"<p>{escape(str(self))}</p>"
        rows = "".join(
            f"<tr><td>{escape(n)}</td><td>{x:.9g}</td></tr>"
            for n, x in zip(self.system.coordinate_names, self.q, strict=True)
        )
        said = f"<p>{escape(said)}</p>" if (said := self.verdict) else ""
        return f"<p>{escape(self.status)}</p><table>{rows}</table>{said}"
