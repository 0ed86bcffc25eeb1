"""`python -m kempe`."""

from __future__ import annotations

import subprocess
import sys

import kempe


def test_the_module_is_the_command():
    done = subprocess.run(
        [sys.executable, "-m", "kempe", "--version"], capture_output=True, text=True, check=True
    )
    assert done.stdout.startswith(f"kempe {kempe.__version__}")
