"""Typer application: options that commands share, reading of files, writing of results.

Exit codes: 0 the answer is complete; 1 it is not (no solution found, problems in a file, rows that
are no numbers, a time limit); 2 the question could not be posed (wrong usage, unknown name, a file
that cannot be read); 130 Ctrl-C, where files that were requested hold what was done.
"""

from __future__ import annotations

import functools
import inspect
import os
import sys
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer

from kempe.answers.tables import SUFFIXES, check_table_path
from kempe.answers.wording import describe_immovable_coordinates
from kempe.cli.terminal import (
    COMPLETE,
    Commands,
    UsageError,
    end_incomplete_command,
    print_answer,
    print_json,
    refuse_question,
    report_errors,
)
from kempe.description.formats import join_titles, list_readable_formats
from kempe.description.source import describe_special_file, expand_path
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
    epilog=f"FILE is a file in {join_titles(list_readable_formats())}, or the name of a shipped model. "
    "Exit codes: 0 complete, 1 no solution, problems or a time limit, 2 wrong usage or unreadable "
    "file, 130 Ctrl-C.",
)


def make_option(flags: str, help: str, metavar: str | None = None, panel: str | None = None) -> Any:
    """Return an option of a command; without `metavar` the option is a switch without a value."""
    return typer.Option(*flags.split(","), help=help, metavar=metavar or "", rich_help_panel=panel)


# ---- options

DESCRIBE = "Describe and convert"
OPEN = "Positions"
CLOSED = "Closed loops"
MODELS = "Models"
"""Titles over the commands in the help."""

TimeLimit = Annotated[
    float | None,
    make_option("--time-limit", "Seconds after which it ends with what was done.", "SECONDS"),
]

Threads = Annotated[
    int | None, make_option("--threads", "Threads; all processors if not given.", "N")
]
Scheduler = Annotated[
    str | None, make_option("--scheduler", "Address of the scheduler of a Dask cluster.", "ADDRESS")
]

_READ = "How FILE is read"
File = Annotated[
    str,
    typer.Argument(
        metavar="FILE",
        help=f"File in {join_titles(list_readable_formats())}, or a shipped model's name.",
    ),
]
Json = Annotated[bool, make_option("--json", "Print JSON.")]
Deg = Annotated[
    bool, make_option("--deg", "Angles are degrees, read and printed; lengths stay metres.")
]
Out = Annotated[
    Path | None, make_option("-o,--out", "Write the results to a .csv or .npy file.", "FILE")
]
InPlace = Annotated[
    Path | None, make_option("-o,--out", "The file to write, in place of OUT.", "FILE")
]
_FREE = f"'free': what nothing ties to the ground moves freely ({join_titles(list_readable_formats('base'))})."
Base = Annotated[str | None, make_option("--base", _FREE, "free", _READ)]
Root = Annotated[
    str | None,
    make_option("--root", "Link to take as root where FILE leaves it open.", "LINK", _READ),
]
_MODEL = (
    f"The model to read where FILE has several ({join_titles(list_readable_formats('model'))})."
)
Model = Annotated[str | None, make_option("--model", _MODEL, "NAME", _READ)]
Dirs = Annotated[
    list[Path] | None,
    make_option(
        "--package-dir", "Folder with packages or meshes; can be repeated.", "FOLDER", _READ
    ),
]
Xacro = Annotated[
    bool,
    make_option("--xacro", "Expand xacro first: a program, so only if you trust it.", None, _READ),
]
_ARGUMENT = "Value of a <xacro:arg> of FILE, which is then expanded; can be repeated."
XacroArguments = Annotated[
    list[str] | None, make_option("--xacro-arg", _ARGUMENT, "NAME=VALUE", _READ)
]
_LENIENT = (
    "Limits without a range (no bounds, or swapped), and negative ones of effort, are none "
    f"({join_titles(list_readable_formats('lenient_limits'))})."
)
Lenient = Annotated[bool, make_option("--lenient-limits", _LENIENT, None, _READ)]
_SRDF = "SRDF of the robot: groups, postures, end effectors, how the base moves."
SrdfFile = Annotated[Path | None, make_option("--srdf", _SRDF, "FILE", _READ)]

