"""The application: options that commands share, reading of files, writing of results.

Exit codes: 0 the answer is complete; 1 it is not (no solution found, problems in a file, rows that
are no numbers, a time limit); 2 the question could not be posed (wrong usage, unknown name, a file
that cannot be read); 130 Ctrl-C, where files that were requested hold what was done.
"""

from __future__ import annotations

import functools
import inspect
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer

from kempe.answers.wording import immovable
from kempe.cli.terminal import COMPLETE, Commands, UsageError, print_json, refuse
from kempe.description.formats import named, read_by
from kempe.description.source import expanded, no_file
from kempe.errors import InputError, KernelsError
from kempe.version import __version__

if TYPE_CHECKING:
    from kempe.system import System

app = typer.Typer(
    cls=Commands,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
    context_settings={"help_option_names": ["-h", "--help"]},
    epilog=f"FILE is a file in {named(read_by())}, or the name of a shipped model. "
    "Exit codes: 0 complete, 1 no solution, problems or a time limit, 2 wrong usage or unreadable "
    "file, 130 Ctrl-C.",
)


def option(flags: str, help: str, metavar: str | None = None, panel: str | None = None) -> Any:
    """An option of a command, without `metavar` a switch that takes no value."""
    return typer.Option(*flags.split(","), help=help, metavar=metavar or "", rich_help_panel=panel)


# ---- options

DESCRIBE = "Describe and convert"
OPEN = "Positions"
CLOSED = "Closed loops"
MODELS = "Models"
"""Titles over the commands in the help."""

TimeLimit = Annotated[
    float | None,
    option("--time-limit", "Seconds after which it ends with what was done.", "SECONDS"),
]

Threads = Annotated[int | None, option("--threads", "Threads; all processors if not given.", "N")]
Scheduler = Annotated[
    str | None, option("--scheduler", "Address of the scheduler of a Dask cluster.", "ADDRESS")
]

_READ = "How FILE is read"
File = Annotated[
    str,
    typer.Argument(metavar="FILE", help=f"File in {named(read_by())}, or a shipped model's name."),
]
Json = Annotated[bool, option("--json", "Print JSON.")]
Deg = Annotated[bool, option("--deg", "Angles are degrees, read and printed; lengths stay metres.")]
Out = Annotated[
    Path | None, option("-o,--out", "Write the results to a .csv or .npy file.", "FILE")
]
InPlace = Annotated[Path | None, option("-o,--out", "The file to write, in place of OUT.", "FILE")]
_FREE = f"'free': what nothing ties to the ground moves freely ({named(read_by('base'))})."
Base = Annotated[str | None, option("--base", _FREE, "free", _READ)]
Root = Annotated[
    str | None, option("--root", "Link to take as root where FILE leaves it open.", "LINK", _READ)
]
_MODEL = f"The model to read where FILE has several ({named(read_by('model'))})."
Model = Annotated[str | None, option("--model", _MODEL, "NAME", _READ)]
Dirs = Annotated[
    list[Path] | None,
    option("--package-dir", "Folder with packages or meshes; can be repeated.", "FOLDER", _READ),
]
Xacro = Annotated[
    bool, option("--xacro", "Expand xacro first: a program, so only if you trust it.", None, _READ)
]
_ARGUMENT = "Value of a <xacro:arg> of FILE, which is then expanded; can be repeated."
XacroArguments = Annotated[list[str] | None, option("--xacro-arg", _ARGUMENT, "NAME=VALUE", _READ)]
_LENIENT = (
    "Limits without a range (no bounds, or swapped), and negative ones of effort, are none "
    f"({named(read_by('lenient_limits'))})."
)
Lenient = Annotated[bool, option("--lenient-limits", _LENIENT, None, _READ)]
_SRDF = "SRDF of the robot: groups, postures, end effectors, how the base moves."
SrdfFile = Annotated[Path | None, option("--srdf", _SRDF, "FILE", _READ)]

