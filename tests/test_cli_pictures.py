"""Every command that has something to see draws it: by one table of all commands, so that none is
forgotten.
"""

from __future__ import annotations

from pathlib import Path

import pytest
import typer
from command import Result

from kempe.cli import app

FLAGS = {"--plot": "seen.png", "--gif": "seen.gif", "--html": "seen.html", "-o": "seen.csv"}
"""Options by which commands write what is seen, and what was found."""
SEEN = {
    "info": ("two_link", "--plot --html"),
    "fk": ("two_link --q rows.csv", "--plot --gif --html -o"),
    "ik": ("two_link --frame e --target 0.6,0.3 --all", "--plot --gif --html -o"),
    "path": ("two_link --frame e --targets way.csv", "--plot --gif --html -o"),
    "dof": ("four_bar", "--plot --html"),
    "classify": ("car", "--plot --html"),
    "assemble": ("four_bar A=0.3 --modes", "--plot --gif --html -o"),
    "trace": ("four_bar --frame coupler_point", "--plot --gif --html -o"),
    "spaces": ("two_link --frame e --sample 4", "--plot -o"),
    "workspace": ("two_link --frame e -n 1e3 --cells 8", "--plot"),
    "singularities": ("puma560 --frame tool --starts 16", "--plot --gif --html -o"),
    "reach": ("two_link way.csv --frame e", "--plot --gif --html -o"),
    "place": ("two_link way.csv --frame e --box x=-0.1,0.1 --box y=-0.1,0.1 --cells 2", "--plot"),
    "joints": ("", "--plot"),
    "view": ("two_link", "--html"),
    "demo": ("", "--html"),
}
"""Commands with something to see: words of an example, and the options that it takes."""
ELSEWHERE = {
    "draw": "what is drawn is drawn in the browser",
    "clearance": "two points in a table",
    "plot": "its OUT is the picture",
    "tour": "--pictures takes a folder",
    "convert": "a file in place of a picture",
    "check": "problems of text",
    "plan": "sentences about axes",
    "query": "points of a map that workspace draws",
    "map": "answers larger than memory",
    "library": "text of a model that plot draws",
}
"""Commands that draw nothing by these options, and why."""


def test_no_command_is_forgotten():
    """All commands are in one of the tables; those of the first take the options that it says, and
    no others.
    """
    commands = typer.main.get_command(app).commands  # type: ignore[attr-defined]
    assert {*commands} == {*SEEN} | {*ELSEWHERE} and not {*SEEN} & {*ELSEWHERE}
    for name, (_, options) in SEEN.items():
        taken = {flag for p in commands[name].params for flag in p.opts} & {
            "--plot",
            "--gif",
            "--html",
        }
        assert taken == {*options.split()} & {"--plot", "--gif", "--html"}, name


@pytest.fixture
def here(tmp_path, monkeypatch) -> Path:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "rows.csv").write_text("q1,q2\n0.1,0.4\n0.2,0.6\n0.3,0.8\n")
    (tmp_path / "way.csv").write_text("x,y\n0.5,0.3\n0.52,0.32\n0.54,0.34\n")
    return tmp_path


@pytest.mark.slow
@pytest.mark.parametrize("name", list(SEEN))
def test_every_command_draws_what_it_found(name, here):
    """Each file that was requested is there, begins as files of its kind do, and is named."""
    words, options = SEEN[name]
    files = {flag: FLAGS[flag] for flag in options.split()}
    done = Result(name, *words.split(), *(word for pair in files.items() for word in pair))
    assert done.code == 0, done.err
    begins = {"seen.png": b"\x89PNG", "seen.gif": b"GIF8", "seen.html": b"<!", "seen.csv": b""}
    for file in files.values():
        assert (here / file).read_bytes()[:4].startswith(begins[file][:4]) and (
            here / file
        ).stat().st_size > 20
        assert f"written to {file}" in done.out + done.err


@pytest.mark.parametrize(
    "name", [name for name, (_, options) in SEEN.items() if "--html" in options]
)
def test_pages_that_cannot_be_written_are_refused_first(name, here):
    done = Result(name, *SEEN[name][0].split(), "--html", "seen.txt")
    assert done.code == 2 and "a page ends in .html" in done.err and not done.out


def test_one_configuration_makes_no_film(here):
    """It is said, and the picture is drawn all the same."""
    done = Result(
        "ik", "two_link", "--frame", "e", "--target", "0.6,0.3", "--plot", "a.png", "--gif", "a.gif"
    )
    assert done.code == 0 and "a.gif is not written: one configuration does not move" in done.err
    assert (here / "a.png").exists() and not (here / "a.gif").exists()
