"""xacro text -> URDF text. xacro is a program, not data: it runs in a process with limits, and on
request.
"""

from __future__ import annotations

import importlib.util
import os
import re
from collections.abc import Iterable, Mapping
from pathlib import Path

from kempe.description.limited import last_words, run_limited
from kempe.description.source import SIZE_LIMIT, fail, folders_of
from kempe.errors import DescriptionError, MissingExtraError, Where

SECONDS = 20
"""Seconds that an expansion may take, of waiting and so of processor time, too; large robots take
about two."""

MEMORY = 2 * 2**30
"""Bytes of memory that an expansion may use."""

XACRO_ADVICE = (
    "load it with xacro=True (it needs the extra kempe[xacro]), only if you trust it: xacro is a "
    "program"
)
"""What to do with a xacro file that was given in place of URDF."""

ROS_PATHS = ("ROS_PACKAGE_PATH", "AMENT_PREFIX_PATH", "ROS_ROOT")
"""Variables of the environment that name folders of packages."""

_PACKAGE = re.compile(r"PackageNotFoundError\W+(?:Package not found: )?([\w.-]+)")

_WORKER = """
import os
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
roots = [os.path.realpath(d) + os.sep for d in [*s["roots"], sys.prefix, sys.base_prefix]]
def guard(event, given):
    if event == "open" and isinstance(given[0], (str, bytes)):
        path = os.path.realpath(os.fsdecode(given[0]))
        if os.path.dirname(path) != s["beside"] and not any((path + os.sep).startswith(root) for root in roots):
            raise RuntimeError(f"{path} lies outside the folders of the robot")
    elif event.startswith(("subprocess.", "socket.", "os.exec", "os.fork", "os.posix_spawn", "os.system", "ctypes.")):
        raise RuntimeError(f"{event} is no part of a robot")
sys.addaudithook(guard)
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

    Only for files that you trust: xacro is a program. It runs in a process with little environment,
    bounded in time, memory and output, which opens files in `folders_to_read` only. `package_dirs`
    are searched by
    ``$(find package)``: for a package.xml with that name at any depth, then for a folder of that
    name in them or above the file.
    Errors: `MissingExtraError` without the extra [xacro], `DescriptionError` with xacro's own
    message.
    """
    if importlib.util.find_spec("xacrodoc") is None:
        raise MissingExtraError("xacrodoc", "xacro")
    where = Where(str(path))
    path = Path(path).resolve()
    package_dirs = folders_of(package_dirs)
    settings = {
        "path": str(path),
        "arguments": {str(k): str(v) for k, v in (arguments or {}).items()},
        "package_dirs": [str(Path(d).resolve()) for d in package_dirs],
        "roots": [str(d) for d in folders_to_read(path, package_dirs)],
        "beside": str(path.parent),
    }
    ended = run_limited(_WORKER, settings, seconds=seconds, memory=MEMORY, output=SIZE_LIMIT)
    if ended.reason == "time":
        raise fail(
            f"xacro did not finish in {seconds:g} s", where, "it may call itself without end"
        )
    if ended.reason == "output":
        raise fail(
            f"xacro wrote more than {SIZE_LIMIT >> 20} MiB", where, "it may call itself without end"
        )
    if ended.reason == "memory":
        raise fail(
            f"xacro needs more than {MEMORY >> 30} GiB of memory",
            where,
            "it may call itself without end",
        )
    if "RecursionError" in ended.said:
        raise fail(
            "xacro calls itself without end (RecursionError)",
            where,
            "look for a macro that calls itself",
        )
    if ended.reason:
        raise _failed(last_words(ended.said), where, package_dirs)
    return ended.output.decode("utf-8", "replace")


def folders_to_read(path: Path, package_dirs: Iterable[str | Path]) -> list[Path]:
    """The folders of which an expansion may read files.

    These are `package_dirs`, the folders of packages that ROS names in the environment, and the
    folder that holds the file's package (the nearest folder above with a package.xml) and its
    neighbours; of a file without a package, the folder that holds its own. A home folder and the
    first level of a disk are never taken as a whole, unless `package_dirs` or ROS name them: of a
    file that lies there itself, the files beside it are read, and no folders.
    """
    found = [Path(d).resolve() for d in package_dirs]
    found += [
        Path(d) for name in ROS_PATHS for d in os.environ.get(name, "").split(os.pathsep) if d
    ]
    package = next((d for d in path.parents if (d / "package.xml").is_file()), path.parent)
    home = Path.home()
    whole = (
        d
        for d in (package.parent, package, path.parent)
        if len(d.parts) > 2 and d not in (home, *home.parents)
    )
    return [*found, *whole]


def _failed(said: str, where: Where, package_dirs: tuple[str | Path, ...]) -> DescriptionError:
    """The error with what xacro says, or for a package that is not found where it was looked for."""
    missing = _PACKAGE.search(said)
    if missing is None:
        return fail(
            f"xacro failed: {said}", where, "correct the file, or name its folders by package_dirs"
        )
    looked = ", ".join(repr(str(d)) for d in package_dirs)
    return fail(
        f"xacro finds no package {missing[1]!r}" + (f" in {looked}" if looked else ""),
        where,
        "name by package_dirs a folder that holds one of this name, with or without a package.xml",
    )