FrameOrAll = Annotated[
    str | None, make_option("--frame", "Body or frame; all bodies if not given.", "NAME")
]
Values = Annotated[
    str | None,
    make_option(
        "--q", "a,b,c or name=value,... or a .csv or .npy file, one configuration a row.", "VALUES"
    ),
]
Posture = Annotated[
    str | None,
    make_option(
        "--posture", "A posture of FILE, 'neutral' or 'mid'; --q name=value changes it.", "NAME"
    ),
]
_ROWS = "x,y,z,roll,pitch,yaw (fixed axes) or x,y,z; or a .csv or .npy file."
FrameOrTasks = Annotated[
    str | None, make_option("--frame", "Body or frame that shall reach the target.", "NAME")
]
TargetOrTasks = Annotated[str | None, make_option("--target", _ROWS, "VALUES")]
PathTargets = Annotated[
    str | None,
    make_option("--targets,--target", "A .csv or .npy file, a target a row, as for ik.", "FILE"),
]
Tasks = Annotated[
    Path | None,
    make_option(
        "--tasks", "Several tasks in place of a frame and its target: a .toml file.", "FILE"
    ),
]
Prefer = Annotated[
    str | None,
    make_option("--prefer", "What tasks leave free: 'nearest', 'mid' or 'manipulability'.", "WHAT"),
]
PositionOnly = Annotated[bool, make_option("--position-only", "Leave the orientation free.")]
Seed = Annotated[
    str | None,
    make_option("--start,--seed", "Configuration to start from, as --q of fk.", "VALUES"),
]
Rng = Annotated[int | None, make_option("--rng", "Number that fixes the random starts (0).", "N")]
Tolerance = Annotated[
    str | None,
    make_option(
        "--tolerance",
        "Largest errors accepted, metres and radians (1e-6; with --all 1e-9).",
        "M[,RAD]",
    ),
]
PathTolerance = Annotated[
    str | None,
    make_option("--tolerance", "Largest errors accepted, metres and radians (1e-10).", "M[,RAD]"),
]
_ALL = "All solutions"
All = Annotated[
    bool,
    make_option("--all", "All configurations that reach the target, in closed form.", None, _ALL),
]
Task = Annotated[
    str | None,
    make_option(
        "--task", "What counts: pose, position, orientation, direction or position_axis.", "TASK"
    ),
]
Axis = Annotated[
    str | None,
    make_option("--axis", "Axis of the tool for the last two tasks: z, -x or x,y,z (z).", "AXIS"),
]
Hold = Annotated[
    list[str] | None,
    make_option(
        "--hold", "Hold a joint of a redundant chain; can be repeated.", "NAME=VALUE", _ALL
    ),
]
NoLimits = Annotated[bool, make_option("--no-limits", "Leave joint limits out.")]
PICTURES = (".png", ".svg", ".pdf")
Picture = Annotated[
    Path | None, make_option("--plot", "Draw a .png, .svg or .pdf file (needs matplotlib).", "FILE")
]
Film = Annotated[
    Path | None, make_option("--gif,--mp4", "Write the motion as a .gif or .mp4 file.", "FILE")
]
Page = Annotated[
    Path | None,
    make_option(
        "--html", "Write a page in which it can be turned, and moves, without network.", "FILE"
    ),
]


# ---- commands


class Reading(dict[str, Any]):
    """Options with which `kempe.load` reads FILE, without the options that were not given."""


def _make_reading(
    base: Base = None,
    root: Root = None,
    model: Model = None,
    package_dir: Dirs = None,
    xacro: Xacro = False,
    xacro_arg: XacroArguments = None,
    lenient_limits: Lenient = False,
    srdf: SrdfFile = None,
) -> Reading:
    """Return the options of the command line that say how FILE is read."""
    given = {
        "base": base,
        "root": root,
        "model": model,
        "package_dirs": package_dir,
        "xacro": _parse_assignments(xacro_arg, "--xacro-arg") if xacro_arg else xacro,
        "lenient_limits": lenient_limits,
        "srdf": srdf,
    }
    return Reading((name, value) for name, value in given.items() if value)


def _parse_assignments(given: list[str], flag: str) -> dict[str, str]:
    """Return values by name from an option that is repeated as NAME=VALUE.

    Errors: `UsageError`.

    Errors: `UsageError`.
    """
    values: dict[str, str] = {}
    for text in given:
        name, sign, value = text.partition("=")
        if not sign or not name:
            raise UsageError(f"{flag} {text}: it must be NAME=VALUE.")
        if name in values:
            raise UsageError(f"{flag} gives {name} twice.")
        values[name] = value
    return values


def _make_output(
    out: Out = None,
    plot: Picture = None,
    gif: Film = None,
    html: Page = None,
    deg: Deg = False,
    json: Json = False,
) -> Output:
    """Return the options of the command line that say how a command answers."""
    return Output(out, plot, gif, html, deg, json)


