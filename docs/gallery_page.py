"""Writes docs/gallery.md, and its pictures when the docs are built: `python docs/gallery_page.py`.

A test fails where the page is stale.
"""

from __future__ import annotations

from pathlib import Path

import kempe
from kempe import library

DOCS = Path(__file__).parent
PICTURES = DOCS / "_static" / "gallery"
"""Where the pictures are drawn: they are not kept in the repository."""

HEAD = """\
# Gallery

<!-- Written by docs/gallery_page.py from kempe.library; do not edit. -->

The models that are shipped: `kempe.load("four_bar")` in Python, `kempe view four_bar` in the browser. The DoF are those
that `mobility` finds, and beside them, where it differs, the count of Grübler; idle ones, such as the spin of a rod
between two balls, are named.

"""


def page() -> str:
    """The page as Markdown."""
    groups: dict[str, list[str]] = {}
    for name in library.list_models():
        system = kempe.load(name)
        group = "With loops" if system.structure.closures else "Open chains and trees"
        title = f"{group}, {'in the plane' if system.dim == 2 else 'in space'}"
        groups.setdefault(title, []).append(row(name, system))
    parts = [
        f"## {title}\n\n| | model | DoF | |\n| --- | --- | --- | --- |\n{''.join(rows)}"
        for title, rows in sorted(groups.items())
    ]
    return HEAD + "\n".join(parts)


def row(name: str, system: kempe.System) -> str:
    """A picture, the name, the DoF, a line."""
    found = system.mobility()
    dof = str(found.dof)
    if found.dof != found.gruebler:
        dof += f" (count: {found.gruebler})"
    if found.idle:
        dof += f", {found.idle} idle"
    return f"| ![{name}](_static/gallery/{name}.png) | `{name}` | {dof} | {library.describe_model(name)} |\n"


def draw(folder: Path = PICTURES) -> list[Path]:
    """Draw all models into a folder; what is there is kept."""
    folder.mkdir(parents=True, exist_ok=True)
    for name in library.list_models():
        path = folder / f"{name}.png"
        if path.exists():
            continue
        system = kempe.load(name)
        held = system.structure.closures or system.mechanism.constraints
        # what has nothing that moves may have nothing else to show
        axes = () if system.nq else "all"
        figure = system.plot(None if held else system.mid, labels=(), axes=axes).figure
        figure.set_size_inches(2.4, 2.4 * figure.get_figheight() / figure.get_figwidth())
        figure.savefig(path, dpi=75)
    return sorted(folder.glob("*.png"))


if __name__ == "__main__":
    (DOCS / "gallery.md").write_text(page(), encoding="utf-8")
