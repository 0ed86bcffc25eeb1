"""Where Chromium is, and how it draws in the tests of pages."""

from __future__ import annotations

import shutil

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
