"""What commands print: answers and errors as text or JSON, in colour on terminals; and exit codes."""

from __future__ import annotations

import contextlib
import os
import re
import sys
import warnings
from collections.abc import Generator, Iterable, Sequence
from typing import TYPE_CHECKING, Any, NoReturn, TextIO

import numpy as np
import typer
from rich.console import Console, Group, RenderableType
from rich.text import Text
from typer.core import TyperGroup

from kempe.errors import (
    MEMBERS_ELSEWHERE,
    OPTIONS_ELSEWHERE,
    PROBLEM_LIMIT,
    DescriptionError,
    Fault,
    KempeError,
    TimeLimitError,
    hint,
    shorten_lines,
)
from kempe.status import Status
from kempe.words import format_count, format_fixed, format_json

if TYPE_CHECKING:
    from kempe.report import Result

COMPLETE = 0
INCOMPLETE = 1
REFUSED = 2
INTERRUPTED = 130
UNREAD = 141
"""Exit codes: complete answer; no solution or problems found; question that could not be posed;
Ctrl-C; the program that read the output has ended, as `head` does (128 + SIGPIPE)."""

NOTE_LIMIT = 10
"""Notes about one file that are shown."""

_KEYWORD = re.compile(
    r"kempe\.Budget\((\w+)=\.\.\.\)"
    r"|\b(columns|hold|lenient_limits|project|root|srdf|start|tolerance|xacro)="
    r"(True|\{name: value\}|\([^()]*\)|'[^']*'|[\d.e+-]*\d)"
)
"""Keyword arguments in messages of the library that options of commands give."""

_DEGREES = re.compile(r"\bwrite \S+ \* kempe\.deg")
"""How messages of the library advise to give an angle in degrees."""

_CONTROL = {i: f"\\x{i:02x}" for i in (*range(32), *range(127, 160)) if i not in (9, 10)}
"""Control characters, which a name from a file must not send to the terminal."""

UsageError: type[Exception] = typer.BadParameter.__mro__[1]
"""Base of the errors for wrong usage, which has moved between versions of typer."""


class Commands(TyperGroup):
    """Group of commands that reports wrong usage in one sentence, or in JSON with --json."""

    def main(self, args: Any = None, *rest: Any, standalone_mode: bool = True, **extra: Any) -> Any:
        """Run the command line `args`; end the process with an exit code if `standalone_mode`."""
        with warnings.catch_warnings():
            warnings.showwarning = print_warning
            args = [expand_home(arg) for arg in (sys.argv[1:] if args is None else args)]
            try:
                code = super().main(args, *rest, standalone_mode=False, **extra)
            except UsageError as error:
                context = getattr(error, "ctx", None)
                words = (
                    context.command_path.split()[1:]
                    if context
                    else [arg for arg in args[:1] if arg in self.commands]
                )
                path = " ".join(["kempe", *words])
                message = explain_usage(error, self.commands)
                print_error(f"{message} (see '{path} --help')", "--json" in args)
                code = REFUSED
            except typer.Abort:
                code = INTERRUPTED
            except SystemExit:  # only where writing failed: rich and click then end with 1
                code = UNREAD
        if standalone_mode:
            code = code or COMPLETE
            sys.exit(code if flush_output() else UNREAD)
        return code


def explain_usage(error: Any, commands: Iterable[str]) -> str:
    """Explain wrong usage; of an unknown command or option, say which one is meant."""
    message = getattr(error, "format_message", error.__str__)()
    unknown = re.match(r"(No such command '([^']*)')", message)
    if unknown:
        said, name = unknown.groups()
        meant, allowed = MEMBERS_ELSEWHERE.get(name, ""), list(commands)
        dashes = ""
    elif message.startswith("No such option") and error.ctx:
        option = error.option_name
        said, name, dashes = f"No such option: {option}", option.lstrip("-"), "--"
        meant = OPTIONS_ELSEWHERE.get(name.replace("-", "_"), "")
        options = (o for p in error.ctx.command.params for o in p.opts)
        allowed = [o[2:] for o in options if o.startswith("--")]
    else:
        return message
    advice = f"; did you mean {meant!r}?" if meant in allowed else hint(name, allowed)
    return said + re.sub(r"'(?=\w)", f"'{dashes}", advice)


