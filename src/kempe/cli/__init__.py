"""Command line of Kempe: each command is a few lines over the library.

Exit codes: 0 the answer is complete; 1 it is not (no solution found, problems in a file, rows that
are no numbers); 2 the question could not be posed (wrong usage, unknown name, a file that cannot be
read).
"""

from __future__ import annotations

import io
import os
import sys

from kempe.cli import description_commands  # isort: skip, the commands are listed in this order
from kempe.cli import position_commands  # isort: skip
from kempe.cli import loop_commands  # isort: skip
from kempe.cli import model_commands  # isort: skip
from kempe.cli.app import app

__all__ = [
    "app",
    "description_commands",
    "loop_commands",
    "main",
    "model_commands",
    "position_commands",
]


NARROWEST = 40
WIDEST = 1000
"""Columns of help and tables at least and at most, where COLUMNS names a width."""


def main() -> None:
    """Run the command `kempe`."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    _limit_columns()
    app(prog_name="kempe")


def _limit_columns() -> None:
    """Limit the environment variable COLUMNS, the width of help and tables, to a readable number."""
    asked = os.environ.get("COLUMNS", "")
    if asked.isdecimal() and len(asked) < 100:
        os.environ["COLUMNS"] = str(min(max(int(asked), NARROWEST), WIDEST))
    elif asked:
        del os.environ["COLUMNS"]