FrameOrAll = Annotated[
    str | None, option("--frame", "Body or frame; all bodies if not given.", "NAME")
]
Values = Annotated[
    str | None,
    option(
        "--q", "a,b,c or name=value,... or a .csv or .npy file, one configuration a row.", "VALUES"
    ),
]
Posture = Annotated[
    str | None,
    option(
        "--posture", "A posture of FILE, 'neutral' or 'mid'; --q name=value changes it.", "NAME"
    ),
]
_ROWS = "x,y,z,roll,pitch,yaw (fixed axes) or x,y,z; or a .csv or .npy file."
FrameOrTasks = Annotated[
    str | None, option("--frame", "Body or frame that shall reach the target.", "NAME")
]
TargetOrTasks = Annotated[str | None, option("--target", _ROWS, "VALUES")]
PathTargets = Annotated[
    str | None,
    option("--targets,--target", "A .csv or .npy file, a target a row, as for ik.", "FILE"),
]
Tasks = Annotated[
    Path | None,
    option("--tasks", "Several tasks in place of a frame and its target: a .toml file.", "FILE"),
]
Prefer = Annotated[
    str | None,
    option("--prefer", "What tasks leave free: 'nearest', 'mid' or 'manipulability'.", "WHAT"),
]
PositionOnly = Annotated[bool, option("--position-only", "Leave the orientation free.")]
Seed = Annotated[
    str | None, option("--start,--seed", "Configuration to start from, as --q of fk.", "VALUES")
]
Rng = Annotated[int | None, option("--rng", "Number that fixes the random starts (0).", "N")]
Tolerance = Annotated[
    str | None,
    option(
        "--tolerance",
        "Largest errors accepted, metres and radians (1e-6; with --all 1e-9).",
        "M[,RAD]",
    ),
]
PathTolerance = Annotated[
    str | None,
    option("--tolerance", "Largest errors accepted, metres and radians (1e-10).", "M[,RAD]"),
]
_ALL = "All solutions"
All = Annotated[
    bool, option("--all", "All configurations that reach the target, in closed form.", None, _ALL)
]
Task = Annotated[
    str | None,
    option(
        "--task", "What counts: pose, position, orientation, direction or position_axis.", "TASK"
    ),
]
Axis = Annotated[
    str | None,
    option("--axis", "Axis of the tool for the last two tasks: z, -x or x,y,z (z).", "AXIS"),
]
Hold = Annotated[
    list[str] | None,
    option("--hold", "Hold a joint of a redundant chain; can be repeated.", "NAME=VALUE", _ALL),
]
PICTURES = (".png", ".svg", ".pdf")
Picture = Annotated[
    Path | None, option("--plot", "Draw a .png, .svg or .pdf file (needs matplotlib).", "FILE")
]
Film = Annotated[
    Path | None, option("--gif,--mp4", "Write the motion as a .gif or .mp4 file.", "FILE")
]
Page = Annotated[
    Path | None,
    option("--html", "Write a page in which it can be turned, and moves, without network.", "FILE"),
]


# ---- files and results


class Reading(dict[str, Any]):
    """The options with which `kempe.load` reads FILE, without those that were not given."""


def _reading(
    base: Base = None,
    root: Root = None,
    model: Model = None,
    package_dir: Dirs = None,
    xacro: Xacro = False,
    xacro_arg: XacroArguments = None,
    lenient_limits: Lenient = False,
    srdf: SrdfFile = None,
) -> Reading:
    given = {
        "base": base,
        "root": root,
        "model": model,
        "package_dirs": package_dir,
        "xacro": _values(xacro_arg, "--xacro-arg") if xacro_arg else xacro,
        "lenient_limits": lenient_limits,
        "srdf": srdf,
    }
    return Reading((name, value) for name, value in given.items() if value)


def _values(given: list[str], flag: str) -> dict[str, str]:
    """The values of an option that is repeated as NAME=VALUE. Errors: `UsageError`."""
    values: dict[str, str] = {}
    for text in given:
        name, sign, value = text.partition("=")
        if not sign or not name:
            raise UsageError(f"{flag} {text}: it must be NAME=VALUE.")
        if name in values:
            raise UsageError(f"{flag} gives {name} twice.")
        values[name] = value
    return values


def reads_file(command: Callable[..., None]) -> Callable[..., None]:
    """The command with the options of how FILE is read in place of its parameter `reading`."""
    shared = inspect.signature(_reading, eval_str=True).parameters
    own = inspect.signature(command, eval_str=True).parameters
    parameters = [*(p for name, p in own.items() if name != "reading"), *shared.values()]

    @functools.wraps(command)
    def run(**options: Any) -> None:
        given = {name: options.pop(name, p.default) for name, p in shared.items()}
        command(reading=_reading(**given), **options)

    run.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    run.__annotations__ = {p.name: p.annotation for p in parameters}
    return run


def load(file: str, reading: Reading) -> System:
    """The system of a file."""
    import kempe

    system = kempe.load(file, **reading)
    if still := immovable(system, unstated=True):
        remark(still)
    return system


@app.callback(invoke_without_command=True)
def main_options(
    context: typer.Context,
    version: Annotated[
        bool, option("--version", "Print the version, and which kernels run.")
    ] = False,
) -> None:
    """Analyse the kinematics of mechanisms: where bodies are, what reaches a pose, how closed loops
    move.
    """
    if version:
        try:
            from kempe.kernels.compiled import VARIANT
        except KernelsError as error:
            print(f"kempe {__version__}")
            refuse(error)
        print(f"kempe {__version__}, kernels {VARIANT}")
    elif context.invoked_subcommand is None:
        print(context.get_help())
    else:
        return
    raise typer.Exit(COMPLETE)


