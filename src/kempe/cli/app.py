"""Typer application: registration of commands, reading of FILE, writing of results.

Exit codes: 0 the answer is complete; 1 it is not (no solution found, problems in a file, rows that
are no numbers, a time limit); 2 the question could not be posed (wrong usage, unknown name, a file
that cannot be read); 130 Ctrl-C, where files that were requested hold what was done;
141 the program that read the output has ended.
"""

from __future__ import annotations

import functools
import inspect
import os
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer

from kempe.answers.tables import SUFFIXES, check_table_path
from kempe.answers.wording import describe_immovable_coordinates
from kempe.budget import Budget
from kempe.cli import options
from kempe.cli.terminal import (
    COMPLETE,
    Commands,
    UsageError,
    end_incomplete_command,
    print_answer,
    print_json,
    print_remark,
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

DESCRIBE = "Describe and convert"
OPEN = "Positions"
CLOSED = "Closed loops"
MODELS = "Models"
"""Titles over the commands in the help."""
PICTURES = (".png", ".svg", ".pdf")


# ---- commands


class Reading(dict[str, Any]):
    """Options with which `kempe.load` reads FILE, without the options that were not given."""


def _make_reading(
    base: options.Base = None,
    root: options.Root = None,
    model: options.Model = None,
    package_dir: options.PackageDirs = None,
    xacro: options.Xacro = False,
    xacro_arg: options.XacroArguments = None,
    lenient_limits: options.Lenient = False,
    srdf: options.SrdfFile = None,
    unit: options.LengthUnit = None,
) -> Reading:
    """Return the options of the command line that say how FILE is read."""
    from kempe.cli.arguments import parse_assignments

    given = {
        "base": base,
        "root": root,
        "model": model,
        "package_dirs": package_dir,
        "xacro": parse_assignments(xacro_arg, "--xacro-arg") if xacro_arg else xacro,
        "lenient_limits": lenient_limits,
        "srdf": srdf,
        "unit": unit,
    }
    return Reading((name, value) for name, value in given.items() if value)


def _make_output(
    out: options.Out = None,
    plot: options.Picture = None,
    gif: options.Film = None,
    html: options.Page = None,
    deg: options.Deg = False,
    json: options.Json = False,
) -> Output:
    """Return the options of the command line that say how a command answers."""
    return Output(out, plot, gif, html, deg, json)


def _make_budget(
    starts: options.Starts = None,
    rng: options.Rng = None,
    threads: options.Threads = None,
    time_limit: options.TimeLimit = None,
) -> Budget:
    """Return the options of the command line that say how much work a command does."""
    return Budget(starts=starts, rng=rng, threads=threads, time_limit=time_limit)


def register_command(
    panel: str, output: str = "json", budget: str = "", **settings: Any
) -> Callable[[Any], Any]:
    """Register a function as a command in a `panel` of the help.

    The command of a function `run_x` is called x. Parameters of the function are options and
    arguments; in place of `system` the command takes FILE and how it is read, in place of `reading`
    the latter only, in place of the parameters `output` and `budget` the options that are named
    here. Errors are one sentence, or JSON.
    """

    def wrap_function(function: Callable[..., None]) -> Callable[..., None]:
        """Register a function whose signature shows the options of the command."""
        # commands name the type of their system for type checkers only
        own = inspect.signature(function, eval_str=True, locals={"System": object}).parameters
        file = inspect.Parameter(
            "file", inspect.Parameter.POSITIONAL_OR_KEYWORD, annotation=options.File
        )
        limits = _select_parameters(_make_budget, budget)
        shown = _select_parameters(_make_output, output)
        read = _select_parameters(_make_reading) if {"system", "reading"} & {*own} else []
        first = [file if n == "system" else p for n, p in own.items() if n not in INJECTED]
        parameters = [*first, *limits, *shown, *read]

        @functools.wraps(function)
        def run_function(**given: Any) -> None:
            """Read the system, check the files to be written, and call the function."""

            def take_options(group: list[inspect.Parameter]) -> dict[str, Any]:
                """Remove the options of a group from all options and return them by name."""
                return {p.name: given.pop(p.name, p.default) for p in group}

            made = _make_output(**take_options(shown))
            with report_errors(made.json):
                reading = _make_reading(**take_options(read))
                spend = _make_budget(**take_options(limits))
                made.check_files(given.values())
                if "system" in own:
                    given["system"] = load_system(given.pop("file"), reading)
                if "reading" in own:
                    given["reading"] = reading
                if "budget" in own:
                    given["budget"] = spend
                function(**given, output=made)

        run_function.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
        run_function.__annotations__ = {p.name: p.annotation for p in parameters}
        name = function.__name__.removeprefix("run_")
        return app.command(name, rich_help_panel=panel, **settings)(run_function)

    return wrap_function


INJECTED = ("reading", "output", "budget")
"""Parameters of commands that are made of several options."""


def _select_parameters(
    function: Callable[..., Any], names: str | None = None
) -> list[inspect.Parameter]:
    """Return the parameters of a function with these names; all of them where `names` is None."""
    each = inspect.signature(function, eval_str=True).parameters.values()
    return [p for p in each if names is None or p.name in names.split()]


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
        bool, options.make_option("--version", "Print the version, and which kernels run.")
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


# ---- files and answers


def check_output_file(path: Path) -> None:
    """Raise `InputError` if the file at `path` cannot be written, before any computation."""
    if path.is_dir():
        raise InputError(f"{path}: this is a folder; name a file in it")
    if what := describe_special_file(path):
        raise InputError(f"{path}: this is {what}; name a plain file")
    if not path.parent.is_dir():
        raise InputError(f"{path}: there is no folder {str(path.parent)!r}")
    if not os.access(path if path.exists() else path.parent, os.W_OK):
        raise InputError(f"{path}: it may not be written")


def check_picture_file(path: Path) -> None:
    """Raise `InputError` if a picture cannot be written at `path`, before any computation."""
    if path.suffix.lower() not in PICTURES:
        raise InputError(f"{path}: pictures are .png, .svg or .pdf files")
    check_output_file(path)
    import kempe.views.drawing  # noqa: F401  it refuses where matplotlib is missing


def choose_output_file(out: Path | None, option: Path | None) -> Path:
    """Return the file to write, given as an argument or as the option -o.

    Errors: `UsageError` where both or neither are given.
    """
    path = option if out is None else out
    if path is None:
        raise UsageError("Missing argument 'OUT'.")
    if out is not None and option is not None:
        raise UsageError("OUT is given twice: leave -o out.")
    return path


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

    def save_table(self, answer: Any, found: bool = True, **how: Any) -> None:
        """Write the table of an answer to the requested file, or say that nothing was `found`."""
        if self.out is None:
            return
        if not found:
            print_remark(f"{self.out} is not written: nothing is closed")
            return
        answer.save(self.out, degrees=self.deg, **how)
        self.written.append(self.out)

    def save_picture(self, axes: Any, path: Path) -> None:
        """Write the figure of axes, or of the first of several axes, to a file."""
        first = np.ravel(np.array(axes, dtype=object))[0]
        first.figure.savefig(path, dpi=200, bbox_inches="tight")
        self.written.append(path)

    def draw_configurations(
        self, system: System, shown: Any, draw: Callable[[], Any] | None = None, **how: Any
    ) -> None:
        """Draw configurations, or an answer that holds them, into the requested files.

        None is the configuration that is drawn by default. A film needs several of them. `draw`
        gives the axes of a picture that is another one than that of `System.plot`.
        """
        if self.plot is None and self.film is None and self.page is None:
            return
        if shown is None:
            from kempe.views.drawing.plot_request import read_configuration

            shown = read_configuration(system, None)
        q = getattr(shown, "q", shown)
        rows = np.reshape(q, (-1, system.nq))
        way = shown if np.ndim(q) == 2 else rows
        finite = int(np.isfinite(rows).all(axis=1).sum())
        nothing = "" if finite else "there is no configuration to draw"
        still = "one configuration does not move" if finite == 1 else nothing
        if self.plot is not None and _is_drawn(self.plot, nothing):
            self.save_picture(system.plot(shown, **how) if draw is None else draw(), self.plot)
        if self.film is not None and _is_drawn(self.film, still):
            system.animate(way, self.film, frames=how.get("frames", ()))
            self.written.append(self.film)
        if self.page is not None and _is_drawn(self.page, nothing):
            from kempe.views.viewer.pages import write_page

            if lost := write_page(system, self.page, path=way).lost_sentence:
                print_remark(lost)
            self.written.append(self.page)

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

    def finish_command(self, answer: Any, **more: Any) -> None:
        """Print an answer and further ones, and end the command with the exit code of the first."""
        self.print_answers(answer, **more)
        end_incomplete_command(answer)


def _is_drawn(path: Path, nothing: str) -> bool:
    """Whether a picture is drawn: unless `nothing` says why not, which is then printed."""
    if nothing:
        print_remark(f"{path} is not written: {nothing}")
    return not nothing
