"""Systems converted to metres, for other libraries and for steps that compare lengths with angles."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe.description.length_units import convert_to_metres
from kempe.model.configurations import list_units, read_q
from kempe.model.model import keep_answers
from kempe.spatial import Array
from kempe.units import METRE, METRES, scale_lengths

if TYPE_CHECKING:
    from kempe.model.model import Model


class InMetres:
    """A system in metres, and conversions of its configurations and velocities.

    A system that declares no other unit is left alone.
    """

    def __init__(self, system: Model):
        self.given = system
        self.system = system
        if system.unit == METRE:
            return
        made: Any = type(system)
        self.system = made(convert_to_metres(system.mechanism))
        self._factor = METRES[system.unit]
        unit = list_units(system)
        self._q = [k for k, n in enumerate(system.coordinate_names) if unit[n] == system.unit]
        names = system.structure.velocity_names
        self._v = [k for k, n in enumerate(names) if unit[n] == system.unit]

    def read_q(self, q: Any, read: Callable[[Model, Any], Array] = read_q) -> Array:
        """Read configurations (..., nq) of the given system, and return them in metres."""
        return self._scale(read(self.given, q), "_q", 1)

    def write_q(self, q: Array) -> Array:
        """Return configurations (..., nq) in the unit of the given system."""
        return self._scale(q, "_q", -1)

    def convert_v(self, v: Array) -> Array:
        """Return velocities (..., nv) of the given system in metres per second."""
        return self._scale(v, "_v", 1)

    def write_v(self, v: Array) -> Array:
        """Return velocities (..., nv) in the unit of the given system."""
        return self._scale(v, "_v", -1)

    def _scale(self, x: Array, slides: str, power: int) -> Array:
        """Return numbers (..., n) by coordinate with those of slides multiplied."""
        if self.system is self.given:
            return x
        out = np.array(x)
        at = getattr(self, slides)
        out[..., at] = scale_lengths(out[..., at], self._factor**power)
        return out


@keep_answers
def convert_system_to_metres(system: Model) -> InMetres:
    """Convert a system to metres. Errors: `InputError` if it has parts that cannot be converted."""
    return InMetres(system)
