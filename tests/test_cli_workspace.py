"""The commands for workspaces, configuration spaces, and files larger than memory."""

from __future__ import annotations

import numpy as np
import pytest
from command import Result

import kempe

pytest.importorskip("zarr", reason="zarr is not installed (extra scale)")
FEW = ("two_link", "--frame", "e", "-n", "2e5", "--cells", "64")


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.slow
def test_a_map_is_made_drawn_and_looked_up():
    pytest.importorskip("matplotlib", reason="matplotlib is not installed (extra view)")
    done = Result("workspace", *FEW, "-o", "map.zarr", "--plot", "map.png", "--json").json()
    assert done["samples"] == 200_000 and done["cells"] == [64, 64]
    assert done["written"] == ["map.zarr", "map.png"]
    assert abs(done["area"] - np.pi * (0.9**2 - 0.1**2)) < 2 * done["area_error"]
    found = Result("query", "map.zarr", "0.5,0.2", "-0.5,-0.2", "0.01,0", "1,1", "--json").json()
    assert [p["reached"] for p in found["points"]] == [True, True, False, False]
    assert found["points"][0]["distance"] > 0 > found["points"][3]["distance"]
    text = Result("query", "map.zarr", "0.5,0.2", "1,1").out
    assert "0.5,0.2: reached" in text and "1,1: not reached" in text
    counts = kempe.load("two_link").workspace("e", n=2e5, cells=64).map.counts
    assert np.array_equal(kempe.open_workspace("map.zarr").map.counts, counts)
    for point, said in (
        ("0.5,nan", "a point is '0.5,nan', which holds nan"),
        ("1e400,0", "holds inf"),
        ("1,2,3", "points must have 2 numbers"),
        ("1", "points must have 2 numbers"),
        ("--bogus", "number"),
        ("a,b", "number"),
    ):
        refused = Result("query", "map.zarr", point)
        assert refused.code == 2 and said in refused.err, refused.err
    shown = " ".join(Result("query", "--help").out.replace("│", " ").split())
    assert "in the unit of the map, in the ground frame" in shown


def test_the_text_says_what_is_proven():
    out = " ".join(Result("workspace", *FEW).out.split())
    assert "each of these holds a point that is reached" in out and "area 2.5" in out


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
    ("words", "kind", "size", "true"),
    [
        ("", "reachable", "area", 0.81 * np.pi - 0.01 * np.pi),
        # the ring, moved by the hand
        ("--orientation 40 --deg", "constant-orientation", "area", 0.6 * np.pi),
        # where the hand can stand inwards and outwards
        ("--kind dexterous", "dexterous", "area", 0.4 * np.pi),
        # cosine theorem
        ("--kind orientation --at 0.75,0", "orientation", "length", 2.0 * np.arccos(-0.45)),
    ],
)
def test_kinds_of_workspaces(three_links, words, kind, size, true):
    given = f"--frame tool -n 300 --cells 16 {words} --json"
    done = Result("workspace", three_links, *given.split()).json()
    assert done["kind"] == kind
    assert abs(done[size] - true) <= max(2 * done[f"{size}_error"], 1e-9)


def test_time_limits_are_an_exit_code():
    done = Result(*"workspace two_link --frame e -n 1e13 --time-limit 0.3 --json".split())
    assert done.code == 1 and done.json()["code"] == "OUT_OF_TIME"
    done = Result("spaces", "five_bar", "--sample", 5, "--time-limit", 1e-6)
    assert done.code == 1 and "0 configurations of 5" in done.out


# ---- configuration spaces


def test_spaces_are_described():
    done = Result(*"spaces four_bar --frame coupler_point --position-only --sample 5".split())
    assert done.code == 0 and "dimension 1" in done.out and "2 connected components" in done.out
    assert "m = 2 > n = 1" in done.out and "uniform in arc length" in done.out


@pytest.mark.slow
def test_samples_and_pictures_are_written(folder):
    pytest.importorskip("matplotlib")
    done = Result(*"spaces two_link --frame e --sample 9 -o q.npy --plot s.png".split())
    assert done.code == 0 and "written to" in done.out
    assert (folder / "s.png").read_bytes()[:4] == b"\x89PNG"
    space = kempe.load("two_link").configuration_space
    assert np.array_equal(np.load("q.npy"), space.sample(9, 0).q)


# ---- files larger than memory


@pytest.fixture
def rows():
    """A file of targets of which one is no number."""
    arm = kempe.load("two_link")
    q = arm.random(0, 50)
    q[7] = np.nan
    places = arm.fk(q, "e", form="position")[:, :2]
    np.savetxt("p.csv", places, delimiter=",", header="x,y", comments="")
    return places


def test_rows_of_a_file_are_answered(rows):
    zarr = pytest.importorskip("zarr", reason="zarr is not installed (extra scale)")
    done = Result(*"map ik two_link p.csv -o q.zarr --frame e --json".split())
    assert done.code == 1 and done.json()["outcomes"] == {"SOLVED": 49, "BAD_INPUT": 1}
    words = "map fk two_link q.zarr/q -o x.zarr --frame e --form position --float32"
    again = Result(*words.split())
    assert again.code == 1 and "fk of 50 of 50 rows" in " ".join(again.out.split())
    found = zarr.open_group("x.zarr")["position"][...]
    assert found.dtype == np.float32 and np.allclose(found[:, :2], rows, atol=1e-5, equal_nan=True)


def test_options_of_maps(rows):
    good = "map ik two_link p.csv --frame e -o q.zarr"
    more = "--start 0.1,0.2 --tolerance 1e-5 --rng 3 --threads 2 --columns x,y --deg --json"
    assert Result(*f"{good} {more}".split()).json()["rows"] == 50
    other = Result(*f"{good} --task position".split())
    assert other.code == 2 and "belongs to another map: its options" in " ".join(other.err.split())
    limited = Result(*f"{good.replace('q.', 'p.')} --time-limit 1e-9 --json".split())
    assert limited.code == 1 and limited.json()["code"] == "OUT_OF_TIME"
