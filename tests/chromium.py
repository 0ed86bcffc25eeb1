"""Where Chromium is, how it draws in the tests of pages, and where things are on a page."""

from __future__ import annotations

import shutil
from typing import Any

import numpy as np

CHROMIUM = next(
    (p for n in ("chromium", "chromium-browser", "google-chrome") if (p := shutil.which(n))), None
)
SOFTWARE = [
    "--no-sandbox",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--ignore-gpu-blocklist",
    "--force-device-scale-factor=0.5",
]
"""Drawing by the processor, which takes a quarter of the time where a pixel is two wide and two
high: even widths."""


def draw_plainly(server: Any) -> None:
    """Have a server of viser show neither shadows nor surroundings that surfaces reflect: without a
    graphics card these take seconds of the processor for each picture, also while nothing moves.
    """
    server.scene.configure_environment_map(None)
    server.scene.configure_default_lights(cast_shadow=False)


def measure_picture(tab: Any) -> tuple[float, float]:
    """Width and height of the picture on a page; the camera's are those of what is drawn, which is
    coarser where drawing takes long.
    """
    box = tab.locator("canvas").first.bounding_box()
    return box["width"], box["height"]


def project_point(tab: Any, camera: Any, p: Any) -> tuple[Any, Any]:
    """Where a point (..., 3) is on a page with a pinhole camera of viser: to the right, and down."""
    z = camera.look_at - camera.position
    z = z / np.linalg.norm(z)
    x = np.cross(z, camera.up_direction)
    x = x / np.linalg.norm(x)
    v = np.asarray(p) - camera.position
    wide, high = 0.5 * np.array(measure_picture(tab))
    scale = high / np.tan(0.5 * camera.fov) / (v @ z)
    return wide + scale * (v @ x), high - scale * (v @ np.cross(x, z))
