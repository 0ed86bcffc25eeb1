"""Moving pictures: that frames show the motion on one scale, and what is refused."""

from __future__ import annotations

import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from command import Result

import kempe
from kempe.errors import InputError, UnsupportedError

pytest.importorskip("matplotlib")
import matplotlib
from matplotlib import animation, axis
from mpl_toolkits.mplot3d import axis3d
from PIL import Image

BAR = kempe.load("four_bar")
ARM = kempe.load("puma560")


@pytest.fixture(scope="module")
def turn():
    return BAR.trace("A")


def images(path: Path) -> list[np.ndarray]:
    with Image.open(path) as film:
        out = []
        for k in range(film.n_frames):
            film.seek(k)
            out.append(np.asarray(film.convert("L"), dtype=float))
    return out


@pytest.mark.slow
def test_a_gif_shows_the_motion_on_one_scale(tmp_path, turn):
    """Frames differ, and their common part, ground and curve, stays where it is."""
    path = turn.animate(tmp_path / "turn.gif", frames=["coupler_point"], seconds=1.0, fps=8)
    found = images(path)
    assert (
        path == tmp_path / "turn.gif"
        and len(found) == 8
        and {x.shape for x in found} == {found[0].shape}
    )
    dark = np.stack(found) < 200.0
    moving = dark.any(axis=0) & ~dark.all(axis=0)
    still = dark.all(axis=0)
    assert moving.sum() > 2000 and still.sum() > 500
    assert abs(found[0] - found[4]).max() > 100.0


@pytest.mark.parametrize("name", ["four_bar", "puma560"])
def test_axes_of_a_film_are_drawn_once(tmp_path, monkeypatch, name):
    """Every picture has them, on white paper, and is as large as was asked for."""
    drawn = []
    kind = axis.Axis if name == "four_bar" else axis3d.Axis
    draw = kind.draw
    monkeypatch.setattr(kind, "draw", lambda self, *how: drawn.append(self) or draw(self, *how))
    system = kempe.load(name)
    q = system.trace("A").q if name == "four_bar" else np.stack([ARM.mid, ARM.mid + 1.0])
    file = system.animate(
        q, tmp_path / "film.gif", frames=[system.frame_names[-1]], seconds=0.5, fps=10, size=300
    )
    assert len({*map(id, drawn)}) == len(drawn) == (2 if name == "four_bar" else 3)
    found = images(file)
    assert len(found) == 5 and max(found[0].shape) == 300
    still = np.all([x == found[0] for x in found], axis=0)
    assert (found[0][still] < 200.0).sum() > 50 and found[0].max() == 255.0
    assert not still.all()


def test_a_page_with_a_player(tmp_path, turn):
    text = BAR.animate(turn, tmp_path / "turn.html", seconds=0.5, fps=6).read_text()
    assert text.count("data:image/png;base64") == 3 and "http://" not in text.replace(
        "http://www.w3.org", ""
    )


@pytest.mark.slow
def test_a_motion_in_space_between_two_configurations(tmp_path):
    """Without loops it is interpolated."""
    path = ARM.animate(np.stack([ARM.mid, ARM.mid + 1.0]), tmp_path / "arm.gif", seconds=0.5, fps=8)
    found = images(path)
    assert len(found) == 4 and all(
        abs(a - b).max() > 50.0 for a, b in zip(found[:-1], found[1:], strict=True)
    )


def test_what_is_refused(tmp_path, turn, monkeypatch):
    with pytest.raises(InputError, match=r"moving pictures are \.gif, \.mp4, \.html files"):
        turn.animate(tmp_path / "turn.avi")
    with pytest.raises(InputError, match="seconds is -1"):
        turn.animate(tmp_path / "turn.gif", seconds=-1.0)
    with pytest.raises(InputError, match="size is 3; it must be a whole number of pixels"):
        turn.animate(tmp_path / "turn.gif", size=3)
    with pytest.raises(InputError, match="must be from 2 to 600"):
        turn.animate(tmp_path / "turn.gif", seconds=1e3)
    monkeypatch.setattr(animation.writers, "is_available", lambda name: name != "ffmpeg")
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    with pytest.raises(
        UnsupportedError, match="the program ffmpeg is needed.*pip install imageio-ffmpeg"
    ):
        turn.animate(tmp_path / "turn.mp4")


