"""Execution of Python code for untrusted files, in a process with limited time, memory and output."""

from __future__ import annotations

import importlib.util
import json
import math
import os
import re
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable
from typing import Any, NamedTuple

from kempe.errors import UnsupportedError

MOST_SAID = 1 << 20
"""Bytes of complaints that are read."""
_KEPT = (
    "PATH",
    "HOME",
    "LANG",
    "LC_ALL",
    "PYTHONPATH",
    "VIRTUAL_ENV",
    "ROS_PACKAGE_PATH",
    "AMENT_PREFIX_PATH",
    "ROS_ROOT",
    "ROS_DISTRO",
    "TMPDIR",
)
_EXCEPTION = re.compile(r"[\w.]+(Error|Exception)\b")

# The limits stand before all other imports, so that nothing of another package runs without them.
_LIMITED = """
import json, resource, sys
s = json.load(sys.stdin)
for name, amount in s["limits"].items():
    limit = getattr(resource, name)
    hard = resource.getrlimit(limit)[1]
    amount = amount if hard == resource.RLIM_INFINITY else min(amount, hard)
    resource.setrlimit(limit, (amount, amount))
"""


class Ended(NamedTuple):
    """End of a process: its output and why it stopped.

    `reason` is "" where it did what it should, else "time", "memory", "output" or "failed".

    `output` and `said` are what it wrote, `code` is its exit code: None where it was stopped.
    """

    reason: str
    output: bytes
    said: str
    code: int | None


def run_limited_code(
    code: str,
    settings: dict[str, Any],
    *,
    seconds: float,
    memory: int,
    output: int,
    cpu: float | None = None,
    meanwhile: Callable[[], object] | None = None,
) -> Ended:
    """Run Python `code` in a limited process and return how it ended.

    The code finds the `settings` as `s`; few environment variables are passed on.

    It may take `seconds` of waiting, and of processor time `cpu` (by default as many), `memory`
    bytes, and write files of `output` bytes. `meanwhile` is called here while it runs. Errors: `UnsupportedError` on
    systems where a process cannot be limited.
    """
    if importlib.util.find_spec("resource") is None:
        raise UnsupportedError(
            "files are read in a process with limits, which Linux and macOS have"
        )
    limits = {
        "RLIMIT_CPU": math.ceil(seconds if cpu is None else cpu),
        "RLIMIT_AS": memory,
        "RLIMIT_FSIZE": output,
        "RLIMIT_CORE": 0,
        "RLIMIT_NOFILE": 256,
    }
    environment = {k: v for k, v in os.environ.items() if k in _KEPT} | {
        "OPENBLAS_NUM_THREADS": "1"
    }
    with (
        tempfile.TemporaryFile() as given,
        tempfile.TemporaryFile() as out,
        tempfile.TemporaryFile() as complaints,
    ):
        given.write(json.dumps({**settings, "limits": limits}).encode())
        given.seek(0)
        command = [sys.executable, "-P", "-c", _LIMITED + code]
        with subprocess.Popen(
            command,
            env=environment,
            stdin=given,
            stdout=out,
            stderr=complaints,
            start_new_session=True,
        ) as process:
            try:
                if meanwhile is not None:
                    meanwhile()
                ended = process.wait(timeout=seconds)
            except subprocess.TimeoutExpired:
                ended = None
            finally:
                # an interrupt, too, ends it: it is in a session of its own
                if process.poll() is None:
                    os.killpg(process.pid, signal.SIGKILL)
                    process.wait()
        out.seek(0)
        complaints.seek(0)
        text = out.read(output + 1)
        said = complaints.read(MOST_SAID).decode("utf-8", "replace").strip()
    return Ended(_find_stop_reason(ended, said), text, said, ended)


def _find_stop_reason(code: int | None, said: str) -> str:
    """Return which limit stopped the process, from its exit code and error output; '' for none."""
    if code in (None, -signal.SIGXCPU, -signal.SIGKILL):
        return "time"
    if code == -signal.SIGXFSZ or "File too large" in said:
        return "output"
    if "MemoryError" in said:
        return "memory"
    return "failed" if code != 0 else ""


def extract_last_lines(said: str) -> str:
    """Return the last lines of a traceback, at most 300 characters."""
    lines = [line.strip() for line in said.splitlines() if line.strip()]
    first = next(
        (i for i in reversed(range(len(lines))) if _EXCEPTION.match(lines[i])), len(lines) - 1
    )
    return " ".join(lines[first:])[:300] or "it says nothing"
