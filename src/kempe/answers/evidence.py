"""Evidence why a problem has no answer, as data: proofs, and hints from further searches.

`wording` makes sentences of it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe.model.characteristic_length import compute_characteristic_length
from kempe.spatial import Array
from kempe.units import METRE
from kempe.words import InWords

if TYPE_CHECKING:
    from kempe.equations.one_sided import OneSided
    from kempe.model.model import Model


@dataclass(frozen=True, slots=True)
class Evidence(InWords):
    """Reason why a problem has no answer: its `kind`, and `figures`, which are numbers by name.

    Figures are attributes, too; `text` is the sentence. Kinds that prove that there is no answer
    are

    - "lengths": the target is out of reach of the links by at least so many metres, at its `place`
      whatever its orientation, `turned` together with it, or off the `plane` of the system;
    - "tilted": by an `angle` out of the plane of the system;
    - "outside": all `count` configurations that reach it are outside limits, or slides end `short`
      metres before it;
    - "contradiction": tasks `first` and `second` exclude each other by `off` metres or radians;
    - "no root": no angle of a `joint` brings what `axes` keep to where it must be, by `off` metres
      or radians;
    - "short links": in the loop of a `joint` the `longest` link is longer than all `others` together.
    """

    kind: str
    figures: Mapping[str, Any]

    @property
    def proof(self) -> bool:
        """Whether the evidence proves that there is no answer; otherwise it is a hint."""
        from kempe.answers.wording import PROOFS  # only here: a success needs no sentences

        return self.kind in PROOFS

    @property
    def text(self) -> str:
        """Sentence that explains the evidence."""
        from kempe.answers.wording import FOUND_OUT, PROOFS

        sentence = PROOFS.get(self.kind) or FOUND_OUT[self.kind]
        return (sentence.format if isinstance(sentence, str) else sentence)(**self.figures)

    def __str__(self) -> str:
        return self.text

    def __getattr__(self, name: str) -> Any:
        if name in Evidence.__slots__ or name not in self.figures:
            return object.__getattribute__(self, name)  # the error as it is of any object
        return self.figures[name]


def make_evidence(kind: str, **figures: Any) -> Evidence:
    """Make evidence of a kind with its figures."""
    return Evidence(kind, figures)


def make_reach_evidence(
    system: Model,
    place: float = 0.0,
    turned: float = 0.0,
    plane: float = 0.0,
    task: str = "",
    point: bool = False,
    slides: Sequence[str] = (),
) -> Evidence | None:
    """Make evidence that a target is out of reach by so many metres; None if all are zero.

    Its figure `times` is the largest of them in typical lengths of a link, `point` says that the
    target is x, y, z, and `slides` names the coordinates of slides, whose limits are a reason as
    the lengths are.
    """
    far = max(place, turned, plane)
    if not far > 0.0:
        return None
    times = far / compute_characteristic_length(system)
    return make_evidence(
        "lengths",
        place=place,
        turned=turned,
        plane=plane,
        task=task,
        # only metres are what millimetres are taken for
        times=times if system.unit == METRE else 0.0,
        point=point,
        slides=list(slides),
    )


def make_loop_length_evidence(
    system: Model, known: Mapping[str, float], limits: bool = True
) -> Evidence | None:
    """Make evidence that lengths leave a loop open with the values of `known`; None where not."""
    from kempe.numerics.length_bounds import find_unclosable_loop  # only here: answers need none

    gap = find_unclosable_loop(system, known, limits)
    return None if gap is None else make_evidence("short links", **gap._asdict(), known=bool(known))


def make_limit_evidence(
    system: Model,
    free: Array | None,
    retry: Callable[[Array], Array | None] | None = None,
    **figures: Any,
) -> Evidence | None:
    """Make evidence from a configuration `free` (nq,) that was found without limits; None for none.

    It names the limits that `free` violates. Where it violates none, more starts find an answer.
    Whole turns of angles do not count, unless `retry`, a search with limits that starts at `free`,
    finds nothing.
    """
    if free is None:
        return None
    names = list_limit_violations(system, free)
    if not names and retry is not None and retry(free) is None:
        names = list_limit_violations(system, free, turns=False)
    return (
        make_evidence("limits", names=names, **figures) if names else make_evidence("more starts")
    )


def make_one_sided_evidence(rows: OneSided, free: Array | None, **figures: Any) -> Evidence | None:
    """Make evidence from a configuration `free` that was found without one-sided constraints.

    It names the constraints that `free` violates; None where it violates none.
    """
    violated = [] if free is None else [v.text for v in rows.list_violations(free)]
    return make_evidence("one-sided", violated=violated, **figures) if violated else None


def list_limit_violations(
    system: Model, q: Array, slack: float = 1e-9, turns: bool = True
) -> list[str]:
    """List the names of the coordinates that violate their limits at q (nq,) by more than `slack`.

    With `turns`, whole turns are added to angles first, as far as that helps.
    """
    structure = system.structure
    names: list[str] = []
    for i, v in zip(structure.layout.vector_q, structure.layout.vector_v, strict=True):
        low = system.lower[v]
        high = system.upper[v]
        x = q[i]
        if turns and structure.coordinates.turning[v]:
            x -= 2.0 * np.pi * np.ceil((x - high) / (2.0 * np.pi)) if x > high else 0.0
            x += 2.0 * np.pi * np.ceil((low - x) / (2.0 * np.pi)) if x < low else 0.0
        if not low - slack <= x <= high + slack:
            names.append(structure.velocity_names[int(v)])
    return names
