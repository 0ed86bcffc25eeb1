"""Pictures of maps: fractions that are reached, in colours that read in grey."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from kempe.errors import UnsupportedError

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from kempe.analysis.spaces.reach.base_placement import BasePlacement
    from kempe.analysis.spaces.reach.capability import CapabilityMap
    from kempe.spatial import Array


def _picture(ax: Axes | None, x: Array, y: Array, values: Array, labels: tuple[str, str]) -> Axes:
    import matplotlib.pyplot as plt

    ax = plt.subplots()[1] if ax is None else ax
    drawn = ax.pcolormesh(x, y, values.T, vmin=0.0, vmax=1.0, cmap="viridis", shading="nearest")
    ax.figure.colorbar(drawn, ax=ax, label="fraction reached")
    ax.set_xlabel(labels[0])
    ax.set_ylabel(labels[1])
    return ax


def plot_placement(found: BasePlacement, ax: Axes | None = None) -> Axes:
    """Matplotlib axes with the fraction over the first two axes, the others where they are at the best place."""
    names = list(found.axes)
    if len(names) < 2:
        raise UnsupportedError(f"a map over {names[0]!r} alone has no picture: plot its fraction")
    index = np.unravel_index(found.order[0], found.fraction.shape)
    units = [f"{n} [{'rad' if n == 'yaw' else 'm'}]" for n in names]
    x, y = (found.axes[n] for n in names[:2])
    ax = _picture(ax, x, y, found.fraction[(slice(None), slice(None), *index[2:])], (units[0], units[1]))
    ax.plot(x[index[0]], y[index[1]], "o", color="white", markeredgecolor="black", label="best place")
    ax.legend(loc="upper right")
    if names[:2] == ["x", "y"]:
        ax.set_aspect("equal")
    return ax


def plot_capability(found: CapabilityMap, ax: Axes | None = None, height: float | None = None) -> Axes:
    """Matplotlib axes with the fraction over x and y, at the layer of cells nearest to a height (the middle)."""
    values, title = found.fraction, found.frame
    if len(found.axes) == 3:
        z = found.axes[2]
        k = len(z) // 2 if height is None else int(np.argmin(np.abs(z - height)))
        values, title = values[..., k], f"{title}, z = {z[k]:.3g} m"
    ax = _picture(ax, found.axes[0], found.axes[1], values, ("x [m]", "y [m]"))
    ax.set_aspect("equal")
    ax.set_title(title)
    return ax