def writable(path: Path | None) -> None:
    """Refuse a file that cannot be written, before any work. Errors: `InputError`."""
    if path is None:
        return
    if path.is_dir():
        raise InputError(f"{path}: this is a folder; name a file in it")
    if what := no_file(path):
        raise InputError(f"{path}: this is {what}; name a plain file")
    if not path.parent.is_dir():
        raise InputError(f"{path}: there is no folder {str(path.parent)!r}")
    if not os.access(path if path.exists() else path.parent, os.W_OK):
        raise InputError(f"{path}: it may not be written")


def results(path: Path | None, *read: object) -> None:
    """Refuse an ending or a place that results cannot be written to, before any work. Errors:
    `InputError`.

    Nor are they written over a file of rows that the command reads.
    """
    from kempe.cli import table_files

    table_files.output(path)
    writable(path)
    if path is None or not path.exists():
        return
    for given in read:
        if (
            isinstance(given, (str, Path))
            and table_files.is_file(str(given))
            and expanded(given).exists()
        ):
            if path.samefile(expanded(given)):
                raise InputError(
                    f"{path}: the command reads this file; write the results to another one"
                )


def remark(text: str) -> None:
    """Say something beside the answer, on standard error."""
    from kempe.cli.report import in_options

    print(f"kempe: {in_options(text)}", file=sys.stderr, flush=True)


def written_to(out: Path | None, option: Path | None) -> Path:
    """The file to write, given as an argument or as the option -o. Errors: `InputError`."""
    if (out is None) == (option is None):
        raise UsageError(
            "Missing argument 'OUT'." if out is None else "OUT is given twice: leave -o out."
        )
    return out or option  # type: ignore[return-value]


def say_written(out: Path, json: bool) -> None:
    """Say which file was written."""
    print_json({"written": str(out)}) if json else print(f"written to {out}")


def drawable(plot: Path | None, film: Path | None = None, page: Path | None = None) -> None:
    """Refuse a picture, a moving one, or a page that cannot be written, before any work. Errors:
    `InputError`, ...
    """
    if plot is not None:
        if plot.suffix.lower() not in PICTURES:
            raise InputError(f"{plot}: pictures are .png, .svg or .pdf files")
        writable(plot)
        import kempe.views.drawing  # noqa: F401  it refuses where matplotlib is missing
    if film is not None:
        from kempe.views.films import film_file

        film_file(film)
        writable(film)
    if page is not None:
        from kempe.views.viewer.pages import page_file

        page_file(page)
        writable(page)


def save_picture(axes: Any, path: Path) -> None:
    """Write the figure of these axes to a file."""
    axes.figure.savefig(path, dpi=200, bbox_inches="tight")


def drawn(
    system: System,
    found: Any,
    plot: Path | None,
    film: Path | None = None,
    page: Path | None = None,
    *,
    draw: Callable[[], Any] | None = None,
    **options: Any,
) -> list[Path]:
    """Draw configurations, or an answer with them, into the files that are given; those written.

    None is the configuration that is drawn by default. A film needs several of them. `draw` gives
    the axes of a picture that is another one than that of `System.plot`.
    """
    files = {path for path in (plot, film, page) if path is not None}
    if not files:
        return []
    if found is None:
        from kempe.views.plots import configuration_of

        found = configuration_of(system, None)
    rows = np.reshape(getattr(found, "q", found), (-1, system.nq))
    finite = int(np.isfinite(rows).all(axis=1).sum())
    left = files if not finite else {path for path in files if path == film and finite < 2}
    for path in left:
        why = "one configuration does not move" if finite else "there is no configuration to draw"
        remark(f"{path} is not written: {why}")
    files -= left
    if plot is not None and plot in files:
        axes = system.plot(found, **options) if draw is None else draw()
        save_picture(np.ravel(np.array(axes, dtype=object))[0], plot)
    way = found if np.ndim(getattr(found, "q", found)) == 2 else rows
    if film is not None and film in files:
        system.animate(way, film, frames=options.get("frames", ()))
    if page is not None and page in files:
        from kempe.views.viewer.pages import write_page

        if said := write_page(system, page, path=way).lost_sentence:
            remark(said)
    return [path for path in (plot, film, page) if path is not None and path in files]


def say_drawn(files: list[Path]) -> None:
    """Say beside the answer which files were written."""
    for path in files:
        remark(f"written to {path}")
