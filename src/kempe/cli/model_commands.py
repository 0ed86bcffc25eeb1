"""Commands for the shipped models, the joint types and the tour of the lecture."""

from __future__ import annotations

import itertools
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated

import typer

from kempe.cli.app import MODELS, Output, check_picture_file, register_command
from kempe.cli.description_commands import NoBrowser, PagePath, Port, run_view
from kempe.cli.options import make_option
from kempe.cli.terminal import print_json
from kempe.errors import InputError
from kempe.report import Table

DEMO = "panda"
"""The model that `kempe demo` shows."""


@register_command(MODELS)
def run_demo(
    output: Output, html: PagePath = None, port: Port = None, no_browser: NoBrowser = False
) -> None:
    """Show a shipped arm in the browser.

    Example: kempe demo
    """
    run_view(file=DEMO, html=html, port=port, no_browser=no_browser, json=output.json)


@register_command(MODELS)
def run_library(
    output: Output,
    name: Annotated[
        str | None, typer.Argument(metavar="NAME", help="Print this model's TOML.")
    ] = None,
) -> None:
    """List the shipped models, or print one as TOML.

    Example: kempe library puma560
    """
    from kempe import library as models

    if name is not None:
        text = models.find_model_file(name).read_text(encoding="utf-8")
        print_json({"name": name, "toml": text}) if output.json else print(text, end="")
        return
    rows = [(n, models.describe_model(n)) for n in models.list_models()]
    if output.json:
        print_json([{"name": n, "description": text} for n, text in rows])
    else:
        print("\n".join(Table(("model", "what it is"), rows).align_columns()))


@register_command(MODELS, "plot json")
def run_joints(output: Output) -> None:
    """List the joint types: letters, freedoms, constraints, what they are made of; or draw them all
    in one picture.

    Example: kempe joints --plot joints.png
    """
    from kempe.views import overviews

    kinds = overviews.list_joint_types()
    if output.plot is not None:
        output.save_picture(overviews.plot_joints(), output.plot)
    if output.json:
        print_json({"joints": kinds, "written": [str(path) for path in output.written]})
        return
    heads = ("joint", "letter", "freedoms", "constraints", "in the plane", "made of")
    keys = ("type", "letter", "dof", "constraints", "dof_in_the_plane", "made_of")
    rows = [["-" if row[key] is None else row[key] for key in keys] for row in kinds]
    print("\n".join(Table(heads, rows).align_columns()))
    output.print_answers()


@register_command(MODELS)
def run_tour(
    output: Output,
    number: Annotated[
        int | None, make_option("--section", "Only the section of this number.", "N")
    ] = None,
    every: Annotated[bool, make_option("--all", "Print all sections without pauses.")] = False,
    pictures: Annotated[
        Path | None, make_option("--pictures", "Write the pictures into this folder.", "FOLDER")
    ] = None,
) -> None:
    """Walk through the lecture: its sections, their code, and what comes out. Enter goes on, q
    ends. Solutions of the exercises come last.

    Example: kempe tour --section 3
    """
    from kempe.library import lecture

    found = lecture.choose_sections(number)
    if pictures is not None:
        if pictures.exists() and not pictures.is_dir():
            raise InputError(
                f"{pictures}: this is no folder; --pictures names the folder of the pictures"
            )
        pictures.mkdir(parents=True, exist_ok=True)
        check_picture_file(pictures / "01.png")
    if output.json:
        parts = [
            {
                "section": x.number,
                "title": x.title,
                "parts": [{k: v} for k, v in lecture.iterate_parts(x, pictures)],
            }
            for x in found
        ]
        print_json({"sections": parts})
        return
    pause = not every and sys.stdin.isatty() and sys.stdout.isatty()
    solutions: list[tuple[str, list[tuple[str, str]]]] = []
    for i, x in enumerate(found):
        if i and pause and _is_tour_ended():
            return
        heading = f"{x.number} {x.title}"
        print(f"{heading}\n{'-' * len(heading)}\n")
        parts = iter(lecture.iterate_parts(x, pictures))
        _print_parts(itertools.takewhile(lambda part: part[0] != "solution", parts))
        solutions.append((heading, list(parts)))
    if pause and _is_tour_ended():
        return
    print("Solutions\n---------\n")
    for heading, parts in solutions:
        print(f"{heading}:\n")
        _print_parts(parts)


def _print_parts(parts: Iterable[tuple[str, str]]) -> None:
    """Print the parts of a section, each as it comes."""
    from kempe.library import lecture

    code = False
    for kind, text in parts:
        said = {"code": lecture.add_prompts, "picture": "[picture: {}]".format}.get(kind, str)
        print(
            "\n" * (code and kind == "text") + said(text),
            end="\n" if kind == "code" else "\n\n",
        )
        code = kind == "code"
    if code:
        print()


def _is_tour_ended() -> bool:
    """Whether the reader ends the tour at this point."""
    try:
        return input("Enter goes on, q ends: ").strip().lower().startswith("q")
    except EOFError:
        return True
