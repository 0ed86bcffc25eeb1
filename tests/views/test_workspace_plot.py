"""Pictures of workspaces: what is drawn where."""

from __future__ import annotations

import math

import numpy as np
import pytest

import kempe
from kempe import Mechanism
from kempe.errors import InputError

pytest.importorskip("matplotlib", reason="matplotlib is not installed (extra view)")
FLAT = kempe.load("two_link").workspace("e", n=200_000, cells=64)
SPACE = kempe.load("puma560").workspace("tool", n=500_000, cells=32)


def test_a_plane_is_drawn_in_metres():
    ax = FLAT.plot()
    (image,) = ax.images
    shown = image.get_array()
    assert np.array_equal(np.ma.filled(shown, 0).T, FLAT.map.counts)
    assert np.allclose(image.get_extent(), [FLAT.map.grid.low[0], FLAT.map.grid.high[0],
                                            FLAT.map.grid.low[1], FLAT.map.grid.high[1]])  # fmt: skip
    lines = [p.vertices for c in ax.collections for p in c.get_paths() if len(p.vertices)]
    away = np.linalg.norm(np.concatenate(lines), axis=1)
    assert np.minimum(np.abs(away - 0.9), np.abs(away - 0.1)).max() < 3 * FLAT.resolution
    assert ax.get_xlabel() == "x [m]" and ax.get_ylabel() == "y [m]"


def test_colours_read_in_grey():
    import matplotlib

    from kempe.views.workspace_plot import COLOURS

    rgb = matplotlib.colormaps[COLOURS](np.linspace(0, 1, 50))[:, :3]
    grey = rgb @ [0.2126, 0.7152, 0.0722]
    assert (np.diff(grey) < 0).all() and grey[0] - grey[-1] > 0.5


def test_slices_go_through_the_point():
    point = (0.1, -0.2, 0.3)
    axes = SPACE.plot(at=point)
    at = SPACE.map.grid.places(np.array(point))[0]
    layers = [SPACE.map.counts[:, :, at[2]], SPACE.map.counts[:, at[1]], SPACE.map.counts[at[0]]]
    for ax, layer, name, x in zip(axes, layers, "zyx", point[::-1], strict=True):
        assert np.array_equal(np.ma.filled(ax.images[0].get_array(), 0).T, layer)
        assert ax.get_title().startswith(f"{name} = ")
        assert math.isclose(float(ax.get_title()[4:-2]), x, abs_tol=SPACE.resolution)


def test_it_is_written(tmp_path):
    SPACE.plot()[0].figure.savefig(tmp_path / "map.png")
    assert (tmp_path / "map.png").read_bytes()[:4] == b"\x89PNG"


def test_what_cannot_be_drawn():
    m = Mechanism()
    m.prismatic("S", m.ground, m.body("cart"), axis="x", limits=(0, 1))
    line = m.build().workspace("cart", n=1000)
    for words, draw in {
        "piece of a line": line.plot, "slices": lambda: FLAT.plot(at=[0, 0]),
        "inside the box": lambda: SPACE.plot([9, 9, 9]),
        "must be 3 matplotlib axes": lambda: SPACE.plot(ax=FLAT.plot()),
    }.items():  # fmt: skip
        with pytest.raises(InputError, match=words):
            draw()
