"""Drawing of systems with matplotlib, in parts: what is seen, symbols of the plane and of space,
labels.

Importing it needs the extra [view]. Errors: `MissingExtraError` without matplotlib.
"""

from __future__ import annotations

import importlib.util

from kempe.errors import MissingExtraError

if importlib.util.find_spec("matplotlib") is None:
    raise MissingExtraError("matplotlib", "view")
