"""The command for the library of models."""

from __future__ import annotations

from typing import Annotated

import typer

from kempe.cli.app import MODELS, Json, app
from kempe.views.terminal import guarded, print_json, show


@app.command(rich_help_panel=MODELS)
@guarded
def library(
    name: Annotated[str | None, typer.Argument(metavar="NAME", help="Print this model's TOML.")] = None,
    json: Json = False,
) -> None:
    """List the shipped models, or print one as TOML.

    Example: kempe library puma560
    """
    from kempe.views import facts, report

    if name is not None:
        text = facts.model_text(name)
        print_json({"name": name, "toml": text}) if json else print(text, end="")
        return
    found = facts.models()
    if json:
        print_json([{"name": n, "description": d} for n, d in found.items()])
    else:
        show(report.table(("model", "what it is"), found.items()))
