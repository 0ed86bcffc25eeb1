"""Mechanism -> file, in the format that the file's ending names."""

from __future__ import annotations

from pathlib import Path

from kempe.description.formats import by_ending, endings_written
from kempe.description.mechanism import Mechanism
from kempe.description.source import expanded, no_file
from kempe.errors import InputError


def write(mechanism: Mechanism, path: str | Path) -> Path:
    """The path written, in the format of `kempe.description.formats.FORMATS` that its ending names.

    Errors: `InputError` for another ending, `DescriptionError` listing what the format cannot say;
    nothing is written then.
    """
    path = expanded(path)
    format = by_ending(path.name)
    if format is None or format.write is None:
        raise InputError(
            f"{path}: the ending decides on the format; it must be {endings_written()}"
        )
    if what := no_file(path):
        raise InputError(f"{path}: this is {what}; name a plain file")
    text = format.write(mechanism)
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise InputError(f"{path}: it cannot be written: {error.strerror or error}") from None
    return path
