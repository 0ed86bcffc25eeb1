"""Text for terminals and files: answers, problems of files, errors; only terminals get colours."""

from __future__ import annotations

import re
import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, TextIO

import numpy as np
from rich.console import Console, Group, RenderableType
from rich.text import Text

from kempe.errors import PROBLEM_LIMIT, DescriptionError, Fault
from kempe.words import format_count, format_fixed

if TYPE_CHECKING:
    from kempe.report import Result

NOTE_LIMIT = 10
"""Notes about one file that are shown."""

_KEYWORD = re.compile(
    r"kempe\.Budget\((\w+)=\.\.\.\)"
    r"|\b(columns|hold|lenient_limits|project|root|srdf|start|tolerance|xacro)="
    r"(True|\{name: value\}|\([^()]*\)|'[^']*'|[\d.e+-]*\d)"
)
"""Keyword arguments in messages of the library that options of commands give."""

_CONTROL = {i: f"\\x{i:02x}" for i in (*range(32), *range(127, 160)) if i not in (9, 10)}
"""Control characters, which a name from a file must not send to the terminal."""


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


def translate_keywords(text: str) -> str:
    """Return a message of the library with options of commands in place of keyword arguments.

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
