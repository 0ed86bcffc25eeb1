"""The command, run in this process."""

from __future__ import annotations

import functools
import json

import typer.testing

from kempe.cli import app

typer.testing._get_command = functools.cache(typer.main.get_command)
"""The command is made of its functions once: that takes longer than most of what it is tested
with."""


class Result:
    """What one run of the command printed, and its exit code."""

    def __init__(self, *arguments: object):
        done = typer.testing.CliRunner().invoke(app, [str(a) for a in arguments])
        self.code = done.exit_code
        self.out = done.stdout
        self.err = done.stderr
        assert done.exception is None or isinstance(done.exception, SystemExit), done.exception

    def json(self) -> dict:
        """The output, which has to be JSON: without NaN and infinities."""

        def refuse(name: str) -> None:
            raise AssertionError(f"{name} is not JSON")

        return json.loads(self.out, parse_constant=refuse)
