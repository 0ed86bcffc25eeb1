"""The drawing board in a browser, by mouse and keys only.

`PYTHONPATH=src:tests python tests/views/test_board.py` writes the picture of the documents.
"""

from __future__ import annotations

import io
import time
from pathlib import Path

import numpy as np
import pytest
from chromium import draw_plainly, project_point

import kempe
from kempe.views.sketch.reading import read_sketch
from kempe.views.viewer.board import Board

SOON = 300.0
"""Seconds after which what is waited for does not come."""


class Drawer:
    """A page of a drawing board, and the mouse over its plane."""

    def __init__(self, browser, board, wide=1200, high=1100):
        draw_plainly(board.server)
        self.tab = browser.new_page(viewport={"width": wide, "height": high})
        self.requests = []
        self.tab.on("request", lambda r: self.requests.append(r.url))
        self.tab.goto(board.url)
        assert self.until(lambda: board.pages)
        self.page = next(iter(board.pages.values()))
        self.tab.get_by_text("select", exact=True).wait_for()
        self.tab.add_style_tag(content=".mantine-Notification-root {display: none}")
        assert self.until(lambda: len(self.page.placed) > 0)
        self.tab.wait_for_timeout(1500)

    @property
    def sketch(self):
        return self.page.history.state

    def until(self, what, soon=SOON):
        end = time.monotonic() + soon
        while not what() and time.monotonic() < end:
            self.tab.wait_for_timeout(50)
        return bool(what())

    def at(self, x, y):
        return project_point(self.tab, self.page.client.camera, (x, y, 0.0))

    def answered(self, act):
        """Do something, and wait until the page has answered an event and is at rest."""
        before = self.page.answered
        act()
        assert self.until(lambda: self.page.answered > before)
        # what the page was sent before the new title has arrived with it: the fields are the new ones
        title = f"drawing board after {self.page.answered}"
        self.page.client.gui.set_panel_label(title)
        self.tab.get_by_text(title, exact=True).wait_for(timeout=1e3 * SOON)

    def click(self, *places):
        for place in places:
            self.answered(lambda p=place: self.tab.mouse.click(*self.at(*p)))

    def press(self, text):
        button = self.tab.get_by_text(text, exact=True).first
        button.scroll_into_view_if_needed()
        self.answered(button.click)

    def drag(self, a, b):
        self.tab.mouse.move(*self.at(*a))
        self.tab.mouse.down()
        for t in np.linspace(0.2, 1.0, 5):
            self.tab.mouse.move(*self.at(*(np.array(a) + t * np.subtract(b, a))))
            self.tab.wait_for_timeout(80)
        self.answered(self.tab.mouse.up)

    def type_into(self, label, text):
        """Type a value into the field with a label."""
        field = self.tab.get_by_label(label, exact=True)
        if not field.count():
            row = self.tab.get_by_text(label, exact=True).last
            box = row.bounding_box()
            inputs = self.tab.locator("input").all()
            middle = box["y"] + 0.5 * box["height"]

            def off(one):
                own = one.bounding_box()
                return abs(own["y"] + 0.5 * own["height"] - middle) if own else np.inf

            field = min(inputs, key=off)
        field.click()
        self.tab.keyboard.press("Control+a")
        self.answered(lambda: self.tab.keyboard.type(text))
        self.tab.wait_for_timeout(500)

    def says(self, text):
        return self.until(lambda: text in self.page.sentence.content)

    def draw_four_bar(self):
        """By clicks: the bars, a coupler point, the ground, the crank."""
        self.press("bar")
        self.click((-0.3, 0), (-0.3, 0.1), (0.2, 0.4), (0.3, 0), (0.3, 0))
        self.click((0.0, 0.28), (0.0, 0.5))
        self.press("ground")
        self.click((-0.3, 0), (0.3, 0))
        self.press("crank")
        self.click((-0.3, 0.05))


