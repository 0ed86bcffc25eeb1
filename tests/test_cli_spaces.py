"""The command `kempe spaces`: what it says, writes and refuses."""

from __future__ import annotations

import numpy as np
import pytest
from command import Result

import kempe


def test_spaces_are_described():
    done = Result(
        "spaces", "four_bar", "--frame", "coupler_point", "--position-only", "--sample", 5
    )
    assert done.code == 0 and "dimension 1" in done.out and "2 connected components" in done.out
    assert "m = 2 > n = 1" in done.out and "uniform in arc length" in done.out


@pytest.mark.slow
def test_samples_and_pictures_are_written(tmp_path):
    pytest.importorskip("matplotlib")
    out = tmp_path / "q.npy"
    picture = tmp_path / "spaces.png"
    done = Result("spaces", "two_link", "--frame", "e", "--sample", 9, "-o", out, "--plot", picture)
    assert done.code == 0 and "written to" in done.out and picture.read_bytes()[:4] == b"\x89PNG"
    assert np.array_equal(np.load(out), kempe.load("two_link").configuration_space.sample(9, 0).q)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["two_link", "-o", "q.csv"], "--sample"),
        (["two_link", "--plot", "p.png"], "--frame"),
        (["two_link", "--position-only"], "--frame"),
        (["two_link", "--frame", "nowhere"], "nowhere"),
        (["two_link", "--sample", "0"], "n is 0"),
        (["slider", "--sample", "5"], "not bounded"),
        (["puma560", "--frame", "tool", "--plot", "p.png"], "two freedoms"),
        (["two_link", "--frame", "e", "--plot", "p.gif"], ".png"),
        (["nothing_here"], "nothing_here"),
    ],
)
def test_wrong_usage_is_said_without_a_traceback(arguments, said, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    done = Result("spaces", *arguments)
    assert (
        done.code == 2
        and said in done.err
        and "Traceback" not in done.err
        and not list(tmp_path.iterdir())
    )


def test_a_sample_that_is_late_is_not_complete():
    done = Result("spaces", "five_bar", "--sample", 5, "--time-limit", 1e-6)
    assert done.code == 1 and "0 configurations of 5" in done.out
