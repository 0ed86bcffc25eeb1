"""A picture of a planar workspace."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from kempe.analysis.spaces.planar.plane_curves import PlanePiece

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.path import Path

    from kempe.analysis.spaces.planar.planar_workspace import PlanarWorkspace, SolutionRegion

FINE = 0.02
"""Angle between the points by which an arc is drawn."""


def plot(workspace: PlanarWorkspace, ax: Axes | None = None) -> Axes:
    """Matplotlib axes with the regions, darker where there are more solutions, and the boundary."""
    import matplotlib.pyplot as plt
    from matplotlib.patches import PathPatch

    ax = plt.subplots()[1] if ax is None else ax
    for region in workspace.regions:
        shade = 0.8 if region.solutions in (None, 1) else 0.6
        label = "reached" if region.solutions is None else f"{region.solutions} solution{'s' * (region.solutions > 1)}"
        ax.add_patch(PathPatch(outline(region), facecolor=(0.9 * shade, shade, 1.0), edgecolor="none", label=label))
    for piece in workspace.boundary:
        p = drawn(piece)
        ax.plot(np.real(p), np.imag(p), color="0.15", linewidth=1.2)
    ax.set_aspect("equal")
    ax.set_xlabel("x [m]")
    ax.set_ylabel("y [m]")
    ax.set_title(f"{workspace.frame}: {workspace.area:.4g} m²")
    if workspace.regions:
        ax.legend(loc="upper left", bbox_to_anchor=(1.02, 1.0), frameon=False)
    return ax


def outline(region: SolutionRegion) -> Path:
    """The closed curves round a region, as one path."""
    from matplotlib.path import Path

    corners, codes = [], []
    for loop in region.loops:
        p = np.concatenate([drawn(piece) for piece in loop])
        corners.append(np.column_stack([np.real(p), np.imag(p)]))
        codes += [Path.MOVETO, *[Path.LINETO] * (len(p) - 2), Path.CLOSEPOLY]
    return Path(np.concatenate(corners), codes)


def drawn(piece: PlanePiece) -> np.ndarray:
    """Points (k,) along a piece, close enough for a picture."""
    return piece.at(np.linspace(0.0, 1.0, max(2, int(abs(piece.sweep) / FINE) + 2)))
