"""Methods of `System` by which it is looked at: pictures, motions, pages."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from numpy.typing import ArrayLike

from kempe.budget import Budget
from kempe.calls import explained, quiet, with_options
from kempe.model.compiled_system import FrameLike
from kempe.model.plot_options import PlotOptions

if TYPE_CHECKING:
    from pathlib import Path as FilePath

    from matplotlib.axes import Axes

    from kempe.views.viewer.live import Viewer


class Pictured:
    """What a system looks like. Base of `System`."""

    @explained
    @with_options(PlotOptions)
    def plot(self: Any, q: Any = None, *, path: Any = None, **options: Any) -> Any:
        """Matplotlib axes with a drawing of the system at one or several configurations, or along a
        motion.

        See `kempe.views.plots.plot` for what is drawn, `kempe.model.plot_options.PlotOptions` for
        the options.
        """
        from kempe.views.plots import plot

        return plot(self, q, path=path, **options)

    @explained
    def animate(
        self: Any,
        path: Any,
        file: str | FilePath,
        *,
        frames: Any = (),
        labels: Any = False,
        seconds: float = 4.0,
        fps: float = 15.0,
    ) -> FilePath:
        """Write a motion as a moving picture (.gif, .mp4, .html); see `kempe.views.films.animate`."""
        from kempe.views.films import animate

        return animate(self, path, file, frames=frames, labels=labels, seconds=seconds, fps=fps)

    @explained
    def show(
        self: Any,
        q: Any = None,
        *,
        frame: FrameLike | None = None,
        path: Any = None,
        share: bool = False,
        port: int | None = None,
        browser: bool = True,
        deg: bool = False,
    ) -> Viewer:
        """A page on this machine in which the system can be moved; see
        `kempe.views.viewer.live.show`.
        """
        from kempe.views.viewer.live import show

        return show(
            self, q, frame=frame, path=path, share=share, port=port, browser=browser, deg=deg
        )

    @explained
    def save_html(
        self: Any, file: str | FilePath, q: Any = None, *, path: Any = None, seconds: float = 6.0
    ) -> None:
        """Write a page that needs no server, with the system in space, moving; see
        `kempe.views.viewer.pages`.
        """
        from kempe.views.viewer.pages import save_html

        return save_html(self, file, q, path=path, seconds=seconds)

    @explained
    def plot_tree(self: Any, ax: Axes | None = None) -> Axes:
        """Matplotlib axes with the tree of bodies and joints; see
        `kempe.views.overviews.plot_tree`.
        """
        from kempe.views.overviews import plot_tree

        return plot_tree(self, ax)

    @quiet
    def _repr_html_(self: Any) -> str:
        """The system in a notebook: a picture, its freedoms, its tree."""
        from kempe.views.overviews import notebook_page

        return notebook_page(self)

    @explained
    def plot_spaces(
        self: Any,
        frame: FrameLike,
        *,
        points: ArrayLike = (),
        task: str | None = None,
        grid: bool = False,
        ax: Any = None,
        resolution: int = 240,
        budget: Budget | None = None,
    ) -> tuple[Axes, Axes]:
        """Pictures of configuration space and task space beside one another; see
        `kempe.views.space_pictures`.
        """
        from kempe.views.space_pictures import plot_spaces

        return plot_spaces(
            self,
            frame,
            points=points,
            task=task,
            grid=grid,
            ax=ax,
            resolution=resolution,
            budget=budget,
        )