@pytest.mark.slow
def test_a_four_bar_drawn_by_mouse_traces_the_curve_of_the_closed_form(browser):
    with Board(port=0) as board:
        seen = Drawer(browser, board)
        assert seen.says("Click in the plane to place pins")
        seen.draw_four_bar()
        assert {*seen.sketch.bars} == {"AB", "BCE", "CD"}
        assert seen.sketch.grounded == {"A", "D"} and seen.sketch.crank == ("A", "AB")
        assert seen.says("1 degree of freedom") and seen.says("Crank-rocker")
        seen.press("play")
        assert seen.until(lambda: seen.page.playing)
        motion = seen.page.motion
        A, B, C, D, E = (complex(*seen.sketch.pins[p]) for p in "ABCDE")
        b = motion.compute_places("B") @ [1, 1j]
        away = np.abs(D - b)
        along = (away**2 + abs(C - B) ** 2 - abs(D - C) ** 2) / (2 * away)
        c = b + (D - b) / away * (along + 1j * np.sqrt(abs(C - B) ** 2 - along**2))
        e = b + (c - b) * (E - B) / (C - B)
        (curve,) = seen.page.curves
        drawn = curve.points[:, 0, :2] @ [1, 1j]
        assert np.abs(drawn - e).max() < 1e-6  # single precision
        assert np.ptp(np.unwrap(np.angle(b - A))) > 6.2
        passed = set()
        assert seen.until(lambda: passed.add(seen.page.frame) or len(passed) > 10)
        frame, _, _ = seen.page.bodies["AB"]
        assert not np.allclose(frame.wxyz, (1, 0, 0, 0))
        seen.press("stop")
        assert not seen.page.playing
        assert np.allclose(seen.page.bodies["AB"][0].wxyz, (1, 0, 0, 0))
        own = (board.url, board.url.replace("http", "ws"), "data:", "blob:")
        assert all(url.startswith(own) for url in seen.requests)
        seen.tab.close()


@pytest.mark.slow
def test_a_mechanism_in_millimetres_is_gone_on_with(browser):
    """Its numbers are those of the file; a pin that is dragged stands on the grid of its size."""
    sketch, _ = read_sketch(kempe.load("four_bar", unit="mm"))
    with Board(sketch, port=0) as board:
        seen = Drawer(browser, board)
        assert seen.says("1 degree of freedom") and seen.says("The crank is bar crank")
        assert seen.tab.get_by_text("grid [mm]", exact=True).count()
        x, y = seen.sketch.pins["coupler_point"]
        assert board.cell == 50.0 and max(abs(x), abs(y)) > 100.0
        seen.drag((x, y), (x + 230.0, y + 40.0))
        at = np.array(seen.sketch.pins["coupler_point"])
        assert np.allclose(at, 50.0 * np.round(at / 50.0))
        assert np.abs(at - (x + 230.0, y + 40.0)).max() < 30.0
        seen.press("select")
        seen.click(seen.sketch.pins["A"])
        assert seen.until(seen.tab.get_by_text("D to A [mm]", exact=True).count)
        seen.press("play")
        assert seen.until(lambda: seen.page.playing)
        seen.tab.close()


@pytest.mark.slow
def test_a_slider_crank_is_drawn_and_what_cannot_be_played_is_refused(browser):
    with Board(port=0) as board:
        seen = Drawer(browser, board)
        seen.press("bar")
        seen.click((-0.3, 0), (-0.3, 0.1), (0.2, 0))
        seen.press("ground")
        seen.click((-0.3, 0))
        seen.press("crank")
        seen.click((-0.3, 0.05))
        assert seen.says("2 degrees of freedom")
        seen.press("play")
        assert seen.until(lambda: "1 degree of freedom, and this has 2" in seen.page.hint.content)
        assert not seen.page.playing
        seen.click((-0.05, 0.05))
        assert "none of its pins is grounded" in seen.page.hint.content
        seen.press("slider")
        seen.click((0.2, 0))
        assert seen.sketch.sliders == {"C": (0.0, "ground")} and seen.says("1 degree of freedom")
        seen.tab.keyboard.press("Space")
        assert seen.until(lambda: seen.page.playing)
        c = seen.page.motion.compute_places("C")
        b = seen.page.motion.compute_places("B")
        x = b[:, 0] + np.sqrt(0.26 - b[:, 1] ** 2)
        assert np.allclose(c, np.column_stack([x, 0 * x]), rtol=0, atol=1e-10)
        seen.tab.close()