def test_the_program_of_a_package_writes_films(tmp_path, monkeypatch):
    """Where ffmpeg is not installed, that of imageio-ffmpeg is run: here a script that keeps what
    it is given.
    """
    program = tmp_path / "program"
    kept = tmp_path / "kept"
    program.write_text(f"#!/bin/sh\ncat > {kept}\n")
    program.chmod(0o755)
    monkeypatch.setitem(
        sys.modules, "imageio_ffmpeg", SimpleNamespace(get_ffmpeg_exe=lambda: program)
    )
    monkeypatch.setitem(matplotlib.rcParams, "animation.ffmpeg_path", "no-such-program")
    ARM.animate(np.stack([ARM.mid, ARM.mid + 1.0]), tmp_path / "arm.mp4", seconds=0.5, fps=8)
    assert kept.stat().st_size % 4 == 0 and kept.stat().st_size > 4 * 4 * 10_000


# ---- the command line


@pytest.mark.slow
def test_commands_that_draw(tmp_path):
    film, picture, tree = (tmp_path / n for n in ("turn.gif", "modes.svg", "tree.svg"))
    out = Result("trace", "four_bar", "--driver", "A", "--gif", film)
    assert out.code == 0 and f"written to {film}" in out.out and len(images(film)) == 60
    assert Result("assemble", "four_bar", "A=1", "--modes", "--plot", picture).code == 0
    assert picture.read_text().count('id="joint:C"') == 2, "both modes"
    assert Result("plot", "seven_bodies_loop", "--tree", "-o", tree).code == 0
    assert 'id="cut:J6"' in tree.read_text()
    arm = tmp_path / "arm.svg"
    more = (
        "--axes",
        "all",
        "--angles",
        "--dimensions",
        "--motion",
        "--workspace",
        "e",
        "--labels",
        "bodies",
    )
    assert Result("plot", "two_link", "-o", arm, "--q", "30,50", "--deg", *more).code == 0
    for part in (
        "angle:q1",
        "dimension:B1:0",
        "motion:q1:0",
        "workspace:0",
        "mark:e:x",
        "label:body:B1",
    ):
        assert f'id="{part}"' in arm.read_text(), part
    both = tmp_path / "both.svg"
    place = ("--frame", "e", "--target", "0.6,0.3,0", "--position-only")
    assert Result("ik", "two_link", *place, "--all", "--plot", both).code == 0
    assert 'id="label:configuration1"' in both.read_text()
    none = Result(
        "ik",
        "two_link",
        "--frame",
        "e",
        "--target",
        "9,0,0",
        "--position-only",
        "--all",
        "--plot",
        both,
    )
    assert none.code == 1 and "is not written: there is no configuration to draw" in none.err
    refused = Result("trace", "four_bar", "--gif", tmp_path / "turn.png")
    assert refused.code == 2 and "moving pictures are .gif" in refused.err


@pytest.mark.slow
def test_the_tree_and_the_joints_as_text(tmp_path):
    out = Result("info", "seven_bodies_loop", "--tree").out
    assert "└─ J1 (revolute) ─ 1 B1" in out and "╌╌ J6 (prismatic) closes a loop: B0 ╌ B5" in out
    picture = tmp_path / "joints.png"
    out = Result("joints", "--plot", picture)
    assert out.code == 0 and picture.stat().st_size > 10_000
    (line,) = (line for line in out.out.splitlines() if line.startswith("universal"))
    assert line.split()[:4] == ["universal", "U", "2", "4"]
    assert {row["type"]: row["dof"] for row in Result("joints", "--json").json()["joints"]}[
        "free"
    ] == 6
