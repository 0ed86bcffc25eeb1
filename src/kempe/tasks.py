# pyright: reportUnsupportedDunderAll=false
"""Tasks for inverse kinematics: the constraints of `kempe.constraints` under another name.

``from kempe import tasks``, and `System.ik` takes any of them. See `kempe.constraints.Constraint`
for `weight`, `priority`, `tolerance` and `name`, which all take. Goals may have leading axes: they
make a batch. `error`, `jacobian` and `miss` say what one of them is at a configuration.
"""

from typing import Any

from kempe.constraints import *  # noqa: F403
from kempe.constraints import KINDS as _KINDS
from kempe.constraints.base import Constraint as Task
from kempe.equations.packed_tasks import count, error, jacobian, miss
from kempe.errors import raise_missing_name

__all__ = [k.__name__ for k in _KINDS.values() if k.__module__.startswith("kempe.")]
__all__ += ["Task", "count", "error", "jacobian", "miss"]


def __getattr__(name: str) -> Any:
    """Raise the error of a task that does not exist, with the nearest names."""
    raise_missing_name(__name__, name, __all__)
