"""xacro text -> URDF text. xacro is a program, not data: it runs in a process with limits, and on request."""

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
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import IO

from kempe.description.source import SIZE_LIMIT, fail, folders_of
from kempe.errors import DescriptionError, MissingExtraError, UnsupportedError, Where

SECONDS = 20
"""Seconds that an expansion may take, of waiting and so of processor time, too; large robots take about two."""

MEMORY = 2 * 2**30
"""Bytes of memory that an expansion may use."""

XACRO_ADVICE = (
    "load it with xacro=True (it needs the extra kempe[xacro]), only if you trust it: xacro can read any file"
)
"""What to do with a xacro file that was given in place of URDF."""

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

_PACKAGE = re.compile(r"PackageNotFoundError\W+(?:Package not found: )?([\w.-]+)")
_EXCEPTION = re.compile(r"[\w.]+(Error|Exception)\b")

# The limits stand before the imports, so that nothing of xacro runs without them.
_WORKER = """
import json, os, resource, sys
s = json.loads(sys.argv[1])
for name, amount in s["limits"].items():
    limit = getattr(resource, name)
    hard = resource.getrlimit(limit)[1]
    amount = amount if hard == resource.RLIM_INFINITY else min(amount, hard)
    resource.setrlimit(limit, (amount, amount))
import xacrodoc
os.chdir(os.path.dirname(s["path"]))
if s["package_dirs"]:
    xacrodoc.packages.look_in(s["package_dirs"])
xacrodoc.packages.walk_up_from(s["path"])
folders = [os.path.join(d, name) for d in s["package_dirs"] if os.path.isdir(d) for name in sorted(os.listdir(d))]
folder = os.path.dirname(s["path"])
while folder not in ("", os.path.dirname(folder)):
    folders.append(folder)
    folder = os.path.dirname(folder)
for folder in [*folders, *s["package_dirs"]]:  # folders that are called like a package, where no package.xml is
    name = os.path.basename(folder)
    if name and os.path.isdir(folder):
        try:
            xacrodoc.packages.get_path(name)
        except xacrodoc.packages.PackageNotFoundError:
            xacrodoc.packages.update_package_cache({name: folder})
document = xacrodoc.XacroDoc.from_file(s["path"], subargs=s["arguments"], resolve_packages=False)
sys.stdout.buffer.write(document.dom.toprettyxml(indent="  ").encode("utf-8"))
"""


def expand_xacro(
    path: str | Path,
    *,
    arguments: Mapping[str, str] | None = None,
    package_dirs: Iterable[str | Path] = (),
    seconds: float = SECONDS,
) -> str:
    """URDF text that a xacro file expands to, with `arguments` for its ``<xacro:arg>``.

    Only for files that you trust: xacro reads any file that it names. It runs in a process with little
    environment, bounded in time, memory and output. `package_dirs` are searched by ``$(find package)``: for a
    package.xml with that name at any depth, then for a folder of that name in them or above the file.
    Errors: `MissingExtraError` without the extra [xacro], `DescriptionError` with xacro's own message.
    """
    if importlib.util.find_spec("xacrodoc") is None:
        raise MissingExtraError("xacrodoc", "xacro")
    if importlib.util.find_spec("resource") is None:
        raise UnsupportedError("xacro is expanded on Linux and macOS only, where a process can be limited")
    where, path, package_dirs = Where(str(path)), Path(path).resolve(), folders_of(package_dirs)
    settings = {
        "path": str(path),
        "arguments": {str(k): str(v) for k, v in (arguments or {}).items()},
        "package_dirs": [str(Path(d).resolve()) for d in package_dirs],
        "limits": {
            "RLIMIT_CPU": math.ceil(seconds),
            "RLIMIT_AS": MEMORY,
            "RLIMIT_FSIZE": SIZE_LIMIT,
            "RLIMIT_CORE": 0,
            "RLIMIT_NOFILE": 256,
        },
    }
    environment = {k: v for k, v in os.environ.items() if k in _KEPT}
    with tempfile.TemporaryFile() as output, tempfile.TemporaryFile() as complaints:
        command = [sys.executable, "-c", _WORKER, json.dumps(settings)]
        code = _run(command, environment, output, complaints, seconds)
        output.seek(0)
        complaints.seek(0)
        text = output.read(SIZE_LIMIT + 1).decode("utf-8", "replace")
        said = complaints.read(SIZE_LIMIT).decode("utf-8", "replace").strip()
    if code in (None, -signal.SIGXCPU, -signal.SIGKILL):
        raise fail(f"xacro did not finish in {seconds:g} s", where, "it may call itself without end")
    if code == -signal.SIGXFSZ or "File too large" in said:
        raise fail(f"xacro wrote more than {SIZE_LIMIT >> 20} MiB", where, "it may call itself without end")
    if "MemoryError" in said:
        raise fail(f"xacro needs more than {MEMORY >> 30} GiB of memory", where, "it may call itself without end")
    if "RecursionError" in said:
        raise fail("xacro calls itself without end (RecursionError)", where, "look for a macro that calls itself")
    if code != 0:
        raise _failed(_last(said), where, package_dirs)
    return text


def _failed(said: str, where: Where, package_dirs: tuple[str | Path, ...]) -> DescriptionError:
    """The error with what xacro says, or for a package that is not found where it was looked for."""
    missing = _PACKAGE.search(said)
    if missing is None:
        return fail(f"xacro failed: {said}", where, "correct the file, or name its folders by package_dirs")
    looked = ", ".join(repr(str(d)) for d in package_dirs)
    return fail(
        f"xacro finds no package {missing[1]!r}" + (f" in {looked}" if looked else ""),
        where,
        "name by package_dirs a folder that holds one of this name, with or without a package.xml",
    )


def _run(
    command: list[str], environment: dict[str, str], output: IO[bytes], complaints: IO[bytes], seconds: float
) -> int | None:
    """Exit code of a command, or None where it took too long and was stopped, with its children."""
    with subprocess.Popen(
        command,
        env=environment,
        stdin=subprocess.DEVNULL,
        stdout=output,
        stderr=complaints,
        start_new_session=True,
    ) as process:
        try:
            return process.wait(timeout=seconds)
        except subprocess.TimeoutExpired:
            return None
        finally:
            if process.poll() is None:  # an interrupt, too, ends it: it is in a session of its own
                os.killpg(process.pid, signal.SIGKILL)
                process.wait()


def _last(said: str) -> str:
    """The lines of a traceback that say what happened."""
    lines = [line.strip() for line in said.splitlines() if line.strip()]
    first = next((i for i in reversed(range(len(lines))) if _EXCEPTION.match(lines[i])), len(lines) - 1)
    return " ".join(lines[first:])[:300] or "it says nothing"
