"""The version of Kempe, and what is said where a pickle was written by another one."""

from __future__ import annotations

import sys

__version__ = "0.1.0"


class NoSuchModule:
    """The last finder of modules: names modules of the package that do not exist, as a pickle of
    another version of Kempe may ask for them.
    """

    @staticmethod
    def find_spec(name: str, path: object = None, target: object = None) -> None:
        """Nothing, for modules that are not of Kempe. Errors: `ModuleNotFoundError`."""
        if name.startswith("kempe.") and not name.rpartition(".")[2].startswith("_"):
            raise ModuleNotFoundError(
                f"Kempe {__version__} has no module {name!r}; a pickle is read by the version of "
                "Kempe that wrote it, mechanisms and maps by all (`kempe.load`, "
                "`kempe.open_workspace`)",
                name=name,
            )


sys.meta_path.append(NoSuchModule)
