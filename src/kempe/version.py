"""The version of Kempe, and the message for pickles that another version wrote."""

from __future__ import annotations

import sys

__version__ = "0.1.0"


class NoSuchModule:
    """Import finder that explains missing modules of Kempe, for pickles of other versions."""

    @staticmethod
    def find_spec(name: str, path: object = None, target: object = None) -> None:
        """Return None for modules outside Kempe. Errors: `ModuleNotFoundError` for those of Kempe."""
        if name.startswith("kempe.") and not name.rpartition(".")[2].startswith("_"):
            raise ModuleNotFoundError(
                f"Kempe {__version__} has no module {name!r}; pickles are read by the version of "
                "Kempe that wrote them, `kempe.load` and `kempe.open_workspace` read mechanisms and "
                "maps of other versions",
                name=name,
            )


sys.meta_path.append(NoSuchModule)
