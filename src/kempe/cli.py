"""The command line: each command is a few lines over the library.

Exit codes: 0 the answer is complete; 1 it is not (no solution found, problems in a file, rows that are no
numbers); 2 the question could not be asked (wrong usage, unknown name, a file that cannot be read).
"""

from __future__ import annotations

import io
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from kempe import __version__
from kempe.errors import InputError
from kempe.views.terminal import COMPLETE, INCOMPLETE, Commands, guarded, print_json, show

if TYPE_CHECKING:
    from kempe.model.system import System

app = typer.Typer(
    cls=Commands, add_completion=False, pretty_exceptions_enable=False, rich_markup_mode="rich",
    context_settings={"help_option_names": ["-h", "--help"]},
    epilog="FILE is a URDF or TOML file, or the name of a shipped model. "
    "Exit codes: 0 complete, 1 no solution or problems found, 2 wrong usage or unreadable file.",
)  # fmt: skip


def _option(flag: str, help: str, metavar: str | None = None, panel: str | None = None) -> Any:
    return typer.Option(flag, help=help, metavar=metavar, rich_help_panel=panel)


_READ = "How FILE is read"
File = Annotated[str, typer.Argument(metavar="FILE", help="URDF or TOML file, or a shipped model's name.")]
Json = Annotated[bool, _option("--json", "Print JSON.")]
Deg = Annotated[bool, _option("--deg", "Angles are degrees, read and printed; lengths stay metres.")]
Out = Annotated[Path | None, _option("--out", "Write the results to a .csv or .npy file.", "FILE")]
Base = Annotated[str | None, _option("--base", "'free': the root link moves freely (URDF).", "free", _READ)]
Root = Annotated[str | None, _option("--root", "Link to take as root where FILE leaves it open.", "LINK", _READ)]
Dirs = Annotated[
    list[Path] | None, _option("--package-dir", "Folder for package://; can be repeated.", "FOLDER", _READ)
]
Xacro = Annotated[bool, _option("--xacro", "Expand xacro first: a program, so only if you trust it.", None, _READ)]

FrameOrAll = Annotated[str | None, _option("--frame", "Body or frame; all bodies if not given.", "NAME")]
Values = Annotated[
    str | None,
    _option("--q", "a,b,c or name=value,... or a .csv or .npy file, one configuration a row.", "VALUES"),
]
Posture = Annotated[
    str | None,
    _option("--posture", "A posture of FILE, 'neutral' or 'mid'; --q name=value changes it.", "NAME"),
]
Frame = Annotated[str, _option("--frame", "Body or frame that shall reach the target.", "NAME")]
Target = Annotated[
    str, _option("--target", "x,y,z,roll,pitch,yaw (fixed axes) or x,y,z; or a .csv or .npy file.", "VALUES")
]
PositionOnly = Annotated[bool, _option("--position-only", "Leave the orientation free.")]
Seed = Annotated[str | None, _option("--seed", "Configuration to start from, as --q of fk.", "VALUES")]
Rng = Annotated[int, _option("--rng", "Number that fixes the random starts.", "N")]
Tolerance = Annotated[str, _option("--tolerance", "Largest errors accepted, metres and radians.", "M[,RAD]")]


# ---- what all commands share


def _options(base: str | None, root: str | None, package_dir: list[Path] | None, xacro: bool) -> dict[str, Any]:
    """The reader's options, without those that were not given."""
    given = {"base": base, "root": root, "package_dirs": package_dir, "xacro": xacro}
    return {k: v for k, v in given.items() if v}


def _load(file: str, *options: Any) -> System:
    import kempe

    return kempe.load(file, **_options(*options))


# ---- describe


@app.callback(invoke_without_command=True)
def main_options(
    context: typer.Context,
    version: Annotated[bool, typer.Option("--version", help="Print the version.")] = False,
) -> None:
    """Where every body of a mechanism is, and which configurations reach a pose."""
    if version:
        print(f"kempe {__version__}")
    elif context.invoked_subcommand is None:
        print(context.get_help())
    else:
        return
    raise typer.Exit(COMPLETE)


@app.command()
@guarded
def info(
    file: File, deg: Deg = False, json: Json = False, base: Base = None, root: Root = None,
    package_dir: Dirs = None, xacro: Xacro = False,
) -> None:  # fmt: skip
    """Say what a system is: bodies, joints, loops, limits, frames.

    Example: kempe info panda.urdf
    """
    system = _load(file, base, root, package_dir, xacro)
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
        problems, notes = check_(file, **_options(base, root, package_dir, xacro))
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

    mechanism = kempe.read(file, **_options(base, root, package_dir, xacro))
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
    system = _load(file, base, root, package_dir, xacro)
    from kempe.views import facts, report, rows

    if frame is not None:
        system.frame_name(frame)  # a wrong name is told before kernels are compiled
    rows.output(out)
    values = rows.configuration(system, q, posture, deg)
    X = system.fk(values, frame)
    if out is not None:
        rows.write_poses(out, X, frame is None, deg)
        _told(out, json)
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
    system = _load(file, base, root, package_dir, xacro)
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
            _told(out, json)
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
    only: Annotated[list[str] | None, _option("--only", "A section to run; can be repeated.", "SECTION")] = None,
    peer: Annotated[list[str] | None, _option("--peer", "A library to compare with; can be repeated.", "NAME")] = None,
    out: Annotated[
        Path | None, _option("--out", "Write the tables to a Markdown file, section by section.", "FILE")
    ] = None,
    json: Json = False,
) -> None:
    """Measure Kempe beside the other libraries installed (minutes).

    Example: kempe bench --only batch --only inverse --out results.md
    """
    from kempe.views import benchmark, report

    tables: list[benchmark.Table] = []
    for table in benchmark.benchmark(only, peer, _progress):
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


def _progress(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def _told(out: Path, json: bool) -> None:
    print_json({"written": str(out)}) if json else print(f"written to {out}")


def main() -> None:
    """Entry point of the command `kempe`."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    app(prog_name="kempe")
