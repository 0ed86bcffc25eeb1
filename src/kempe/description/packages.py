"""Folders with the files of a robot: its package, neighbours, named folders, ROS folders."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Iterator
from functools import cached_property
from pathlib import Path, PurePosixPath

from kempe.description.source import shorten_text
from kempe.errors import InputError

MANIFEST = "package.xml"
"""The file that makes a folder a package of ROS, and says its name."""

DEPTH = 4
MOST = 5000
"""Levels below a folder in which packages are looked for, and folders that are looked into in all."""

_COMMENT = re.compile(r"<!--.*?-->", re.DOTALL)
_NAME = re.compile(r"<name>\s*([^<\s]+)\s*</name>")
_SCHEME = re.compile(r"([A-Za-z][A-Za-z0-9+.-]*)://")
_ABSOLUTE = re.compile(r"[/\\~]|[A-Za-z]:")


def list_folders_around(folder: Path) -> list[Path]:
    """Return the folders of a robot's file: its own, its package, and the parent of that.

    The package is the nearest folder from it upwards with a package.xml, else itself. A home folder
    and the first level of a disk are never taken as a whole.
    """
    package = next((d for d in (folder, *folder.parents) if _is_package(d)), folder)
    return [d for d in dict.fromkeys((folder, package, package.parent)) if can_search_folder(d)]


def _is_package(folder: Path) -> bool:
    """Whether a folder is a ROS package: it holds a package.xml."""
    return os.path.isfile(folder / MANIFEST)


def can_search_folder(folder: Path) -> bool:
    """Whether a folder may be searched as a whole: no home folder and no top folder of a disk."""
    home = Path.home()
    return len(folder.parts) > 2 and folder not in (home, *home.parents)


def list_ros_folders() -> list[Path]:
    """Return the folders of packages that ROS names in environment variables."""
    listed = {
        name: [Path(d) for d in os.environ.get(name, "").split(os.pathsep) if d]
        for name in ("ROS_PACKAGE_PATH", "AMENT_PREFIX_PATH", "ROS_ROOT")
    }
    ament = [folder / "share" for folder in listed.pop("AMENT_PREFIX_PATH")]
    return [*(folder for found in listed.values() for folder in found), *ament]


class Folders:
    """Folders from which files may be read, and the packages in them.

    `roots` are the folder with the file of a robot and those that were named for it, `readable`
    also their packages and the neighbours of these.
    """

    def __init__(self, roots: Iterable[str | Path]):
        self.roots = list(dict.fromkeys(Path(root).resolve() for root in roots))
        around = (d for root in self.roots for d in list_folders_around(root))
        self.readable = list(dict.fromkeys((*self.roots, *around)))

    @cached_property
    def packages(self) -> dict[str, Path]:
        """Packages by the name in their package.xml, then folders by their own name.

        They are above the roots, in readable folders, and at some depth below the roots and the
        folders of ROS.
        """
        above = [d for root in self.roots for d in (root, *root.parents) if can_search_folder(d)]
        near = [*above, *(d for folder in self.readable for d in _list_subfolders(folder))]
        below = _iterate_packages([*filter(can_search_folder, self.roots), *list_ros_folders()])
        found: dict[str, Path] = {}
        for folder in (*filter(_is_package, near), *below):
            found.setdefault(_read_package_name(folder), folder)
        for folder in near:
            found.setdefault(folder.name, folder)
        return found

    def find_first_file(
        self, places: Iterable[Path], package: Path | None = None
    ) -> tuple[Path | None, Path | None]:
        """Return the first place that is a readable file, and the first that is a file elsewhere.

        Readable is a file in a readable folder or in this package, links and ``..`` followed. None
        stands where there is no such file.
        """
        allowed = [*self.readable, *([package.resolve()] if package else [])]
        outside: Path | None = None
        for file in (place.resolve() for place in places if os.path.isfile(place)):
            if any(file.is_relative_to(folder) for folder in allowed):
                return file, outside
            outside = outside or file
        return None, outside

    def find_file(self, path: str) -> Path:
        """Return the existing file that a path in a robot's file means.

        ``package://name/rest`` is `rest` in a package of that name; any other path is relative to
        one of the roots. Errors: `InputError` for absolute paths, other schemes than package, files
        that do not exist, and files outside the folders, links and ``..`` followed.
        """
        subject = f"mesh {shorten_text(path)}"
        scheme = _SCHEME.match(path)
        advice = "a mesh is package://name/... or relative to the model"
        if scheme and scheme[1] != "package":
            raise InputError(f"{subject}: {scheme[0]} is not followed; {advice}")
        inner = path.removeprefix("package://").removeprefix("/") if scheme else path
        parts = PurePosixPath(inner.replace("\\", "/")).parts
        if not parts or "\0" in path:
            raise InputError(f"{subject}: it names no file")
        if _ABSOLUTE.match(inner):
            raise InputError(f"{subject}: it is absolute; {advice}")
        package = self.packages.get(parts[0]) if scheme else None
        places = [root.joinpath(*parts) for root in self.roots if not scheme]
        places += [package.joinpath(*parts[1:])] if package else []
        found, outside = self.find_first_file(places, package)
        if found is not None:
            return found
        looked = ", ".join(repr(str(f)) for f in self.readable)
        if outside is not None:
            raise InputError(
                f"{subject}: it leads out of the folders of the robot, to {str(outside)!r}; "
                f"folders are {looked}, declare others by package_dirs"
            )
        missing = f"no package {parts[0]!r}" if scheme and not package else "no such file"
        raise InputError(
            f"{subject}: there is {missing}; looked in "
            f"{looked or 'no folder: declare some by package_dirs'}"
        )


def _list_subfolders(folder: Path) -> list[Path]:
    """Return the folders directly in a folder, without hidden ones and links."""
    try:
        with os.scandir(folder) as entries:
            return sorted(
                Path(e) for e in entries if e.name[0] != "." and e.is_dir(follow_symlinks=False)
            )
    except OSError:
        return []


def _iterate_packages(roots: Iterable[Path]) -> Iterator[Path]:
    """Iterate over the packages below folders, level by level; a package holds no other packages."""
    level = list(dict.fromkeys(roots))
    seen = 0
    for _ in range(DEPTH + 1):
        further: list[Path] = []
        for folder in level[: MOST - seen]:
            seen += 1
            if _is_package(folder):
                yield folder
            else:
                further += _list_subfolders(folder)
        level = further


def _read_package_name(package: Path) -> str:
    """Return the name in the package.xml of a package, else the name of its folder."""
    try:
        with open(package / MANIFEST, encoding="utf-8", errors="replace") as file:
            found = _NAME.search(_COMMENT.sub("", file.read(1 << 16)))
    except OSError:
        found = None
    return found[1] if found else package.name
