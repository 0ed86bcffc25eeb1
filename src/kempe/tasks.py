# pyright: reportUnsupportedDunderAll=false
"""Tasks for inverse kinematics: the constraints of `kempe.constraints` under another name.

``from kempe import tasks``, and `System.ik` takes any of them. See `kempe.constraints.Constraint`
for `weight`, `priority`, `tolerance` and `name`, which all take. Goals may have leading axes: they
make a batch. `error`, `jacobian` and `miss` say what one of them is at a configuration.
"""

from kempe.constraints import *  # noqa: F403
from kempe.constraints import KINDS as _KINDS
from kempe.constraints.base import Constraint as Task
from kempe.equations.packed_tasks import count, error, jacobian, miss

__all__ = [k.__name__ for k in _KINDS.values() if k.__module__.startswith("kempe.")]
__all__ += ["Task", "count", "error", "jacobian", "miss"]
