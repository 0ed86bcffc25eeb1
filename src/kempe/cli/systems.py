"""Commands that describe systems and solve open chains; each is a few lines over the library."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from kempe.cli.app import (
    Base,
    Deg,
    Dirs,
    File,
    Frame,
    FrameOrAll,
    Json,
    Out,
    PositionOnly,
    Posture,
    Rng,
    Root,
    Seed,
    Target,
    Tolerance,
    Values,
    Xacro,
    app,
    load,
    option,
    progress,
    reading,
    told,
)
from kempe.errors import InputError
from kempe.views.terminal import COMPLETE, INCOMPLETE, guarded, print_json, show

# ---- describe


@app.command()
@guarded
def info(
    file: File, deg: Deg = False, json: Json = False, base: Base = None, root: Root = None,
    package_dir: Dirs = None, xacro: Xacro = False,
) -> None:  # fmt: skip
    """Say what a system is: bodies, joints, loops, limits, frames.

    Example: kempe info panda.urdf
    """
    system = load(file, base, root, package_dir, xacro)
    from kempe.views import facts, report

    if json:
        print_json(facts.system_facts(system, deg))
    else:
        show(report.info(system, deg))


@app.command()
@guarded
def check(
    files: Annotated[list[str], typer.Argument(metavar="FILE...", help="URDF or TOML files.")],
    json: Json = False, base: Base = None, root: Root = None, package_dir: Dirs = None, xacro: Xacro = False,
) -> None:  # fmt: skip
    """List all problems of files, each with its line.

    Example: kempe check robots/*.urdf
    """
    from kempe.description.read import check as check_
    from kempe.views import facts, report

    results: list[dict[str, Any]] = []
    for file in files:
        problems, notes = check_(file, **reading(base, root, package_dir, xacro))
        results.append(
            {
                "file": file,
                "ok": not problems,
                "problems": [facts.problem_facts(p) for p in problems],
                "notes": list(notes),
            }
        )
        if not json:
            show(report.findings(file, problems, notes))
    if json:
        print_json(results)
    elif len(results) > 1:
        bad = sum(not r["ok"] for r in results)
        print(f"{len(results)} files: {len(results) - bad} good, {bad} with problems")
    raise typer.Exit(COMPLETE if all(r["ok"] for r in results) else INCOMPLETE)


@app.command()
@guarded
def convert(
    file: File, out: Annotated[Path, typer.Argument(metavar="OUT", help="File to write: .toml or .urdf.")],
    json: Json = False, base: Base = None, root: Root = None, package_dir: Dirs = None, xacro: Xacro = False,
) -> None:  # fmt: skip
    """Write a system in another format: .toml (everything) or .urdf (trees).

    Example: kempe convert panda.urdf panda.toml
    """
    import kempe
    from kempe.description.toml_writer import write_toml
    from kempe.description.urdf_writer import write_urdf

    mechanism = kempe.read(file, **reading(base, root, package_dir, xacro))
    mechanism.build()
    writers = {".toml": write_toml, ".urdf": write_urdf}
    if out.suffix.lower() not in writers:
        raise InputError(f"{out}: the format is told by the ending; it must be .toml or .urdf")
    out.write_text(writers[out.suffix.lower()](mechanism), encoding="utf-8")
    if json:
        print_json({"written": str(out), "name": mechanism.name, "notes": list(mechanism.notes)})
    else:
        print(f"{mechanism.name} written to {out}")


# ---- forward and inverse


@app.command()
@guarded
def fk(
    file: File,
    frame: FrameOrAll = None, q: Values = None, posture: Posture = None, deg: Deg = False, out: Out = None,
    json: Json = False, base: Base = None, root: Root = None, package_dir: Dirs = None, xacro: Xacro = False,
) -> None:  # fmt: skip
    """Say where a frame is, or all bodies are (forward model).

    Example: kempe fk panda.urdf --frame panda_hand_tcp --q 0,-45,0,-135,0,90,45,0.04 --deg
    """
    system = load(file, base, root, package_dir, xacro)
    from kempe.views import facts, report, rows

    if frame is not None:
        system.frame_name(frame)  # a wrong name is told before kernels are compiled
    rows.output(out)
    values = rows.configuration(system, q, posture, deg)
    X = system.fk(values, frame)
    if out is not None:
        rows.write_poses(out, X, frame is None, deg)
        told(out, json)
    elif json:
        print_json(facts.poses_facts(system, frame, X, deg))
    else:
        show(report.poses(system, frame, X, deg))
    bad = rows.not_finite(values)
    if bad:
        print(f"kempe: q is not finite in {report.rows_text(bad)}; poses there are NaN", file=sys.stderr)
        raise typer.Exit(INCOMPLETE)


@app.command()
@guarded
def ik(
    file: File, frame: Frame, target: Target, position_only: PositionOnly = False, seed: Seed = None,
    rng: Rng = 0, tolerance: Tolerance = "1e-6", deg: Deg = False, out: Out = None, json: Json = False,
    base: Base = None, root: Root = None, package_dir: Dirs = None, xacro: Xacro = False,
) -> None:  # fmt: skip
    """Find a configuration that brings a frame to a pose (inverse model).

    Example: kempe ik panda.urdf --frame panda_hand_tcp --target 0.4,0.1,0.5,180,0,0 --deg
    """
    system = load(file, base, root, package_dir, xacro)
    from kempe.views import facts, report, rows

    system.frame_name(frame)  # a wrong name is told before kernels are compiled
    rows.output(out)
    X, position = rows.target(system, target, deg)
    start = None if seed is None else rows.configuration(system, seed, None, deg)
    answer = system.ik(
        X,
        frame,
        seed=start,
        position_only=position or position_only,
        tolerance=rows.tolerance(tolerance),
        rng=rng,
    )
    if out is not None:
        rows.write_configurations(out, system, answer.q, deg)
    if json:
        print_json(facts.solution_facts(system, answer, deg))
    else:
        show(report.solution(system, answer, deg) if out is None else report.outcome(answer))
        if out is not None:
            told(out, json)
    if not answer:
        raise typer.Exit(INCOMPLETE)


# ---- the library of models, and the machine


@app.command()
@guarded
def library(
    name: Annotated[str | None, typer.Argument(metavar="[NAME]", help="Print this model's TOML.")] = None,
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


@app.command()
@guarded
def bench(
    only: Annotated[list[str] | None, option("--only", "A section to run; can be repeated.", "SECTION")] = None,
    peer: Annotated[list[str] | None, option("--peer", "A library to compare with; can be repeated.", "NAME")] = None,
    out: Annotated[
        Path | None, option("--out", "Write the tables to a Markdown file, section by section.", "FILE")
    ] = None,
    json: Json = False,
) -> None:
    """Measure Kempe beside the other libraries installed (minutes).

    Example: kempe bench --only batch --only inverse --out results.md
    """
    from kempe.views import benchmark, report

    tables: list[benchmark.Table] = []
    for table in benchmark.benchmark(only, peer, progress):
        tables.append(table)
        if out is not None:
            out.write_text(benchmark.page(tables, peer), encoding="utf-8")
        if not json:
            show(report.measured(table))
    if json:
        print_json({"machine": benchmark.peers.machine(), "tables": [t.data() for t in tables]})


@app.command()
@guarded
def warmup(json: Json = False) -> None:
    """Compile all kernels now, so that no later call has to wait."""
    import kempe

    seconds = kempe.warmup()
    if json:
        print_json({"seconds": seconds})
    else:
        print(f"all kernels are ready ({seconds:.1f} s)")


