"""The commands for workspaces as their users see them."""

from __future__ import annotations

import numpy as np
import pytest
from command import Result

import kempe

pytest.importorskip("zarr", reason="zarr is not installed (extra scale)")
FEW = ("two_link", "--frame", "e", "-n", "2e5", "--cells", "64")


def test_a_map_is_made_drawn_and_looked_up(tmp_path):
    pytest.importorskip("matplotlib", reason="matplotlib is not installed (extra view)")
    path, picture = tmp_path / "map.zarr", tmp_path / "map.png"
    done = Result("workspace", *FEW, "-o", path, "--plot", picture, "--json").json()
    assert done["samples"] == 200_000 and done["cells"] == [64, 64] and done["written"] == [str(path), str(picture)]
    assert abs(done["area"] - np.pi * (0.9**2 - 0.1**2)) < 2 * done["area_error"]
    found = Result("query", path, "0.5,0.2", "-0.5,-0.2", "0.01,0", "1,1", "--json").json()
    assert [p["reached"] for p in found["points"]] == [True, True, False, False]
    assert found["points"][0]["distance"] > 0 > found["points"][3]["distance"]
    text = Result("query", path, "0.5,0.2", "1,1").out
    assert "0.5,0.2: reached" in text and "1,1: not reached" in text
    assert np.array_equal(kempe.open_workspace(path).map.counts,
                          kempe.load("two_link").workspace("e", n=2e5, cells=64).map.counts)  # fmt: skip


def test_the_text_says_what_is_proven():
    out = Result("workspace", *FEW).out
    assert "each of these holds a point that is reached" in " ".join(out.split()) and "area = 2.5" in out


def test_the_time_limit_is_an_exit_code(tmp_path):
    done = Result("workspace", "two_link", "--frame", "e", "-n", "1e13", "--time-limit", "0.3", "--json")
    assert done.code == 1 and done.json()["code"] == "OUT_OF_TIME"


@pytest.mark.parametrize(("arguments", "words"), [
    (("workspace", "two_link", "--frame", "e", "-n", "0"), "n is 0"),
    (("workspace", "two_link", "--frame", "e", "-n", "1e30"), "n is 1e+30"),
    (("workspace", "two_link", "--frame", "ground"), "does not move"),
    (("workspace", "two_link", "--frame", "hand"), "hand"),
    (("workspace", "joint_prismatic", "--frame", "body"), "no limits"),
    (("workspace", "two_link", "--frame", "e", "--box", "1,2,3"), "--box"),
    (("workspace", "two_link", "--frame", "e", "--cells", "x"), "--cells"),
    (("workspace", "two_link", "--frame", "e", "--plot", "map.txt"), "a picture ends with"),
    (("query", "nowhere.zarr", "1,2"), "no such map"),
], ids=lambda x: x if isinstance(x, str) else "")  # fmt: skip
def test_wrong_questions(arguments, words):
    done = Result(*arguments)
    assert done.code == 2 and words in " ".join(done.err.split()) and "Traceback" not in done.err


@pytest.mark.parametrize("point", ["1,2,3", "1", "--bogus", "a,b"])
def test_wrong_points(tmp_path, point):
    Result("workspace", *FEW, "-o", tmp_path / "map.zarr")
    done = Result("query", tmp_path / "map.zarr", point)
    assert done.code == 2 and "number" in done.err
