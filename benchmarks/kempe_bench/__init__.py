"""Kempe beside other kinematics libraries, in one run on one machine: `benchmark` yields the
tables.
"""

from __future__ import annotations

import datetime
from collections.abc import Callable, Iterable, Iterator

import rich.table
from rich.console import Group, RenderableType
from rich.text import Text

from kempe.errors import UnknownNameError
from kempe_bench import (
    analytic,
    clearances,
    cranks,
    forward,
    freedoms,
    holding,
    inverse,
    loops,
    motions,
    numeric,
    parallel,
    peers,
    process,
    reading,
    redundant,
    servo,
    trees,
    ways,
    whole,
    workspaces,
)
from kempe_bench.bench import Bench
from kempe_bench.timing import Table

SECTIONS: dict[str, Callable[[Bench], Table | None]] = {
    "batch": forward.batch,
    "single": forward.single,
    "tree": trees.humanoid,
    "threads": forward.threads,
    "growth": trees.growth,
    "inverse": inverse.single,
    "numeric": numeric.random,
    "numeric_limits": numeric.limits,
    "numeric_warm": numeric.warm,
    "servo": servo.stream,
    "distances": clearances.distances,
    "pushed": clearances.push,
    "obstacles": clearances.reach,
    "redundant": redundant.paths_and_sets,
    "whole_body": whole.anywhere,
    "whole_body_near": whole.standing,
    "parallel": parallel.platforms,
    "closed": analytic.closed,
    "general": analytic.general,
    "assembly": loops.assembly,
    "success": loops.success,
    "dyads": cranks.dyads,
    "row": cranks.row,
    "motions": motions.motions,
    "chains": motions.chains,
    "dof": freedoms.dof,
    "mobility": freedoms.mobility,
    "classify": holding.classify,
    "laws": holding.laws,
    "workspace": workspaces.binned,
    "paths": ways.planar,
    "files": reading.files,
    "startup": process.startup,
    "memory": process.memory,
}
"""The parts of the benchmark, in their order."""


def benchmark(
    sections: Iterable[str] | None = None,
    wanted: list[str] | None = None,
    say: Callable[[str], None] = lambda text: None,
    targets: int | None = None,
) -> Iterator[Table]:
    """Measured tables, one by one as they are done, so that an interruption loses only the section
    in work.

    `sections` picks some of `SECTIONS`, `wanted` some of the peers; `say` receives what is being
    measured. `targets` of each robot are given to the numerical inverse model, of chains and whole
    bodies, instead of as many as fit into a minute or two.
    Errors: `UnknownNameError`.
    """
    names = list(SECTIONS if sections is None else sections)
    for name in names:
        if name not in SECTIONS:
            raise UnknownNameError("section", name, SECTIONS)
    bench = Bench(wanted, say, targets)
    for i, name in enumerate(names, start=1):
        section = SECTIONS[name]
        say(f"{i}/{len(names)} {name}: {(section.__doc__ or '').strip().splitlines()[0]}")
        table = section(bench)
        if table is not None:
            table.remarks += table.behind()
            table.remarks.append(f"load average of the machine: {peers.load():.1f}")
            yield table


def page(tables: Iterable[Table], wanted: list[str] | None = None) -> str:
    """The tables as one Markdown page, with the machine and the versions."""
    from kempe import __version__

    versions = {"kempe": __version__, **peers.installed(wanted)}
    head = [
        "# Benchmark",
        "",
        "Medians of one run in which the libraries take turns: ratios hold although times differ "
        "from",
        "machine to machine. A ratio is to the first line of its table. Goals for absolute times "
        "judge the best turn.",
        "",
        f"- Machine: {peers.machine()}",
        f"- Versions: {', '.join(f'{k} {v}' for k, v in versions.items())}",
        f"- Date: {datetime.date.today().isoformat()}",
        "",
    ]
    return "\n".join([*head, *(t.markdown() for t in tables)])


def shown(result: Table) -> RenderableType:
    """A table with its goals and remarks, for the terminal."""
    header, cells = result.columns()
    goals = [Text(f"  {goal}", style="green" if goal.met else "red") for goal in result.goals]
    remarks = [Text(f"  {remark}") for remark in result.remarks]
    table = rich.table.Table(
        box=None,
        pad_edge=False,
        padding=(0, 2, 0, 0),
        title=Text(result.title),
        title_justify="left",
        title_style="bold",
        header_style="bold",
    )
    for k, name in enumerate(header):
        number = k >= result.words
        table.add_column(Text(name), justify="right" if number else "left", no_wrap=number)
    for row in cells:
        table.add_row(*map(Text, row))
    return Group(table, *goals, *remarks, "")
