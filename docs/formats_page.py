"""Writes docs/formats.md from the table of formats: `python docs/formats_page.py`. A test fails
where it is stale.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from kempe.description.formats import (
    DEFAULT,
    FORMATS,
    Format,
    join_titles,
    list_readable_formats,
    list_writable_endings,
)

HEAD = """\
# File formats

<!-- Written by docs/formats_page.py from kempe.description.formats.FORMATS; do not edit. -->

`kempe.load` and `kempe.read` find out the format of a file by its ending and its first lines;
`format="..."` names it. A text may be given in place of a path. `mechanism.save(path)` and `kempe convert` write the
format that the ending names.

"""

CANNOT = """
## What a format does not have

What a format does not have is refused with the name of the joint, body or constraint, and no file is
written.

"""

LOSES = """
## What is left out

Some things are left out, or replaced by what means the same, without a refusal.

"""

OPTIONS = """
## Options of readers

"""

EXAMPLE = """
## From one to another

```python
import kempe

arm = kempe.read("puma560")
again = kempe.load(arm.save("again.toml"))
urdf = kempe.load(arm.save("puma560.urdf"))  # without postures
q = urdf.random(0)
for system in (arm.build(), again, urdf):
    print(system.fk(q, "tool")[:3, 3].round(4), "postures:", *system.structure.posture_names)
try:
    kempe.read("car").save("car.urdf")
except kempe.KempeError as error:
    print(error)
```

```text
[ 0.3317  0.1104 -0.2255] postures: qz qr qs qn
[ 0.3317  0.1104 -0.2255] postures: qz qr qs qn
[ 0.3317  0.1104 -0.2255] postures:
car.toml:20: constraint 'rear axle': a no_sideslip does not exist in URDF; URDF has joints, and Drake two
points that coincide; a .toml file can hold it
```

xacro is a program that writes URDF: `kempe.load("robot.urdf.xacro", xacro=True)` runs it, if you trust it, in a process
that opens only files of [the robot's folders](howto_urdf.md#where-files-are-looked-up);
[its arguments](howto_urdf.md#my-file-is-xacro) are given by `xacro={"name": "ur5e"}`.
Denavit-Hartenberg tables and screw axes are given [in Python](howto_describe.md#from-tables), or in
[TOML](toml.md). A format of your own is [one row more](add/format.md).
"""


def page() -> str:
    """The page as Markdown."""
    rows = FORMATS.values()
    formats = table(
        ("format", "`format=`", "endings, or root element", "read", "written"),
        map(format_row, FORMATS, rows),
    )
    general = (
        f"\nA text of which neither tells the format is read as {DEFAULT.title}. Files in a format "
        "that is not read\nare refused, and the message names those that are: "
        f"{join_titles(list_readable_formats(), 'and')}. What is written ends in {list_writable_endings()}.\n"
    )
    cannot = table(
        ("format", "what it lacks", "instead"),
        ((f.title, what, instead) for f in rows for what, instead in f.cannot.items()),
    )
    loses = table(
        ("format", "left out or replaced"), ((f.title, what) for f in rows for what in f.loses)
    )
    options = dict.fromkeys(option for f in rows for option in f.options if option != "beside")
    taken = table(
        ("option", "read with it"),
        ((f"`{o}`", join_titles(list_readable_formats(o), "and")) for o in options),
    )
    return f"{HEAD}{formats}{general}{EXAMPLE}{CANNOT}{cannot}{LOSES}{loses}{OPTIONS}{taken}"


def format_row(name: str, f: Format) -> list[str]:
    """Names and endings of a format, and whether it is read and written."""
    endings = ", ".join(f"`{ending}`" for ending in f.endings)
    if f.elements:
        roots = " or ".join(f"`<{root}>`" for root in f.elements)
        endings += f"; others, such as `.xml`, by {roots}"
    return [
        f.title,
        f"`{name}`" if f.read else "–",
        endings,
        *("yes" if x else "–" for x in (f.read, f.write)),
    ]


def table(head: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    """A Markdown table."""
    lines = [list(head), *map(list, rows)]
    lines.insert(1, ["---"] * len(lines[0]))
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


if __name__ == "__main__":
    Path(__file__).with_name("formats.md").write_text(page(), encoding="utf-8")
