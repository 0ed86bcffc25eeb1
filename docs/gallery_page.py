"""Writes docs/gallery.md and a page for each model, with their pictures: `python docs/gallery_page.py`.

A test fails where a page is stale; `--pictures` draws the pictures anew.
"""

from __future__ import annotations

import contextlib
import io
import re
import sys
from pathlib import Path

import numpy as np

import kempe
from kempe import library
from kempe.description.toml_writer import write_toml

DOCS = Path(__file__).parent
PAGES = DOCS / "gallery"
PICTURES = DOCS / "_static" / "gallery"
"""Where the pictures are: NAME.png of `WIDTH`, small/NAME.png of `SMALL` pixels."""
WIDTH = 480
SMALL = 220
COLUMNS = 3
"""Thumbnails in a row."""
DOF = re.compile(r"[,;:] \d+ DoF(?: \(Grübler count: -?\d+\))?$")
"""End of the line about a model that says its DoF, which a cell says before."""

HEAD = """\
# Gallery

<!-- Written by docs/gallery_page.py from kempe.library; do not edit. -->

The models that are shipped: `kempe.load("four_bar")` in Python, `kempe view four_bar` in the browser. The DoF are those
that `mobility` finds, and beside them, where it differs, the count of Grübler; idle ones, such as the spin of a rod
between two balls, are named. Each picture leads to a page with the description file of the model.
"""

MODEL = """\
# {title}

<!-- Written by docs/gallery_page.py from kempe.library; do not edit. -->

{line}.

![{name}](../_static/gallery/{name}.png)

```python
{code}```

```text
{printed}```

<details><summary>Its description: kempe library {name}</summary>

```toml
{toml}```

</details>

[All models](../gallery.md)
"""

OPEN = """\
import kempe

robot = kempe.load("{name}")
print(robot.mobility().sentence)
X = robot.fk(robot.mid, "{frame}")
print(X[:3, 3].round(3))
print(robot.ik(X, "{frame}").status)
robot.plot(robot.mid)
"""
CLOSED = """\
import kempe

system = kempe.load("{name}")
print(system.mobility().sentence)
closed = system.assemble()
print(closed.status)
print(closed.q.round(3))
system.plot(closed.q)
"""
FIXED = """\
import kempe

system = kempe.load("{name}")
print(system.mobility().sentence)
system.plot(axes="all")
"""


def pages() -> dict[str, str]:
    """The pages as Markdown, by their paths below docs."""
    groups: dict[str, list[str]] = {}
    out = {}
    for name in library.list_models():
        system = kempe.load(name)
        group = "With loops" if system.structure.closures else "Open chains and trees"
        title = f"{group}, {'in the plane' if system.dim == 2 else 'in space'}"
        groups.setdefault(title, []).append(cell(name, system))
        out[f"gallery/{name}.md"] = model_page(name, system)
    parts = [f"\n## {title}\n\n{grid(cells)}" for title, cells in sorted(groups.items())]
    return {"gallery.md": HEAD + "".join(parts), **out}


def grid(cells: list[str]) -> str:
    """A table of cells without a head."""
    cells = cells + [""] * (-len(cells) % COLUMNS)
    rows = [cells[k : k + COLUMNS] for k in range(0, len(cells), COLUMNS)]
    lines = [" " * COLUMNS, "|".join(["---"] * COLUMNS), *(" | ".join(row) for row in rows)]
    lines[0] = " | ".join([" "] * COLUMNS)
    return "".join(f"| {line} |\n" for line in lines)


def cell(name: str, system: kempe.System) -> str:
    """A thumbnail that leads to the page of the model, its name, the DoF, a line."""
    picture = f"[![{name}](_static/gallery/small/{name}.png)](gallery/{name}.md)"
    line = DOF.sub("", library.describe_model(name))
    return f"{picture}<br>`{name}`, {count_dof(system)}<br>{line}"


def count_dof(system: kempe.System) -> str:
    """Say how many DoF a system has."""
    found = system.mobility()
    dof = f"{found.dof} DoF"
    if found.dof != found.gruebler:
        dof += f" (Grübler count: {found.gruebler})"
    if found.idle:
        dof += f", {found.idle} idle"
    return dof


def model_page(name: str, system: kempe.System) -> str:
    """The page of a model."""
    code = choose_code(system).format(name=name, frame=last_frame(system))
    return MODEL.format(
        name=name,
        title=name.replace("_", " "),
        line=library.describe_model(name).rstrip("."),
        code=code,
        printed=run(code.rpartition("\n")[0].rpartition("\n")[0]),
        toml=write_toml(kempe.read(name)),
    )


def choose_code(system: kempe.System) -> str:
    """Choose the lines of code that fit a system."""
    if not system.nq:
        return FIXED
    held = system.structure.closures or system.mechanism.constraints
    if held:
        return CLOSED
    return OPEN


def last_frame(system: kempe.System) -> str:
    """Choose the frame that a system is about: the last one, else its last body."""
    bodies = set(system.body_names)
    frames = [name for name in system.frame_names if name not in bodies]
    return (frames or [*system.body_names])[-1]


def run(code: str) -> str:
    """Return what code prints."""
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed), np.printoptions(suppress=True):
        exec(code, {})
    return printed.getvalue()


def draw(folder: Path = PICTURES) -> list[Path]:
    """Draw all models into a folder, large and small."""
    from PIL import Image

    small = folder / "small"
    small.mkdir(parents=True, exist_ok=True)
    for name in library.list_models():
        system = kempe.load(name)
        held = system.structure.closures or system.mechanism.constraints
        # what has nothing that moves may have nothing else to show
        axes = () if system.nq else "all"
        figure = system.plot(None if held else system.mid, labels=(), axes=axes).figure
        file = io.BytesIO()
        figure.savefig(file, dpi=200)
        picture = Image.open(file).convert("RGB")
        for path, width, colours in (
            (folder / f"{name}.png", WIDTH, 128),
            (small / f"{name}.png", SMALL, 64),
        ):
            shrunk = picture.copy()
            shrunk.thumbnail((width, width), Image.Resampling.LANCZOS)
            shrunk.quantize(colours, dither=Image.Dither.NONE).save(path, optimize=True)
    return sorted(folder.glob("*.png"))


if __name__ == "__main__":
    if "--pictures" in sys.argv:
        draw()
    PAGES.mkdir(exist_ok=True)
    for path, text in pages().items():
        (DOCS / path).write_text(text, encoding="utf-8")
