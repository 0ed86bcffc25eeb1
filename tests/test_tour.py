"""The walk through the lecture in the terminal, and that its page has all that the lecture has."""

from __future__ import annotations

import re
from importlib.util import find_spec

import pytest
from command import Result

from kempe.errors import InputError
from kempe.library import lecture
from kempe.library.lecture import Cell

SECTIONS = lecture.read_sections()
DRAWN = {
    2: ['labels=("bodies", "joints")'],
    3: ['load("slider")', "motion=True"],
    4: ['load("four_links")'],
    5: ["plot_joints()"],
    6: ['axes="all"', "angles=True"],
    7: ["in_plane.plot", "in_space.plot"],
    8: ['open_loops("J5")', "assembly_modes", 'loop.q("closed")'],
    9: ["plot_spaces", 'axes=("ground", "e")'],
    10: ["plot_spaces"],
    11: ["dimensions=True"],
    14: ["plot_tree"],
    15: ["side_by_side=True", 'workspace="e"'],
    17: ['angles="e"'],
    18: ["car.plot", "ball.plot"],
}
"""What draws the lecture's figures, by the section: B_i and J_i; B5 on J6; four links; joint types;
both ways to parametrize; the exercise; open and closed loops; both spaces with x0, y0; both models;
frames, angles and lengths; the tree; two elbows, a point out of reach; alpha and beta; car and
ball."""


def test_the_order_is_that_of_the_lecture():
    words = (
        "particles",
        "multibody system",
        "Constraints",
        "Counting",
        "joints",
        "Configuration",
        "Exercise",
        "closed-loop",
        "task space",
        "Forward and inverse",
        "Forward",
        "Homogeneous",
        "frames",
        "Connectivity",
        "Inverse",
        "Solution",
        "two-link",
        "again",
    )
    assert len(SECTIONS) == len(words) == 18
    assert all(word in x.title for word, x in zip(words, SECTIONS, strict=True))


@pytest.mark.parametrize("section", SECTIONS, ids=lambda x: str(x.number))
def test_a_section_has_formula_code_picture_and_exercise(section):
    source = re.split(r"^## ", lecture.read_page(), flags=re.MULTILINE)[section.number]
    assert re.search(r"\$.+?\$", source) and any(
        x.picture for x in section.parts if isinstance(x, Cell)
    )
    assert re.search(
        r"\*\*Exercise\.\*\*.+<details><summary>Solution</summary>.+</details>", source, re.DOTALL
    )
    drawings = "".join(x.code for x in section.parts if isinstance(x, Cell) and x.picture)
    assert all(text in drawings for text in DRAWN.get(section.number, []))


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        (
            r"**bold** and *slanted*, `code`, [a link](dof.md#x)<!-- hunted: x -->",
            "bold and slanted, code, a link (docs/dof.md#x)",
        ),
        (
            r"$4 \times 3 = 12$, $f(q) \geq 0$, $c_2 \notin [-1, 1]$",
            "4 x 3 = 12, f(q) >= 0, c_2 not in [-1, 1]",
        ),
        (r"${}^0_nT = {}^0_1T \dots {}^{n-1}_nT$", "0_nT = 0_1T ... n-1_nT"),
        (r"$\begin{bmatrix} R & p \\ 0 & 1 \end{bmatrix}$", "[R, p; 0, 1]"),
        ("See [a page](https://example.org/x).", "See a page (https://example.org/x)."),
    ],
)
def test_text_is_plain(text, shown):
    assert lecture.format_plain_text(text) == shown


def test_no_markup_is_left():
    each = [x for section in SECTIONS for x in (*section.parts, *section.solution)]
    texts = [x for x in each if isinstance(x, str)]
    assert not [hit for x in texts for hit in re.findall(r"[\\${}`]|\*\*|</?details|<!--", x)]


@pytest.mark.parametrize("number", [0, 19, -1, 2.5])
def test_a_section_that_is_not_there_is_refused(number):
    with pytest.raises(
        InputError, match="section is .*there are: 1 From particles.*18 Constraints, again"
    ):
        lecture.choose_sections(number)


