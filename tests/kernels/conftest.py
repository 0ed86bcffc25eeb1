"""Tests of helpers inside kernels compile them, or run them as Python: without Numba they are left
out.
"""

from importlib.util import find_spec

if find_spec("numba") is None:
    collect_ignore = [
        f"test_{name}.py"
        for name in ("added_kernel", "emit", "linear", "random", "residual", "subproblems", "trig")
    ]
