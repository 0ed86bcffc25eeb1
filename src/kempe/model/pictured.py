"""`Pictured`: the methods of `System` that show it; they call the functions of `kempe.views`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from kempe.calls import explained
from kempe.model.compiled_system import FrameLike

if TYPE_CHECKING:
    from pathlib import Path as FilePath

    from kempe.views.viewer.live import Viewer


class Pictured:
    """What shows a system; base of `System`."""

    @explained
    def show(
        self: Any, q: Any = None, *, frame: FrameLike | None = None, path: Any = None, share: bool = False,
        port: int | None = None, browser: bool = True,
    ) -> Viewer:  # fmt: skip
        """A page on this machine in which the system can be moved; see `kempe.views.viewer.live.show`."""
        from kempe.views.viewer.live import show

        return show(self, q, frame=frame, path=path, share=share, port=port, browser=browser)

    @explained
    def save_html(
        self: Any, file: str | FilePath, q: Any = None, *, path: Any = None, seconds: float = 6.0
    ) -> None:  # fmt: skip
        """Write a page that needs no server, with the system in space, moving; see `kempe.views.viewer.pages`."""
        from kempe.views.viewer.pages import save_html

        return save_html(self, file, q, path=path, seconds=seconds)
