"""The kernel of the page docs/add/kernel.md is compiled and does what the page says."""

from __future__ import annotations

import re
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path

import numpy as np
import pytest

PAGE = Path(__file__).parents[2] / "docs" / "add" / "kernel.md"


def test_the_kernel_of_the_page(tmp_path):
    found = re.search(
        r"^```py\n(.*?)^```$", PAGE.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE
    )
    assert found is not None
    path = tmp_path / "lengths.py"
    path.write_text(found[1], encoding="utf-8")
    spec = spec_from_file_location("lengths", path)
    assert spec is not None and spec.loader is not None
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    vectors = np.array([[3.0, 4.0, 0.0], [1.0, 2.0, 2.0], [np.nan, 0.0, 0.0]])
    out = np.empty(3)
    assert module.lengths(vectors, out) == 1
    np.testing.assert_array_equal(out, [5.0, 3.0, np.nan])
    with pytest.raises(TypeError):
        module.lengths(np.ones((3, 3), dtype=int), out)
