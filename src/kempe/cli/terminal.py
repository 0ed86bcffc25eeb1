"""Output of commands: answers and errors as text or JSON, and exit codes."""

from __future__ import annotations

import contextlib
import os
import re
import sys
from collections.abc import Generator
from typing import Any, NoReturn

import typer
from typer.core import TyperGroup

from kempe.errors import KempeError, TimeLimitError, shorten_lines

COMPLETE = 0
INCOMPLETE = 1
REFUSED = 2
INTERRUPTED = 130
"""Exit codes: complete answer; no solution or problems found; question that could not be posed;
Ctrl-C."""

UsageError: type[Exception] = typer.BadParameter.__mro__[1]
"""Base of the errors for wrong usage, which has moved between versions of typer."""


class Commands(TyperGroup):
    """Group of commands that reports wrong usage in one sentence, or in JSON with --json."""

    def main(self, args: Any = None, *rest: Any, standalone_mode: bool = True, **extra: Any) -> Any:
        """Run the command line `args`; end the process with an exit code if `standalone_mode`."""
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
            message = getattr(error, "format_message", error.__str__)()
            print_error(f"{message} (see '{path} --help')", "--json" in args)
            code = REFUSED
        except typer.Abort:
            code = INTERRUPTED
        if standalone_mode:
            sys.exit(code or COMPLETE)
        return code


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
    from kempe.status import Status  # which loads numpy

    if (
        getattr(answer, "interrupted", False)
        or getattr(answer, "broken", None) is Status.INTERRUPTED
    ):
        raise typer.Exit(INTERRUPTED)
    if not answer:
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
        from kempe.cli.facts import make_error_facts

        print_json(make_error_facts(error))
    else:
        from kempe.cli import report

        report.print_text(report.format_error(error), sys.stderr)


def print_json(data: Any) -> None:
    """Print data as JSON; characters beyond ASCII are escaped if the output cannot show them."""
    from kempe.words import format_json

    encoding = getattr(sys.stdout, "encoding", None) or "ascii"
    print(format_json(data, ascii_only=encoding.lower().replace("-", "") != "utf8"))


def print_answer(answer: Any, degrees: bool = False) -> None:
    """Print an answer, its first line in colour."""
    from kempe.cli import report

    report.print_answer(answer, degrees)