def register_command(panel: str, output: str = "json", **settings: Any) -> Callable[[Any], Any]:
    """Register a function as a command in a `panel` of the help, with the options in `output`.

    The command of a function `run_x` is called x. Parameters of the function are options and
    arguments; in place of `system` the command takes FILE and how it is read, in place of `reading`
    the latter only, in place of `output` the options named. Errors are one sentence, or JSON.
    """

    def wrap_function(function: Callable[..., None]) -> Callable[..., None]:
        # commands name the type of their system for type checkers only
        """Register a function whose signature shows the options of the command."""
        own = inspect.signature(function, eval_str=True, locals={"System": object}).parameters
        shown = _select_parameters(_make_output, output.split())
        read = _select_parameters(_make_reading, None if {"system", "reading"} & set(own) else ())
        file = inspect.Parameter("file", POSITIONAL, annotation=File)
        first = [file if n == "system" else p for n, p in own.items() if n not in INJECTED]
        parameters = [*first, *shown, *read]

        @functools.wraps(function)
        def run_function(**options: Any) -> None:
            """Read the system, check the files to be written, and call the function."""

            def take_options(group: list[inspect.Parameter]) -> dict[str, Any]:
                """Remove the options of a group from all options and return them by name."""
                return {p.name: options.pop(p.name, p.default) for p in group}

            made = _make_output(**take_options(shown))
            with report_errors(made.json):
                reading = _make_reading(**take_options(read))
                made.check_files(options.values())
                if "system" in own:
                    options["system"] = load_system(options.pop("file"), reading)
                if "reading" in own:
                    options["reading"] = reading
                function(**options, output=made)

        run_function.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
        run_function.__annotations__ = {p.name: p.annotation for p in parameters}
        name = function.__name__.removeprefix("run_")
        return app.command(name, rich_help_panel=panel, **settings)(run_function)

    return wrap_function


POSITIONAL = inspect.Parameter.POSITIONAL_OR_KEYWORD
INJECTED = ("reading", "output")
"""Parameters of commands that are made of several options."""


def _select_parameters(
    function: Callable[..., Any], names: Sequence[str] | None
) -> list[inspect.Parameter]:
    """Return the parameters of a function with these names; all of them where `names` is None."""
    each = inspect.signature(function, eval_str=True).parameters.values()
    return [p for p in each if names is None or p.name in names]


# ---- files and remarks


def load_system(file: str, reading: Reading) -> System:
    """Return the system that a file describes; print a remark where no joint of it can move."""
    import kempe

    system = kempe.load(file, **reading)
    if still := describe_immovable_coordinates(system, unstated=True):
        print_remark(still)
    return system


