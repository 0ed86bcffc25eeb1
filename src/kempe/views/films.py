"""Motions as animations: GIF, MP4 (with ffmpeg) or an HTML page with a player, with one scale."""

from __future__ import annotations

import importlib
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe.arguments import explain_errors
from kempe.arrays import is_whole
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
DPI = 100.0
"""Pixels an inch where no size is asked for."""
LEAST = 100
LARGEST = 4000
"""Pixels of the longer side of a film."""
COLOURS = 256
"""Colours of a GIF."""
PAPER = 248
"""Least red, green and blue of what is white in a GIF, whose table mixes similar colours."""

Picture = np.ndarray[Any, np.dtype[np.uint8]]
"""Pixels (height, width, 3) of a picture: red, green and blue."""


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
    size: int | None = None,
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
    if size is not None and not (is_whole(size) and LEAST <= size <= LARGEST):
        raise InputError(
            f"size is {format_value(size)}; it must be a whole number of pixels from {LEAST} to "
            f"{LARGEST}"
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
    _write_film(drawing, subjects, out, fps, size)
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


def _write_film(drawing: Any, subjects: list[Any], out: Path, fps: float, size: int | None) -> None:
    """Draw one subject after the other on the same axes, and write each as a frame of the file."""
    bounds = drawing.find_bounds(subjects[:: max(1, len(subjects) // 24)])
    ax = drawing.make_empty_axes(subjects[0], bounds, page.make_bare_figure)
    ax.figure.set_dpi(DPI if size is None else size / max(ax.figure.get_size_inches()))
    pictures = _draw_pictures(drawing, subjects, ax, bounds)
    if ENDINGS[out.suffix.lower()] == "pillow":
        _write_gif(pictures, out, fps)
    else:
        _write_by_program(pictures, out, fps)


def _draw_pictures(drawing: Any, subjects: list[Any], ax: Any, bounds: Any) -> Iterator[Picture]:
    """Draw one subject after the other on the same axes; give the pixels (height, width, 3) of each.

    The axes, which stay, are drawn once.
    """
    canvas = ax.figure.canvas
    still = None
    for subject in subjects:
        for artist in _list_artists(ax):
            artist.remove()
        drawing.draw_picture(subject, ax, bounds)
        artists = sorted(_list_artists(ax), key=lambda artist: artist.get_zorder())
        if still is None:
            still = _draw_still_part(ax, artists)
        canvas.restore_region(still)
        if ax.name == "3d":
            ax.set_axis_off()
            ax.patch.set_visible(False)
            ax.draw(canvas.get_renderer())
            ax.patch.set_visible(True)
            ax.set_axis_on()
        else:
            for artist in artists:
                ax.draw_artist(artist)
        yield np.array(canvas.buffer_rgba())[..., :3]


def _draw_still_part(ax: Any, moving: list[Any]) -> Any:
    """Draw axes without what moves on them; return the pixels, to be restored by the canvas."""
    hidden = [*moving, ax.title] if ax.name == "3d" else moving
    for artist in hidden:
        artist.set_visible(False)
    ax.figure.canvas.draw()
    still = ax.figure.canvas.copy_from_bbox(ax.figure.bbox)
    for artist in hidden:
        artist.set_visible(True)
    return still


def _list_artists(ax: Any) -> list[Any]:
    """List what is drawn on axes, besides the axes themselves."""
    return [*ax.collections, *ax.lines, *ax.patches, *ax.texts]


def _write_gif(pictures: Iterable[Picture], out: Path, fps: float) -> None:
    """Write pictures as a GIF with one table of colours, that of the first picture and a later one."""
    from PIL import Image

    every = [Image.fromarray(np.ascontiguousarray(picture)) for picture in pictures]
    both = Image.fromarray(np.concatenate([np.asarray(every[k]) for k in (0, len(every) // 2)]))
    table = both.quantize(COLOURS, dither=Image.Dither.NONE)
    colours = np.array(table.getpalette()).reshape(-1, 3)
    colours[np.all(colours >= PAPER, axis=1)] = 255
    table.putpalette(colours.ravel().tolist())
    first, *others = (one.quantize(palette=table, dither=Image.Dither.NONE) for one in every)
    first.save(
        out,
        save_all=True,
        append_images=others,
        duration=round(1000.0 / fps),
        loop=0,
        optimize=False,
    )


def _write_by_program(pictures: Iterable[Picture], out: Path, fps: float) -> None:
    """Write pictures as MP4 or as an HTML page, by the writers of matplotlib."""
    from matplotlib import animation

    kind = ENDINGS[out.suffix.lower()]
    more = {"embed_frames": True, "default_mode": "loop"} if kind == "html" else {}
    writer: Any = animation.writers[kind]
    writer = writer(fps=fps, **more)
    first, *others = pictures
    figure = page.make_bare_figure(first.shape[1] / DPI, first.shape[0] / DPI)
    shown = figure.figimage(first)
    with writer.saving(figure, str(out), dpi=DPI):
        writer.grab_frame()
        for picture in others:
            shown.set_data(picture)
            writer.grab_frame()
