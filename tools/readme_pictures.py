"""The moving pictures of the README: `python tools/readme_pictures.py [NAME ...]` draws them anew.

Jansen's leg with the curve of its foot, the page on which a Panda is dragged by the mouse (it needs
playwright and Chromium), and both spaces of the two-link arm. What has changed is looked at before
it is committed.
"""

from __future__ import annotations

import io
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from PIL import Image

import kempe

ROOT = Path(__file__).parents[1]
STATIC = ROOT / "docs" / "_static"
HIGH = 300
"""Pixels of a picture from top to bottom: three stand side by side."""
COLOURS = 64
READY = [0.3, -0.5, 0.2, -2.2, 0.1, 1.9, 0.9]


def write_gif(name: str, pictures: list[Image.Image], milliseconds: int) -> None:
    """Write pictures of any size as a film that starts again, with one palette."""
    small = [
        p.convert("RGB").resize((round(HIGH * p.width / p.height), HIGH), Image.Resampling.LANCZOS)
        for p in pictures
    ]
    palette = small[len(small) // 2].quantize(COLOURS)
    films = [p.quantize(palette=palette, dither=Image.Dither.NONE) for p in small]
    films[0].save(
        STATIC / f"{name}.gif",
        save_all=True,
        append_images=films[1:],
        duration=milliseconds,
        loop=0,
        optimize=True,
    )


def draw_leg() -> Iterator[Image.Image]:
    """Draw Jansen's leg during one turn of its crank."""
    leg = kempe.load("jansen")
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "leg.gif"
        leg.animate(leg.trace("O"), file, frames=["foot"], seconds=3.0, fps=15.0)
        film = Image.open(file)
        for k in range(film.n_frames):
            film.seek(k)
            yield film.convert("RGB")


def draw_spaces() -> Iterator[Image.Image]:
    """Draw both spaces of the two-link arm while its tip goes round a circle, elbow up."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    arm = kempe.load("two_link")
    angle = np.linspace(0.0, 2.0 * np.pi, 40, endpoint=False)
    tip = np.stack([0.45 + 0.25 * np.cos(angle), 0.25 * np.sin(angle)], axis=-1)
    way = arm.ik_path(tip, "e", start=[-0.5, 1.0]).q
    for q in way:
        axes = arm.plot_spaces("e", q=q)
        figure = axes[0].figure
        for ax in axes:
            legend = ax.get_legend()
            if legend is not None:
                legend.remove()
        for legend in list(figure.legends):
            legend.remove()
        axes[0].plot(*way.T, color="0.2", lw=1.0, ls=":")
        axes[1].plot(*tip.T, color="0.2", lw=1.0, ls=":")
        file = io.BytesIO()
        figure.savefig(file, format="png", dpi=80, bbox_inches="tight")
        plt.close(figure)
        yield Image.open(file)


def draw_page() -> Iterator[Image.Image]:
    """Drag the hand of a Panda on its page, then show other solutions as ghosts."""
    from playwright.sync_api import sync_playwright

    sys.path.insert(0, str(ROOT / "tests"))
    from chromium import CHROMIUM, SOFTWARE, project_point

    panda = kempe.load("panda")
    with (
        sync_playwright() as play,
        panda.show(READY, frame="panda_hand_tcp", port=0, browser=False) as viewer,
    ):
        browser = play.chromium.launch(executable_path=CHROMIUM, args=SOFTWARE[:-1])
        tab = browser.new_page(viewport={"width": 1000, "height": 640})
        tab.set_default_timeout(180_000)
        tab.goto(viewer.url)
        tab.get_by_text("random", exact=True).wait_for()
        tab.add_style_tag(content=".mantine-Notification-root {display: none}")
        tab.wait_for_timeout(5000)
        page = next(iter(viewer.pages.values()))
        camera = page.client.camera
        camera.position = camera.look_at + 0.85 * (camera.position - camera.look_at)
        tab.wait_for_timeout(3000)

        def find_arrow(k: int) -> np.ndarray:
            """Find where arrow k of the hand is on the page."""
            X = page.session.pose
            p = X[:3, 3] + 0.2 * page.nodes.drawn.rigid.size * X[:3, k]
            return np.array(project_point(tab, page.client.camera, p))

        def shoot() -> Image.Image:
            tab.wait_for_timeout(150)
            return Image.open(io.BytesIO(tab.screenshot()))

        for k, away in ((1, (-60, 15)), (2, (10, 60))):
            at = find_arrow(k)
            tab.mouse.move(*at)
            tab.mouse.down()
            for part in (1.0 - np.cos(np.linspace(0.0, 2.0 * np.pi, 17)))[1:] / 2.0:
                tab.mouse.move(*(at + part * np.array(away)))
                yield shoot()
            tab.mouse.up()
        tab.get_by_text("show", exact=True).first.click()
        tab.wait_for_timeout(2000)
        for _ in range(8):
            yield shoot()
        browser.close()


PICTURES = {
    "jansen": (draw_leg, 67),
    "page": (draw_page, 100),
    "spaces": (draw_spaces, 80),
}

if __name__ == "__main__":
    for name in sys.argv[1:] or PICTURES:
        draw, milliseconds = PICTURES[name]
        write_gif(name, list(draw()), milliseconds)
        print(name, (STATIC / f"{name}.gif").stat().st_size)
