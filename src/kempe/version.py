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
                f"Kempe {__version__} has no module {name!r}; pickles are read by the version of "
                "Kempe that wrote them, `kempe.load` and `kempe.open_workspace` read mechanisms and "
                "maps of other versions",
                name=name,
            )


sys.meta_path.append(NoSuchModule)