@app.callback(invoke_without_command=True)
def handle_main_options(
    context: typer.Context,
    version: Annotated[
        bool, make_option("--version", "Print the version, and which kernels run.")
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
            refuse_question(error)
        print(f"kempe {__version__}, kernels {VARIANT}")
    elif context.invoked_subcommand is None:
        print(context.get_help())
    else:
        return
    raise typer.Exit(COMPLETE)


def check_output_file(path: Path | None) -> None:
    """Raise `InputError` if the file at `path` cannot be written, before any computation."""
    if path is None:
        return
    if path.is_dir():
        raise InputError(f"{path}: this is a folder; name a file in it")
    if what := describe_special_file(path):
        raise InputError(f"{path}: this is {what}; name a plain file")
    if not path.parent.is_dir():
        raise InputError(f"{path}: there is no folder {str(path.parent)!r}")
    if not os.access(path if path.exists() else path.parent, os.W_OK):
        raise InputError(f"{path}: it may not be written")


def print_remark(text: str) -> None:
    """Print a remark beside the answer, on standard error."""
    from kempe.cli.report import translate_keywords

    print(f"kempe: {translate_keywords(text)}", file=sys.stderr, flush=True)


def choose_output_file(out: Path | None, option: Path | None) -> Path:
    """Return the file to write, given as an argument or as the option -o.

    Errors: `UsageError` where both or neither are given.

    Errors: `UsageError` where both or neither are given.
    """
    if (out is None) == (option is None):
        raise UsageError(
            "Missing argument 'OUT'." if out is None else "OUT is given twice: leave -o out."
        )
    return out or option  # type: ignore[return-value]


@dataclass
class Output:
    """Form of a command's answer: files, text or JSON, angles in radians or degrees."""

    out: Path | None
    plot: Path | None
    film: Path | None
    page: Path | None
    deg: bool
    json: bool
    written: list[Path] = field(default_factory=list[Path])

    def check_files(self, given: Iterable[object]) -> None:
        """Raise `InputError` if a requested file cannot be written, before any computation.

        Nor are results written over a file of rows that is `given` to the command.
        """
        if self.out is not None:
            check_table_path(self.out)
            check_output_file(self.out)
            if self.out.exists():
                self._refuse_input_file(given)
        if self.plot is not None:
            check_picture_file(self.plot)
        if self.film is not None:
            from kempe.views.films import check_film_path

            check_film_path(self.film)
            check_output_file(self.film)
        if self.page is not None:
            from kempe.views.viewer.pages import check_page_path

            check_page_path(self.page)
            check_output_file(self.page)

    def _refuse_input_file(self, given: Iterable[object]) -> None:
        """Raise `InputError` if the file of results is also a file that the command reads."""
        assert self.out is not None
        words: list[Any] = []
        for x in given:
            words += x if isinstance(x, list) else [x]
        for word in words:
            if not isinstance(word, (str, Path)) or Path(word).suffix.lower() not in SUFFIXES:
                continue
            path = expand_path(word)
            if path.exists() and self.out.samefile(path):
                raise InputError(
                    f"{self.out}: the command reads this file; write the results to another one"
                )

    def save_table(self, answer: Any, **options: Any) -> None:
        """Write the table of an answer, if the user requested a file for it."""
        if self.out is not None:
            answer.save(self.out, degrees=self.deg, **options)
            self.written.append(self.out)

    def draw_configurations(
        self,
        system: System,
        shown: Any,
        draw: Callable[[], Any] | None = None,
        **options: Any,
    ) -> None:
        """Draw configurations, or an answer that holds them, into the requested files.

        None is the configuration that is drawn by default. A film needs several of them. `draw`
        gives the axes of a picture that is another one than that of `System.plot`.
        """
        files = {path for path in (self.plot, self.film, self.page) if path is not None}
        if not files:
            return
        if shown is None:
            from kempe.views.drawing.plot_request import read_configuration

            shown = read_configuration(system, None)
        rows = np.reshape(getattr(shown, "q", shown), (-1, system.nq))
        finite = int(np.isfinite(rows).all(axis=1).sum())
        left = files if not finite else {p for p in files if p == self.film and finite < 2}
        for path in left:
            why = (
                "one configuration does not move" if finite else "there is no configuration to draw"
            )
            print_remark(f"{path} is not written: {why}")
        files -= left
        if self.plot is not None and self.plot in files:
            axes = system.plot(shown, **options) if draw is None else draw()
            save_picture(axes, self.plot)
        way = shown if np.ndim(getattr(shown, "q", shown)) == 2 else rows
        if self.film is not None and self.film in files:
            system.animate(way, self.film, frames=options.get("frames", ()))
        if self.page is not None and self.page in files:
            from kempe.views.viewer.pages import write_page

            if said := write_page(system, self.page, path=way).lost_sentence:
                print_remark(said)
        each = (self.plot, self.film, self.page)
        self.written += [path for path in each if path is not None and path in files]

    def print_answers(self, answer: Any = None, **more: Any) -> None:
        """Print an answer, further answers by name, and the names of the written files."""
        files = [str(path) for path in self.written]
        if self.json:
            data: dict[str, Any] = {} if answer is None else answer.data(self.deg)
            data |= {name: other.data(self.deg) for name, other in more.items()}
            print_json(data | {"written": files})
            return
        if answer is not None:
            print_answer(answer, self.deg)
        for name, other in more.items():
            if answer is None:
                print(name.replace("_", " "), end=": ")
            print_answer(other, self.deg)
        for path in files:
            print(f"written to {path}")

    def finish_command(self, answer: Any) -> None:
        """Print an answer and end the command with the exit code of the answer."""
        self.print_answers(answer)
        end_incomplete_command(answer)


def check_picture_file(path: Path) -> None:
    """Raise `InputError` if a picture cannot be written at `path`, before any computation."""
    if path.suffix.lower() not in PICTURES:
        raise InputError(f"{path}: pictures are .png, .svg or .pdf files")
    check_output_file(path)
    import kempe.views.drawing  # noqa: F401  it refuses where matplotlib is missing


def save_picture(axes: Any, path: Path) -> None:
    """Write the figure of axes, or of the first of several axes, to a file."""
    first = np.ravel(np.array(axes, dtype=object))[0]
    first.figure.savefig(path, dpi=200, bbox_inches="tight")