def flush_output() -> bool:
    """Write what is buffered to standard output; return whether something still reads it."""
    try:
        sys.stdout.flush()
    except BrokenPipeError:  # Python would say so when it ends
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return False
    return True


def expand_home(argument: str) -> str:
    """Return an argument with ``~`` expanded in its file name, also after ``=``, unlike shells."""
    option, sign, file = argument.partition("=")
    if not argument.startswith("--"):
        option = sign = ""
        file = argument
    if not re.match(r"~[\w.-]*(/|$)", file):
        return argument
    return option + sign + os.path.expanduser(file)


def end_incomplete_command(answer: Any) -> None:
    """End the command if its answer is incomplete, with the exit code for the cause."""
    broken = getattr(answer, "broken", None)
    if getattr(answer, "interrupted", False) or broken is Status.INTERRUPTED:
        raise typer.Exit(INTERRUPTED)
    if not answer or np.any(getattr(answer, "late", False)):
        raise typer.Exit(INCOMPLETE)


@contextlib.contextmanager
def report_errors(json: bool) -> Generator[None]:
    """Print errors raised inside in one sentence, or with `json` as JSON, and end with exit code 2.

    Where the time limit was over before anything was known, it is 1: the question stands.
    """
    try:
        yield
    except TimeLimitError as error:
        print_error(error, json)
        raise typer.Exit(INCOMPLETE) from None
    except KempeError as error:
        refuse_question(error, json)
    except BrokenPipeError:
        raise
    except OSError as error:
        named = f"{error.filename}: " if error.filename else ""
        refuse_question(f"{named}{error.strerror or error}", json)


def refuse_question(error: BaseException | str, json: bool = False) -> NoReturn:
    """Print why the question cannot be posed, and end the command with exit code 2."""
    print_error(error, json)
    raise typer.Exit(REFUSED)


def print_error(error: BaseException | str, json: bool = False) -> None:
    """Print an error: a sentence on standard error, or JSON on standard output."""
    error = error if isinstance(error, BaseException) else str(shorten_lines(error))
    if json:
        print_json(list_error_data(error))
    else:
        print_text(format_error(error), sys.stderr)


def print_json(data: Any) -> None:
    """Print data as JSON; characters beyond ASCII are escaped if the output cannot show them."""
    encoding = getattr(sys.stdout, "encoding", None) or "ascii"
    print(format_json(data, ascii_only=encoding.lower().replace("-", "") != "utf8"))


# ---- text


def make_console(file: TextIO | None = None) -> Console:
    """Return a rich console that prints text literally and unwrapped, in colour on terminals only."""
    return Console(
        file=file or sys.stdout, markup=False, emoji=False, highlight=False, soft_wrap=True
    )


def print_text(text: RenderableType, file: TextIO | None = None) -> None:
    """Print text to `file` (standard output unless given)."""
    make_console(file).print(text)


def print_answer(answer: Result, degrees: bool = False, file: TextIO | None = None) -> None:
    """Print an answer, its first line in colour.

    The answer of one configuration ends with a line that can be given to `kempe fk`.

    Sentences are broken at the width of a terminal, tables are not: no digit is cut off.
    """
    printer = make_console(file)
    text = clean_text(answer.text(degrees, printer.width if printer.is_terminal else 0))
    style = "bold green" if answer else "bold yellow" if np.any(answer.success) else "bold red"
    head, line, rest = text.partition("\n")
    copy = format_configuration(answer, degrees)
    printer.print(Text.assemble((head, style), line, rest, (copy and f"\n\n{copy}", "dim")))


def format_configuration(answer: Any, degrees: bool) -> str:
    """Return a configuration of the answer as an argument of `kempe fk`; '' where there is none.

    Of several configurations the first one inside the limits is taken.
    """
    from kempe.answers.answer import Answer  # only here: errors are told without kernels, too

    if not isinstance(answer, Answer) or not answer or answer.is_motion:
        return ""
    q = answer.q
    if np.ndim(q) == 2 and hasattr(answer, "inside") and not answer._batch_shape:
        q = q[0]
    if np.ndim(q) != 1:
        return ""
    values = answer._name_coordinates(q).convert_units(degrees).tolist()
    return f"--q {','.join(format_fixed(x, 9).rstrip('0').rstrip('.') for x in values)}"


