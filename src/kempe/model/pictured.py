"""Methods of `System` by which it is looked at: pictures, motions, pages."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, cast

from numpy.typing import ArrayLike

from kempe.calls import explained, with_options
from kempe.model.compiled_system import FrameLike
from kempe.model.plot_options import PlotOptions

if TYPE_CHECKING:
    from pathlib import Path as FilePath

    from matplotlib.axes import Axes

    from kempe.model.system import System


class Pictured:
    """What a system looks like. Base of `System`."""

    @explained
    @with_options(PlotOptions)
    def plot(self, q: Any = None, *, path: Any = None, **options: Any) -> Any:
        """Matplotlib axes with a drawing of the system at one or several configurations, or along a motion.

        See `kempe.views.plots.plot` for what is drawn, `kempe.model.plot_options.PlotOptions` for the options.
        """
        from kempe.views.plots import plot

        return plot(cast("System", self), q, path=path, **options)

    @explained
    def animate(
        self, path: Any, file: str | FilePath, *, frames: Any = (), labels: Any = False, seconds: float = 4.0,
        fps: float = 15.0,
    ) -> FilePath:  # fmt: skip
        """Write a motion as a moving picture (.gif, .mp4, .html); see `kempe.views.films.animate`."""
        from kempe.views.films import animate

        return animate(cast("System", self), path, file, frames=frames, labels=labels, seconds=seconds, fps=fps)

    @explained
    def plot_tree(self, ax: Axes | None = None) -> Axes:
        """Matplotlib axes with the tree of bodies and joints; see `kempe.views.overviews.plot_tree`."""
        from kempe.views.overviews import plot_tree

        return plot_tree(cast("System", self), ax)

    def _repr_html_(self) -> str:
        """The system in a notebook: a picture, its freedoms, its tree."""
        from kempe.views.overviews import notebook_page

        return notebook_page(cast("System", self))

    @explained
    def plot_spaces(
        self, frame: FrameLike, *, points: ArrayLike = (), ax: Any = None, resolution: int = 240
    ) -> tuple[Axes, Axes]:  # fmt: skip
        """Pictures of configuration space and task space beside one another; see `kempe.views.space_pictures`."""
        from kempe.views.space_pictures import plot_spaces

        return plot_spaces(cast("System", self), frame, points=points, ax=ax, resolution=resolution)