@pytest.mark.slow
def test_pins_are_dragged_named_dimensioned_deleted_and_all_is_undone(browser):
    with Board(port=0) as board:
        seen = Drawer(browser, board)
        seen.draw_four_bar()
        drawn = seen.sketch
        seen.press("select")
        seen.drag((0.2, 0.4), (0.3, 0.5))
        assert seen.sketch.pins["C"] == (0.3, 0.5)
        moved = seen.sketch
        seen.click((-0.3, 0.05))
        seen.type_into("A to B [m]", "0.12")
        assert seen.sketch.measure_distance("A", "B") == pytest.approx(0.12, abs=1e-9)
        assert seen.sketch.measure_distance("C", "D") == pytest.approx(
            moved.measure_distance("C", "D"), abs=1e-9
        )
        typed = seen.sketch
        seen.type_into("A to B [m]", "9")
        assert "bar AB cannot be 9 m long" in seen.page.hint.content
        assert seen.sketch.measure_distance("C", "D") == pytest.approx(
            moved.measure_distance("C", "D"), abs=1e-9
        )
        seen.click((0.3, 0))
        seen.type_into("name", "pivot")
        assert "pivot" in seen.sketch.pins and "C-pivot" in seen.sketch.bars
        named = seen.sketch
        seen.press("delete")
        seen.click((0.3, 0))
        assert {*seen.sketch.bars} == {"AB", "BCE"} and "pivot" not in seen.sketch.pins
        assert seen.says("2 degrees of freedom")
        for before in (named, typed, moved, drawn):
            seen.press("undo")
            assert seen.until(lambda wanted=before: seen.sketch == wanted, 10.0), before
        seen.press("redo")
        assert seen.sketch == moved
        seen.tab.close()


@pytest.mark.slow
def test_the_mechanism_is_copied_and_saved(browser, tmp_path):
    with Board(port=0) as board:
        seen = Drawer(browser, board)
        seen.tab.context.grant_permissions(["clipboard-read", "clipboard-write"])
        seen.press("save")
        assert "Click in the plane" in seen.page.hint.content
        seen.draw_four_bar()
        with seen.tab.expect_download() as download:
            seen.press("save")
        download.value.save_as(tmp_path / "sketch.toml")
        system = kempe.load(tmp_path / "sketch.toml")
        assert system.mobility(system.neutral).dof == 1
        copied = "() => navigator.clipboard.readText()"
        seen.press("as TOML")
        assert seen.until(
            lambda: seen.tab.evaluate(copied) == (tmp_path / "sketch.toml").read_text()
        )
        seen.press("as Python")
        assert seen.until(lambda: seen.tab.evaluate(copied).startswith("import kempe"))
        scope = {}
        exec(seen.tab.evaluate(copied), scope)
        assert scope["system"] == system
        seen.tab.close()


PICTURE = Path(__file__).parents[2] / "docs" / "_static" / "draw.png"
"""Picture of the board in the documents."""

if __name__ == "__main__":
    from chromium import CHROMIUM, SOFTWARE
    from PIL import Image
    from playwright.sync_api import sync_playwright

    plain = [word for word in SOFTWARE if "scale-factor" not in word]
    with sync_playwright() as play, Board(port=0) as shown:
        drawer = Drawer(
            play.chromium.launch(executable_path=CHROMIUM, args=plain), shown, 1000, 620
        )
        drawer.draw_four_bar()
        drawer.press("play")
        assert drawer.until(lambda: drawer.page.playing)
        drawer.press("stop")
        drawer.tab.wait_for_timeout(3000)
        shot = Image.open(io.BytesIO(drawer.tab.screenshot())).convert("RGB")
        shot.quantize(64).save(PICTURE, optimize=True)
