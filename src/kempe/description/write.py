"""Mechanism -> file, in the format that the file's ending names."""

from __future__ import annotations

from pathlib import Path

from kempe.description.mechanism import Mechanism
from kempe.description.source import expanded, no_file
from kempe.description.toml.toml_writer import write_toml
from kempe.description.urdf.urdf_writer import write_urdf
from kempe.errors import InputError

WRITERS = {".toml": write_toml, ".urdf": write_urdf}
"""Function that gives the text of a mechanism, by ending."""


def write(mechanism: Mechanism, path: str | Path) -> Path:
    """The path written: .toml holds everything, .urdf what URDF can express.

    Errors: `InputError` for another ending, `DescriptionError` listing what URDF cannot say; nothing is written then.
    """
    path = expanded(path)
    if path.suffix.lower() not in WRITERS:
        raise InputError(f"{path}: the ending decides on the format; it must be .toml or .urdf")
    if what := no_file(path):
        raise InputError(f"{path}: this is {what}; name a plain file")
    text = WRITERS[path.suffix.lower()](mechanism)
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise InputError(f"{path}: it cannot be written: {error.strerror or error}") from None
    return path