def test_values_and_what_is_printed_are_shown():
    names: dict = {}
    assert lecture.run_cell(Cell("x = 2\nprint('a')\nx + 1\n"), names) == "a\n3" and names["x"] == 2
    assert lecture.run_cell(Cell("x = 5\nx.no_such_thing\n", picture=True), names) == "", (
        "what draws is left out without a folder"
    )
    assert (
        lecture.add_prompts("for i in x:\n    f(i)\ng()")
        == ">>> for i in x:\n...     f(i)\n>>> g()"
    )


def test_what_needs_an_absent_package_is_left_out_with_what_depends_on_it():
    names: dict = {}
    said = lecture.run_cell(Cell("import no_such_package as n\n"), names)
    assert said == "left out: No module named 'no_such_package'"
    assert lecture.run_cell(Cell("print(n)\n"), names).startswith(
        "left out: name 'n' is not defined"
    )
    with pytest.raises(NameError):
        lecture.run_cell(Cell("print(n)\n"), {})


def test_the_command_prints_a_section():
    out = Result("tour", "--section", 3).out
    assert out.startswith("3 Constraints\n-------------\n\n>>> import kempe\n")
    assert (
        '>>> slider = kempe.load("slider")\n' in out
        and "\n1 parameter, 1 DoF, 5 constraints\n" in out
    )
    assert (
        "[picture: --pictures FOLDER draws it]" in out and "Solution:" not in out
    ) and "Enter" not in out
    exercise, solution = out.split("\nSolutions\n---------\n")
    assert "Exercise. How many constraints" in exercise and ">>> ball, pin = " not in exercise
    assert solution.startswith("\n3 Constraints:\n\n6 - 3 = 3") and "\n3 2\n" in solution
    assert "The joints (docs/joints.md) has" in Result("tour", "--section", 5).out


def test_the_command_as_json():
    (section,) = Result("tour", "--section", 2, "--json").json()["sections"]
    assert (section["section"], section["title"]) == (2, "A multibody system")
    assert {"output": "(8, 4, 4)"} in section["parts"] and {"output": "J1\nJ4\nJ5"} in section[
        "parts"
    ]


def test_the_command_draws(tmp_path):
    pytest.importorskip("matplotlib")
    to = tmp_path / "new" / "pictures"
    assert f"[picture: {to / '14_1.png'}]" in Result("tour", "--section", 14, "--pictures", to).out
    assert (to / "14_1.png").read_bytes().startswith(b"\x89PNG")


def test_wrong_use_of_the_command(tmp_path):
    assert Result("tour", "--section", 40).code == 2
    (tmp_path / "file").write_text("")
    refused = Result("tour", "--section", 2, "--pictures", tmp_path / "file")
    assert refused.code == 2 and "file" in refused.err


@pytest.mark.parametrize(
    ("keys", "shown"), [(["q"], 1), (["", " Quit"], 2), (["", "", EOFError()], 3), ([""] * 18, 18)]
)
def test_enter_goes_on_and_q_ends(keys, shown, monkeypatch, capsys):
    from kempe.cli import model_commands

    answers = iter(keys)

    def typed(prompt: str) -> str:
        assert prompt == "Enter goes on, q ends: "
        key = next(answers)
        if isinstance(key, EOFError):
            raise key
        return key

    class Terminal:
        def isatty(self) -> bool:
            return True

    monkeypatch.setattr("builtins.input", typed)
    monkeypatch.setattr(model_commands.sys, "stdin", Terminal())
    monkeypatch.setattr(model_commands.sys.stdout, "isatty", lambda: True, raising=False)
    monkeypatch.setattr(
        lecture, "iterate_parts", lambda section, pictures: [("text", section.title)]
    )
    model_commands.run_tour()
    out = capsys.readouterr().out
    assert [x.number for x in SECTIONS if f"{x.number} {x.title}\n-" in out] == list(
        range(1, shown + 1)
    )
    assert next(answers, None) is None, "no further question"


@pytest.mark.slow
@pytest.mark.skipif(
    find_spec("matplotlib") is None or find_spec("sympy") is None, reason="needs extras"
)
def test_the_whole_tour_with_its_pictures(tmp_path):
    done = Result("tour", "--all", "--pictures", tmp_path)
    pictures = [
        x for section in SECTIONS for x in section.parts if isinstance(x, Cell) and x.picture
    ]
    assert done.code == 0 and "left out" not in done.out and "FOLDER" not in done.out
    assert len(list(tmp_path.glob("*.png"))) == len(pictures) >= 28
