"""Dimensions of a sketch that are typed: the other lengths, the ground and the sliders stay."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from kempe.errors import InputError
from kempe.numerics.newton import solve_least_squares
from kempe.spatial import Array
from kempe.views.sketch.sketch import GROUND, SAME_PLACE, Sketch

SMALL = 1e-30
"""Imaginary step of derivatives: exact to rounding (Squire, Trapp, SIAM Rev. 40, 1998)."""
STEPS = 60
"""Gauss-Newton steps at most."""
PARTS = 20
"""Parts in which a change is made where it does not succeed at once."""
CLOSED = 1e-12
"""How far the equations may be open at the end, in parts of the size of the sketch."""
STRAIGHT = 1e-9
"""Distance from a line, in parts of its length, up to which a pin is on it."""

Equations = Callable[[Any], list[Any]]


def set_distance(sketch: Sketch, a: str, b: str, length: float) -> Sketch:
    """Set the distance of two pins of a bar, or of two grounded pins; pins move as little as possible.

    All other lengths of bars stay, as do grounded pins and the lines of sliders. Other pins of the
    bar keep their distances from the two, or, on the line through the two, their part of it.
    Errors: `InputError` where this is impossible.
    """
    if not (math.isfinite(length) and length > SAME_PLACE):
        raise InputError(f"a length is {length:g} {sketch.unit}; it must be more than 0")
    for pin in (a, b):
        if pin not in sketch.pins:
            raise InputError(f"there is no pin {pin}")
    fixed = {a, b} <= sketch.grounded
    bar = sketch.find_bar(a, b)
    if bar is None and not fixed:
        raise InputError(
            f"{a} and {b} belong to no bar together: their distance follows from other dimensions"
        )
    held = {*sketch.grounded} - ({b} if fixed else set[str]())
    first = sketch.measure_distance(a, b)
    for count in (1, PARTS):
        moved = sketch
        for part in np.linspace(0.0, 1.0, count + 1)[1:]:
            reached = _solve(moved, held, (a, b), first + float(part) * (length - first))
            if reached is None:
                break
            moved = reached
        else:
            return moved
    what = f"bar {bar}" if bar is not None else f"the ground between {a} and {b}"
    raise InputError(
        f"{what} cannot be {length:g} {sketch.unit} long: the other bars, which keep their lengths, do not close "
        "with it"
    )


def _solve(sketch: Sketch, held: set[str], pair: tuple[str, str], length: float) -> Sketch | None:
    """Find the places of pins nearby at which a pair has its distance; None where there are none."""
    names = list(sketch.pins)
    free = [k for k, pin in enumerate(names) if pin not in held]
    xy = np.array([sketch.pins[pin] for pin in names], dtype=float)
    write = _list_equations(sketch, pair, length)
    size = max(float(np.ptp(xy, axis=0).max(initial=0.0)), length)
    if {*pair} <= sketch.grounded:  # the second goes along the line of the two
        k, other = names.index(pair[1]), xy[names.index(pair[0])]
        xy[k] = other + (xy[k] - other) * (length / np.linalg.norm(xy[k] - other))
        free.remove(k)
    spots = [(k, axis) for k in free for axis in (0, 1)]
    for _ in range(STEPS):
        residual, slopes = _differentiate(write, names, xy, spots)
        if np.abs(residual).max(initial=0.0) <= CLOSED * size:
            return _keep_changes(sketch, names, xy)
        step = solve_least_squares(slopes, -residual)
        if not np.isfinite(step).all():
            return None
        step *= min(1.0, 0.2 * size / max(float(np.abs(step).max(initial=0.0)), 1e-300))
        for (k, axis), by in zip(spots, step.tolist(), strict=True):
            xy[k, axis] += by
    return None


def _keep_changes(sketch: Sketch, names: list[str], xy: Array) -> Sketch | None:
    """Place the pins that have moved; None where two pins of a bar fall together."""
    places = {
        pin: (float(x), float(y))
        for pin, (x, y) in zip(names, xy, strict=True)
        if (float(x), float(y)) != sketch.pins[pin]
    }
    try:
        return sketch.place_pins(places)
    except InputError:
        return None


def _differentiate(
    write: Equations, names: list[str], xy: Array, spots: list[tuple[int, int]]
) -> tuple[Array, Array]:
    """Compute the equations at places (n, 2), and their derivatives by the coordinates `spots`."""
    z = xy.astype(complex)
    residual = np.array([complex(r).real for r in write(dict(zip(names, z, strict=True)))])
    slopes = np.zeros((len(residual), len(spots)))
    for column, (k, axis) in enumerate(spots):
        z[k, axis] += SMALL * 1j
        rows = write(dict(zip(names, z, strict=True)))
        slopes[:, column] = [complex(r).imag / SMALL for r in rows]
        z[k, axis] = xy[k, axis]
    return residual, slopes


def _list_equations(sketch: Sketch, pair: tuple[str, str], length: float) -> Equations:
    """Return the function that writes the equations: what must be zero for places of all pins."""

    def measure(a: str, b: str) -> float:
        return sketch.measure_distance(a, b)

    distances = dict[tuple[str, str], float]()
    shapes = list[tuple[str, str, str, complex]]()
    at = {pin: complex(*place) for pin, place in sketch.pins.items()}
    for pins in sketch.bars.values():
        changed = {*pair} <= {*pins}
        a, b = pair if changed else pins[:2]
        distances[a, b] = length if changed else measure(a, b)
        for pin in pins:
            if pin in (a, b):
                continue
            z = (at[pin] - at[a]) / (at[b] - at[a])
            if changed and abs(z.imag) > STRAIGHT:
                distances[a, pin] = measure(a, pin)
                distances[b, pin] = measure(b, pin)
            else:
                shapes.append((a, b, pin, z))
    lines = list[tuple[str, str, str, complex, complex]]()
    for pin, slider in sketch.sliders.items():
        way = complex(math.cos(slider.angle), math.sin(slider.angle))
        if slider.carrier == GROUND:
            lines.append((pin, "", "", at[pin], way))
        else:
            a, b = sketch.bars[slider.carrier][:2]
            along = at[b] - at[a]
            along /= abs(along)
            lines.append((pin, a, b, (at[pin] - at[a]) / along, way / along))

    def write(p: Any) -> list[Any]:
        """Write the equations at places of the pins, two numbers each."""
        rows = list[Any]()
        for (a, b), wanted in distances.items():
            x, y = p[b] - p[a]
            rows.append(((x * x + y * y) - wanted**2) / (2.0 * wanted))
        for a, b, pin, z in shapes:
            x, y = p[b] - p[a]
            u, v = p[pin] - p[a]
            rows += [u - (z.real * x - z.imag * y), v - (z.real * y + z.imag * x)]
        for pin, a, b, first, way in lines:
            x, y = p[pin] if not a else _turn_into(p[pin] - p[a], p[b] - p[a])
            rows.append(way.real * (y - first.imag) - way.imag * (x - first.real))
        return rows

    return write


def _turn_into(v: Any, along: Any) -> tuple[Any, Any]:
    """Return the parts of a vector along another one, and across it."""
    x, y = along
    far = (x * x + y * y) ** 0.5
    return (v[0] * x + v[1] * y) / far, (v[1] * x - v[0] * y) / far
