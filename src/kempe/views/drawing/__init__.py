"""Drawing of systems with matplotlib, in parts: what is seen, symbols of the plane and of space,
labels.

Importing it needs the extra [view]. Errors: `MissingExtraError` without matplotlib.
"""

from __future__ import annotations

from kempe.errors import MissingExtraError

try:
    import matplotlib  # noqa: F401
except ImportError:
    raise MissingExtraError("matplotlib", "view") from None
