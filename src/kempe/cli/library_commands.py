"""Commands for what is shipped: models, joint types."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from kempe.cli.app import MODELS, Json, Picture, app, drawable, option, save_picture, say_written
from kempe.cli.terminal import guarded, print_json, show
from kempe.errors import InputError


@app.command(rich_help_panel=MODELS)
@guarded
def library(
    name: Annotated[
        str | None, typer.Argument(metavar="NAME", help="Print this model's TOML.")
    ] = None,
    json: Json = False,
) -> None:
    """List the shipped models, or print one as TOML.

    Example: kempe library puma560
    """
    from kempe.cli import as_json, report

    if name is not None:
        text = as_json.model_text(name)
        print_json({"name": name, "toml": text}) if json else print(text, end="")
        return
    found = as_json.models()
    if json:
        print_json([{"name": n, "description": d} for n, d in found.items()])
    else:
        show(report.table(("model", "what it is"), found.items()))


@app.command(rich_help_panel=MODELS)
@guarded
def joints(plot: Picture = None, json: Json = False) -> None:
    """List the joint types: letters, freedoms, constraints, what they are made of; or draw them all
    in one picture.

    Example: kempe joints --plot joints.png
    """
    from kempe.cli import report
    from kempe.views import overviews

    drawable(plot)
    found = overviews.joint_rows()
    if plot is not None:
        save_picture(overviews.plot_joints()[0], plot)
    if json:
        print_json({"joints": found, "written": [] if plot is None else [str(plot)]})
        return
    heads = ("joint", "letter", ">freedoms", ">constraints", ">in the plane", "made of")
    show(
        report.table(
            heads,
            [
                ["-" if x is None else x for x in list(row.values())[:5]] + [row["made_of"]]
                for row in found
            ],
        )
    )
    if plot is not None:
        say_written(plot, False)


@app.command(rich_help_panel=MODELS)
@guarded
def tour(
    number: Annotated[
        int | None, option("--section", "Only the section of this number.", "N")
    ] = None,
    every: Annotated[bool, option("--all", "Print all sections without pauses.")] = False,
    pictures: Annotated[
        Path | None, option("--pictures", "Draw the pictures into this folder.", "FOLDER")
    ] = None,
    json: Json = False,
) -> None:
    """Walk through the lecture: its sections, their code, and what comes out. Enter goes on, q
    ends.

    Example: kempe tour --section 3
    """
    from kempe.library import lecture

    found = lecture.chosen(number)
    if pictures is not None:
        if pictures.exists() and not pictures.is_dir():
            raise InputError(
                f"{pictures}: this is no folder; --pictures names the folder of the pictures"
            )
        pictures.mkdir(parents=True, exist_ok=True)
        drawable(pictures / "01.png")
    if json:
        parts = [
            {
                "section": x.number,
                "title": x.title,
                "parts": [{k: v} for k, v in lecture.walk(x, pictures)],
            }
            for x in found
        ]
        print_json({"sections": parts})
        return
    pause = not every and sys.stdin.isatty() and sys.stdout.isatty()
    for i, x in enumerate(found):
        if i and pause and _ended():
            return
        heading = f"{x.number} {x.title}"
        print(f"{heading}\n{'-' * len(heading)}\n")
        code = False
        for kind, text in lecture.walk(x, pictures):
            said = {"code": lecture.prompted, "picture": "[picture: {}]".format}.get(kind, str)
            print(
                "\n" * (code and kind == "text") + said(text),
                end="\n" if kind == "code" else "\n\n",
            )
            code = kind == "code"
        if code:
            print()


def _ended() -> bool:
    """Whether the reader ends the tour here."""
    try:
        return input("Enter goes on, q ends: ").strip().lower().startswith("q")
    except EOFError:
        return True
