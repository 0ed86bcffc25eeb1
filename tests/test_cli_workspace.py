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
    path = tmp_path / "map.zarr"
    picture = tmp_path / "map.png"
    done = Result("workspace", *FEW, "-o", path, "--plot", picture, "--json").json()
    assert (
        done["samples"] == 200_000
        and done["cells"] == [64, 64]
        and done["written"] == [str(path), str(picture)]
    )
    assert abs(done["area"] - np.pi * (0.9**2 - 0.1**2)) < 2 * done["area_error"]
    found = Result("query", path, "0.5,0.2", "-0.5,-0.2", "0.01,0", "1,1", "--json").json()
    assert [p["reached"] for p in found["points"]] == [True, True, False, False]
    assert found["points"][0]["distance"] > 0 > found["points"][3]["distance"]
    refused = Result("query", path, "0.5,nan")
    assert refused.code == 2 and "a point is '0.5,nan', which holds nan" in " ".join(
        refused.err.split()
    )
    assert "in metres, in the ground frame" in " ".join(
        Result("query", "--help").out.replace("│", " ").split()
    )
    text = Result("query", path, "0.5,0.2", "1,1").out
    assert "0.5,0.2: reached" in text and "1,1: not reached" in text
    assert np.array_equal(
        kempe.open_workspace(path).map.counts,
        kempe.load("two_link").workspace("e", n=2e5, cells=64).map.counts,
    )


def test_the_text_says_what_is_proven():
    out = Result("workspace", *FEW).out
    assert (
        "each of these holds a point that is reached" in " ".join(out.split())
        and "area  2.5" in out
    )


@pytest.fixture
def three_links(tmp_path):
    """A file of three links in the plane, 0.5, 0.3 and 0.1 m long: the wrist reaches a ring from
    0.2 to 0.8 m.
    """
    m = kempe.Mechanism("three links", dim=2)
    before = m.ground
    at = (0.0, 0.0)
    for k, length in enumerate((0.5, 0.3, 0.1), 1):
        body = m.body(f"B{k}")
        m.revolute(f"J{k}", before, body, at=at)
        before = body
        at = (length, 0.0)
    m.frame("tool", before, at)
    return str(m.save(tmp_path / "three.toml"))


@pytest.mark.parametrize(
    ("options", "kind", "size", "true"),
    [
        ((), "reachable", "area", 0.81 * np.pi - 0.01 * np.pi),
        (
            ("--orientation", "40", "--deg"),
            "constant-orientation",
            "area",
            0.6 * np.pi,
        ),  # the ring, moved by the hand
        (
            ("--kind", "dexterous"),
            "dexterous",
            "area",
            0.4 * np.pi,
        ),  # where the hand can stand inwards and outwards
        (
            ("--kind", "orientation", "--at", "0.75,0"),
            "orientation",
            "length",
            2.0 * np.arccos(-0.45),
        ),  # cosine theorem
    ],
    ids=lambda x: x if isinstance(x, str) else "",
)
def test_kinds_of_workspaces(three_links, options, kind, size, true):
    done = Result(
        "workspace",
        three_links,
        "--frame",
        "tool",
        "-n",
        "300",
        "--cells",
        "16",
        *options,
        "--json",
    ).json()
    assert done["kind"] == kind
    assert abs(done[size] - true) <= max(2 * done[f"{size}_error"], 1e-9)


def test_the_time_limit_is_an_exit_code(tmp_path):
    done = Result(
        "workspace", "two_link", "--frame", "e", "-n", "1e13", "--time-limit", "0.3", "--json"
    )
    assert done.code == 1 and done.json()["code"] == "OUT_OF_TIME"


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("workspace", "two_link", "--frame", "e", "-n", "0"), "n is 0"),
        (("workspace", "two_link", "--frame", "e", "-n", "1e30"), "n is 1e+30"),
        (("workspace", "two_link", "--frame", "ground"), "does not move"),
        (("workspace", "two_link", "--frame", "hand"), "hand"),
        (("workspace", "joint_prismatic", "--frame", "body"), "no limits"),
        (("workspace", "two_link", "--frame", "e", "--box", "1,2,3"), "--box"),
        (("workspace", "two_link", "--frame", "e", "--cells", "x"), "--cells"),
        (
            ("workspace", "two_link", "--frame", "e", "--plot", "map.txt"),
            "pictures are .png, .svg or .pdf files",
        ),
        (("query", "nowhere.zarr", "1,2"), "no such map"),
        (
            ("workspace", "two_link", "--frame", "e", "--kind", "some"),
            "no kind 'some'; there are: 'reachable'",
        ),
        (("workspace", "two_link", "--frame", "e", "--kind", "orientation"), "needs at"),
        (("workspace", "two_link", "--frame", "e", "--at", "1"), "one place (2,)"),
        (("workspace", "two_link", "--frame", "e", "--orientation", "a"), "--orientation"),
    ],
    ids=lambda x: x if isinstance(x, str) else "",
)
def test_wrong_questions(arguments, words):
    done = Result(*arguments)
    assert done.code == 2 and words in " ".join(done.err.split()) and "Traceback" not in done.err


