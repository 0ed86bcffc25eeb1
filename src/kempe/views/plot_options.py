"""Options of `System.plot`, declared once, with the allowed values."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from kempe.arguments import read_flag, read_names
from kempe.arrays import is_whole
from kempe.errors import InputError, format_value

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from kempe.model.model import FrameLike

LABELS = ("joints", "frames", "bodies", "coordinates", "parameters")
"""What can be written beside what is drawn; the first two are, unless `labels` says otherwise."""


@dataclass(frozen=True)
class PlotOptions:
    """Options of a picture of a system.

    Parameters
    ----------
    frames
        Names of frames whose axes are drawn without labels; over a path, frames whose curves are
        drawn. None stands for all.
    labels
        True for the names of joints and frames, False for none, or words of `LABELS` ("all" for
        all): names of "bodies" in their colour, values of "coordinates", "parameters" with their
        numbers.
    axes
        Names of bodies and frames whose axes are drawn and named (x_0, y_0, ...), or "all".
    angles
        Draw arcs and lengths of the coordinates. With the name of a frame of a planar chain, also
        the angles alpha and beta of the line to the frame.
    dimensions
        Draw lengths of the links with their parameters.
    motion
        Draw arrows for the freedoms of each joint, and neighbouring positions.
    workspace
        Frame of a planar chain whose workspace is shaded.
    ghosts
        Number of earlier positions of a path.
    side_by_side
        Draw several configurations in axes of their own, in place of one over the other.
    titles
        Names of the configurations, in place of those that the answer gives them.
    ax
        Matplotlib axes (default: new ones).

    Raises
    ------
    InputError
        For values that are not allowed.
    """

    frames: Iterable[Any] | FrameLike | None = ()
    labels: bool | str | Iterable[str] = True
    axes: str | Iterable[Any] = ()
    angles: bool | FrameLike = False
    dimensions: bool = False
    motion: bool = False
    workspace: FrameLike | None = None
    ghosts: int = 0
    side_by_side: bool = False
    titles: Iterable[str] = ()
    ax: Axes | Any = None

    def __post_init__(self) -> None:
        for name in ("dimensions", "motion", "side_by_side"):
            read_flag(getattr(self, name), name)
        if not is_whole(self.ghosts) or self.ghosts < 0:
            raise InputError(
                f"ghosts is {format_value(self.ghosts)}; it must be a whole number, not negative"
            )
        unknown = [word for word in self.words if word not in LABELS]
        if unknown:
            allowed = ", ".join(map(repr, LABELS))
            raise InputError(
                f"labels has {unknown[0]!r}; allowed are {allowed}, 'all', True and False"
            )
        read_names(self.titles, "titles")

    @property
    def words(self) -> frozenset[str]:
        """Kinds of labels to be written, as words of `LABELS`."""
        if isinstance(self.labels, bool):
            return frozenset(LABELS[:2]) if self.labels else frozenset()
        every = isinstance(self.labels, str) and self.labels == "all"
        return frozenset(LABELS if every else read_names(self.labels, "labels"))
