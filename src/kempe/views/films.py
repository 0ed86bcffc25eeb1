"""Motions as animations: GIF, MP4 (with ffmpeg) or an HTML page with a player, with one scale."""

from __future__ import annotations

import importlib
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe.arguments import explain_errors
from kempe.description.source import expand_path
from kempe.errors import InputError, UnsupportedError, format_value
from kempe.model.configurations import has_loops, interpolate_configurations
from kempe.spatial import Array
from kempe.views.drawing import page
from kempe.views.drawing.plot_request import read_motion
from kempe.views.drawing.scene import build_scene
from kempe.views.plot_options import PlotOptions
from kempe.views.plots import choose_drawing, make_subject
from kempe.words import format_count

if TYPE_CHECKING:
    from kempe.model.model import Model

ENDINGS = {".gif": "pillow", ".mp4": "ffmpeg", ".html": "html"}
"""By the ending of a file who writes it, as `matplotlib.animation.writers` calls them."""
MOST = 600
"""Frames of a film."""


def check_film_path(file: str | Path) -> Path:
    """Check the path of an animation.

    Errors: `InputError` for other endings, `UnsupportedError` if its writer is missing.
    """
    from matplotlib import animation

    path = expand_path(file)
    writer = ENDINGS.get(path.suffix.lower())
    if writer is None:
        raise InputError(f"{path}: moving pictures are {', '.join(ENDINGS)} files")
    if not animation.writers.is_available(writer) and not _find_packed_ffmpeg():
        raise UnsupportedError(
            f"{path}: the program {writer} is needed to write it, and is not installed: pip "
            "install imageio-ffmpeg, or the system's package manager, brings it; .gif and .html "
            "need nothing"
        )
    return path


def _find_packed_ffmpeg() -> bool:
    """Find the program of the package imageio-ffmpeg, and let matplotlib run it; whether it is
    there.
    """
    import matplotlib

    try:
        packed: Any = importlib.import_module("imageio_ffmpeg")
        matplotlib.rcParams["animation.ffmpeg_path"] = str(packed.get_ffmpeg_exe())
    except (ImportError, RuntimeError):
        return False
    return True


@explain_errors
def animate(
    system: Model,
    path: Any,
    file: str | Path,
    *,
    frames: Any = (),
    labels: Any = False,
    seconds: float = 4.0,
    fps: float = 15.0,
) -> Path:
    """Write a motion as an animation; see `System.animate`."""
    if not seconds > 0.0 or not 0.0 < fps <= 60.0:
        raise InputError(
            f"seconds is {format_value(seconds)} and fps {format_value(fps)}; both must be "
            "positive, fps at most 60"
        )
    count = round(seconds * fps)
    if not 2 <= count <= MOST:
        raise InputError(
            f"seconds * fps is {format_count(count, 'picture')}; they must be from 2 to {MOST}"
        )
    out = check_film_path(file)
    way, drivers = read_motion(system, path)
    if way is None:
        raise InputError("path is None; it must be a motion, or configurations (n, nq)")
    options = PlotOptions(frames=frames, labels=labels)
    steps = _sample_motion(system, way[np.isfinite(way).all(axis=1)], count)
    drawing = choose_drawing(system)
    radius = drawing.usual_radius(build_scene(system, steps[0]))
    subjects = [
        replace(make_subject(system, q[None], way, path, drivers, options, ()), radius=radius)
        for q in steps
    ]
    _write_film(drawing, subjects, out, fps)
    return out


def _sample_motion(system: Model, q: Array, count: int) -> Array:
    """Choose configurations (count, nq) at equal steps along rows (n, nq).

    With loops these are the nearest rows, since interpolation would open the loops.
    """
    at = np.linspace(0.0, len(q) - 1.0, count)
    if len(q) >= count or len(q) < 2 or has_loops(system):
        return q[at.round().astype(int)]
    low = np.minimum(at.astype(int), len(q) - 2)
    return np.asarray(interpolate_configurations(system, q[low], q[low + 1], at - low))


def _write_film(drawing: Any, subjects: list[Any], out: Path, fps: float) -> None:
    """Draw one subject after the other on the same axes, and write each as a frame of the file."""
    from matplotlib import animation

    bounds = drawing.find_bounds(subjects[:: max(1, len(subjects) // 24)])
    ax = drawing.make_empty_axes(subjects[0], bounds, page.make_bare_figure)
    kind = ENDINGS[out.suffix.lower()]
    more = {"embed_frames": True, "default_mode": "loop"} if kind == "html" else {}
    writer: Any = animation.writers[kind]
    writer = writer(fps=fps, **more)
    with writer.saving(ax.figure, str(out), dpi=100):
        for subject in subjects:
            for artist in (*ax.collections, *ax.lines, *ax.patches, *ax.texts):
                artist.remove()
            drawing.draw_picture(subject, ax, bounds)
            writer.grab_frame()
