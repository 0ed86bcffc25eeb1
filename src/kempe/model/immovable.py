"""Coordinates that limits hold still, in a sentence: many files mean no limits where they give
none.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from kempe.model.compiled_system import Compiled

SHOWN = 6
"""Names that are listed."""


def immovable(
    system: Compiled, coordinates: Iterable[int] | None = None, unstated: bool = False
) -> str:
    """Sentence that names velocity coordinates whose limits leave no motion, and why; '' where
    there are none.

    `coordinates` are their indices, all where None; `unstated` leaves out limits that the
    description gives.
    """
    low, high = system.structure.limits.T
    still = np.flatnonzero(low == high).tolist()
    if not still:
        return ""
    requested = set(still) if coordinates is None else {int(i) for i in coordinates}
    names = [system.structure.velocity_names[i] for i in still if i in requested]
    ours = {name for name, joint in system.structure.joints.items() if joint.unstated}
    ours |= {
        f.source
        for of, f in system.structure.couplings.items()
        if of in ours and f.source is not None
    }
    reported = [n for n in names if n in ours]
    given = [n for n in names if n not in ours and not unstated]
    parts: list[str] = []
    for group, why in (
        (
            reported,
            f"0..0 because the file gives no bounds; lenient_limits=True reads {_them(reported)} "
            "as unlimited",
        ),
        (given, f"lower and upper limit of {_them(given)} are the same"),
    ):
        if group:
            shown = ", ".join(map(repr, group[:SHOWN])) + (
                f", ... ({len(group)} in all)" if group[SHOWN:] else ""
            )
            parts.append(f"{shown} cannot move ({why})")
    return "; ".join(parts)


def _them(names: list[str]) -> str:
    return "it" if len(names) == 1 else "them"