@pytest.mark.parametrize("point", ["1,2,3", "1", "--bogus", "a,b"])
def test_wrong_points(tmp_path, point):
    Result("workspace", *FEW, "-o", tmp_path / "map.zarr")
    done = Result("query", tmp_path / "map.zarr", point)
    assert done.code == 2 and "number" in done.err


# ---- files larger than memory


@pytest.fixture
def rows(tmp_path):
    """A file of targets of which one is no number."""
    arm = kempe.load("two_link")
    q = arm.random(0, 50)
    q[7] = np.nan
    np.savetxt(
        tmp_path / "p.csv",
        arm.fk(q, "e", form="position")[:, :2],
        delimiter=",",
        header="x,y",
        comments="",
    )
    return tmp_path / "p.csv"


def test_rows_of_a_file_are_answered(tmp_path, rows):
    zarr = pytest.importorskip("zarr", reason="zarr is not installed (extra scale)")
    done = Result(
        "map", "ik", "two_link", rows, "-o", tmp_path / "q.zarr", "--frame", "e", "--json"
    )
    assert done.code == 1 and done.json()["outcomes"] == {"SOLVED": 49, "BAD_INPUT": 1}
    again = Result(
        "map",
        "fk",
        "two_link",
        tmp_path / "q.zarr" / "q",
        "-o",
        tmp_path / "x.zarr",
        "--frame",
        "e",
        "--form",
        "position",
        "--float32",
    )
    assert again.code == 1 and "fk of 50 of 50 rows" in " ".join(again.out.split())
    found = zarr.open_group(str(tmp_path / "x.zarr"))["position"][...]
    given = np.loadtxt(rows, delimiter=",", skiprows=1)
    assert found.dtype == np.float32 and np.allclose(found[:, :2], given, atol=1e-5, equal_nan=True)


def test_options_of_maps(tmp_path, rows):
    good = ("map", "ik", "two_link", rows, "-o", tmp_path / "q.zarr", "--frame", "e")
    more = (
        "--start",
        "0.1,0.2",
        "--tolerance",
        "1e-5",
        "--rng",
        "3",
        "--threads",
        "2",
        "--columns",
        "x,y",
        "--deg",
    )
    assert Result(*good, *more, "--json").json()["rows"] == 50
    other = Result(*good, "--task", "position")
    assert other.code == 2 and "belongs to another map: its options" in " ".join(other.err.split())
    limited = Result(*good[:5], tmp_path / "p.zarr", *good[6:], "--time-limit", "1e-9", "--json")
    assert limited.code == 1 and limited.json()["code"] == "OUT_OF_TIME"


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("fk", "two_link", "none.npy", "-o", "o.zarr"), "no such file"),
        (("turn", "two_link", "p.csv", "-o", "o.zarr"), "no verb 'turn'"),
        (("ik", "two_link", "p.csv", "-o", "o.zarr"), "ik needs a frame"),
        (
            ("ik", "two_link", "p.csv", "-o", "o.zarr", "--frame", "e", "--form", "3x4"),
            "no option of map ik 'form'",
        ),
        (
            ("assemble", "four_bar", "p.csv", "-o", "o.zarr", "--tolerance", "1,2"),
            "it is one number",
        ),
        (("fk", "two_link", "p.csv", "-o", "o.zarr"), "no coordinate 'x'"),
        (("fk", "two_link", "p.csv"), "--out"),
    ],
    ids=lambda x: x if isinstance(x, str) else "",
)
def test_wrong_maps(tmp_path, monkeypatch, rows, arguments, words):
    monkeypatch.chdir(tmp_path)
    done = Result("map", *arguments)
    assert done.code == 2 and words in " ".join(done.err.split()) and "Traceback" not in done.err