def print_remark(text: str) -> None:
    """Print a remark beside the answer, on standard error."""
    print(f"kempe: {translate_keywords(text)}", file=sys.stderr, flush=True)


def print_warning(message: Warning | str, *_place: object, **_more: object) -> None:
    """Print a warning of the library as a remark: its place in the program is of no use here."""
    print_remark(str(message))


def translate_keywords(text: str) -> str:
    """Return a message of the library with options of commands in place of keyword arguments and of
    `kempe.deg`.

    `root='base'` becomes `--root base`, which can be typed; the names are the same.
    """

    def format_option(found: re.Match[str]) -> str:
        """Return the option that stands for a keyword argument."""
        flag = f"--{(found[1] or found[2]).replace('_', '-')}"
        if found[3] in (None, "True", "(...)"):
            return flag
        value = "NAME=VALUE" if found[3] == "{name: value}" else found[3].strip("()'")
        flag = "--xacro-arg" if flag == "--xacro" else flag
        return f"{flag} {value.replace(', ', ',')}"

    text = _DEGREES.sub("give --deg", text)
    return _KEYWORD.sub(format_option, text) if "=" in text else text


def clean_text(text: object) -> str:
    """Return `text` with visible control characters, and options in place of keyword arguments."""
    return translate_keywords(str(text)).translate(_CONTROL)


# ---- problems of files, and errors


def format_findings(
    file: str, problems: Sequence[Fault], notes: Sequence[str] = ()
) -> RenderableType:
    """Return the problems of a file, each with its line and a caret under it, then the notes."""
    found = format_count(len(problems), "problem") if problems else "no problems"
    noted = f", {format_count(len(notes), 'note')}" if notes else ""
    head = Text.assemble(
        clean_text(file), ": ", (found, "bold red" if problems else "bold green"), noted
    )
    said = [Text.assemble(("note ", "bold cyan"), clean_text(note)) for note in notes[:NOTE_LIMIT]]
    if len(notes) > NOTE_LIMIT:
        said.append(Text(f"... and {format_count(len(notes) - NOTE_LIMIT, 'more note')}"))
    return Group(head, *_format_problems(problems), *said)


def format_error(problem: BaseException | str) -> RenderableType:
    """Return an error as one sentence; problems of a description each with line and caret."""
    head = Text("error: ", style="bold red")
    if isinstance(problem, DescriptionError):
        first, *rest = _format_problems(problem.problems)
        return Group(head + first, *rest)
    return head + Text(clean_text(problem))


def _format_problems(problems: Sequence[Fault]) -> list[Text]:
    """Return the first problems of a file as text, and the number of the other ones."""
    shown = [_format_problem(p) for p in problems[:PROBLEM_LIMIT]]
    more = len(problems) - len(shown)
    return [*shown, *([Text(f"... and {more} more")] if more else [])]


def _format_problem(problem: Fault) -> Text:
    """Return a problem as text, with its line and a caret under the column."""
    text = Text(clean_text(problem))
    if problem.where:
        text.stylize("bold", 0, len(str(problem.where)))
    caret = problem.caret()
    if caret:
        line, mark = clean_text(caret).rsplit("\n", 1)
        text.append(f"\n{line}\n", "dim").append(mark, "bold red")
    return text


def list_problem_data(problem: Fault) -> dict[str, Any]:
    """Return a problem of a file as data: its place, subject, message and what is allowed."""
    where = problem.where
    return {
        "file": where.file if where else None,
        "line": where.line or None if where else None,
        "column": where.column or None if where else None,
        "subject": problem.subject,
        "message": problem.message,
        "allowed": problem.allowed,
        "text": str(problem),
    }


def list_error_data(error: BaseException | str) -> dict[str, Any]:
    """Return an error as data: its sentence, its type, and its problems or allowed names."""
    named = "UsageError" if isinstance(error, str) else type(error).__name__
    out: dict[str, Any] = {"error": str(error), "type": named}
    if isinstance(error, DescriptionError):
        out["problems"] = [list_problem_data(p) for p in error.problems]
    elif hasattr(error, "allowed"):
        out["allowed"] = list(error.allowed)  # type: ignore[union-attr]
    return out
