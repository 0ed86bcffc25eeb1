"""Commands for the library of models and for this machine."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from kempe.cli.app import REST, Json, app, option, progress, writable
from kempe.views.terminal import guarded, print_json, show


@app.command(rich_help_panel=REST)
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


@app.command(rich_help_panel=REST)
@guarded
def bench(
    only: Annotated[list[str] | None, option("--only", "A section to run; can be repeated.", "SECTION")] = None,
    peer: Annotated[list[str] | None, option("--peer", "A library to compare with; can be repeated.", "NAME")] = None,
    targets: Annotated[
        int | None, option("--targets", "Targets of each robot in the numeric and whole_body sections.", "N")
    ] = None,
    out: Annotated[
        Path | None, option("-o,--out", "Write the tables to a Markdown file, section by section.", "FILE")
    ] = None,
    json: Json = False,
) -> None:
    """Measure Kempe beside the other libraries installed (minutes).

    Example: kempe bench --only batch --only inverse --out results.md
    """
    from kempe.views import benchmark, report

    writable(out)
    tables: list[benchmark.Table] = []
    for table in benchmark.benchmark(only, peer, progress, targets):
        tables.append(table)
        if out is not None:
            out.write_text(benchmark.page(tables, peer), encoding="utf-8")
        if not json:
            show(report.measured(table))
    if json:
        print_json({"machine": benchmark.peers.machine(), "tables": [t.data() for t in tables]})
