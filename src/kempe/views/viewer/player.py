"""The slider and the button of a page with which a motion is played, and the buttons that find one."""

from __future__ import annotations

import threading
import time
from typing import TYPE_CHECKING, Any

from kempe.views.viewer.motions import possible

if TYPE_CHECKING:
    from kempe.views.viewer.live_page import Page

FRAMES = 30.0
"""Frames a second of a motion that is played."""


class Player:
    """What a page shows of motions; `motion` is the one that its slider is for."""

    def __init__(self, page: Page):
        self.page = page
        self.motion = page.session.motion
        self.playing = False
        gui = page.client.gui
        with gui.add_folder("motion") as self.folder:
            self.finds: Any = None
            self.time: Any = None
            self.play = gui.add_button("play", color="gray", visible=False)
        self.play.on_click(self._pressed)
        self.make_finds()
        self.make_time()

    def make_finds(self) -> None:
        """Make the buttons that find motions, where the frame and what counts of it allow any."""
        if self.finds is not None:
            self.finds.remove()
        page = self.page
        names = possible(page.session)
        with self.folder:
            self.finds = (
                page.buttons("find", {n: lambda n=n: page.find(n) for n in names})
                if names
                else None
            )
        self.folder.visible = bool(names) or page.session.motion is not None

    def make_time(self) -> None:
        """Make the slider of the motion that is played."""
        page = self.page
        self.motion = motion = page.session.motion
        if motion is None:
            return
        if self.time is not None:
            self.time.remove()
        label, last = ("time [s]", motion.duration) if motion.timed else ("part", 1.0)
        with self.folder:
            self.time = page.client.gui.add_slider(
                label, 0.0, last, last / 1000.0, 0.0, order=self.play.order - 0.5
            )
        scale = motion.duration / last
        self.time.on_update(
            page.by_hand("time", lambda h=self.time: page.session.at(scale * h.value))
        )
        self.folder.visible = self.play.visible = True

    async def _pressed(self, event: Any) -> None:
        self.playing = not self.playing
        self.play.label = "stop" if self.playing else "play"
        if self.playing:
            threading.Thread(target=self._run, daemon=True).start()

    def _run(self) -> None:
        page = self.page
        bar = self.time
        motion = self.motion
        if motion is None:
            return
        part = bar.value if bar.value < bar.max else 0.0
        while self.playing and page.open and bar is self.time:
            part = (part + bar.max / (motion.duration * FRAMES)) % bar.max

            def there(x: float = part) -> None:
                page.session.at(x * motion.duration / bar.max)
                bar.value = x

            page.post("play", there)
            time.sleep(1.0 / FRAMES)
        self.playing = False
        if page.open:
            self.play.label = "play"
