"""Pictures of workspaces: what is drawn where."""

from __future__ import annotations

import math
import subprocess
import sys

import numpy as np
import pytest
from reached_sets import shell

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
    assert np.allclose(
        image.get_extent(),
        [FLAT.map.grid.low[0], FLAT.map.grid.high[0], FLAT.map.grid.low[1], FLAT.map.grid.high[1]],
    )
    away = np.linalg.norm(np.concatenate([line.get_xydata() for line in ax.lines]), axis=1)
    assert np.minimum(np.abs(away - 0.9), np.abs(away - 0.1)).max() < 1e-9
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
    at = SPACE.map.grid.locate_cells(np.array(point))[0]
    layers = [SPACE.map.counts[:, :, at[2]], SPACE.map.counts[:, at[1]], SPACE.map.counts[at[0]]]
    for ax, layer, name, x in zip(axes, layers, "zyx", point[::-1], strict=True):
        assert np.array_equal(np.ma.filled(ax.images[0].get_array(), 0).T, layer)
        assert ax.get_title().startswith(f"{name} = ")
        assert math.isclose(float(ax.get_title()[4:-2]), x, abs_tol=SPACE.resolution)


def test_without_matplotlib_every_plot_names_the_extra():
    code = (
        "import sys\nsys.modules['matplotlib'] = None\nimport numpy as np\nimport kempe\n"
        "arm = kempe.load('two_link')\nX = arm.fk([0.3, 0.4], 'e')[None]\n"
        "answers = (arm.workspace('e', n=1000, cells=8), arm.reach.poses(X, 'e'), "
        "arm.reach.capability('e', [[-1, -1], [1, 1]], 4, 4), "
        "arm.reach.place(X, 'e', {'x': (-1, 1)}, 3), arm.reach.planar('e'))\n"
        "for answer in answers:\n    try:\n        answer.plot()\n"
        "    except kempe.errors.MissingExtraError as error:\n"
        "        print(error.package, error.extra)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split("\n") == [*["matplotlib view"] * 5, ""]


def test_a_line_goes_around_cells_where_no_boundary_is_known():
    part = kempe.load("two_link").workspace("e", n=200_000, cells=64, box=[(-2, 0.8), (-2, 2)])
    assert part.exact is None
    lines = [p.vertices for c in part.plot().collections for p in c.get_paths() if len(p.vertices)]
    edge = np.concatenate(lines)
    away = np.linalg.norm(edge[edge[:, 0] < 0.75], axis=1)
    assert np.minimum(np.abs(away - 0.9), np.abs(away - 0.1)).max() < 3 * part.resolution


def test_slices_show_the_boundary_of_a_solid():
    """A shell of radii 0.2 and 0.8, cut through its middle: circles, and no line around the cells
    with samples.
    """
    axes = shell(0.5, 0.3).workspace("tip", n=5000, cells=20).plot(at=(0.0, 0.0, 0.0))
    for ax in axes:
        (lines,) = ax.collections
        assert lines.get_gid() == "boundary"
        radii = np.unique(
            [np.round(np.hypot(*p.T).mean(), 2) for p in lines.get_paths()[0].to_polygons()]
        )
        assert radii.tolist() == [0.2, 0.8]


def test_where_each_cell_has_one_place_there_is_nothing_to_count():
    """A place is reached or not: a scale of samples from 1 to 2 would say nothing."""
    one = kempe.load("puma560").workspace("tool", at=(0.3, 0.1, 0.5), cells=6)
    assert one.map.counts.max() == 1 and len(one.plot()[0].figure.axes) == 3
    several = kempe.load("three_rrr").workspace("tool", orientation=0.2, cells=8, n=400)
    assert several.map.counts.max() in range(2, 10)
    *_, bar = several.plot().figure.axes
    assert bar.get_ylabel() == "places reached in a cell"
    assert all(float(t).is_integer() for t in bar.get_yticks())
    for axes in (FLAT.plot(), SPACE.plot()[0]):
        assert axes.figure.axes[-1].get_ylabel() == "samples in a cell"


def test_numbers_at_the_axes_of_small_systems_have_a_common_power():
    m = Mechanism("small", dim=2)
    m.revolute("q1", m.ground, m.body("a"), limits=(-1, 1))
    m.revolute("q2", "a", m.body("b"), at=(6e-4, 1e-4), limits=(-1, 1))
    m.frame("tip", "b", at=(4e-4, 0))
    ax = m.build().workspace("tip", n=10_000).plot()
    ax.figure.canvas.draw()
    boxes = [t.get_window_extent() for t in ax.get_xticklabels() if t.get_text()]
    assert not any(a.overlaps(b) for a, b in zip(boxes, boxes[1:], strict=False)) and len(boxes) > 2


@pytest.mark.slow
def test_it_is_written(tmp_path):
    SPACE.plot()[0].figure.savefig(tmp_path / "map.png")
    assert (tmp_path / "map.png").read_bytes()[:4] == b"\x89PNG"


def test_what_cannot_be_drawn():
    m = Mechanism()
    m.prismatic("S", m.ground, m.body("cart"), axis="x", limits=(0, 1))
    line = m.build().workspace("cart", n=1000)
    for words, draw in {
        "piece of a line": line.plot,
        "chooses a slice": lambda: FLAT.plot(at=[0, 0]),
        "inside the box": lambda: SPACE.plot([9, 9, 9]),
        "must be 3 matplotlib axes": lambda: SPACE.plot(ax=FLAT.plot()),
    }.items():
        with pytest.raises(InputError, match=words):
            draw()
