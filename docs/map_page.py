"""Draws docs/_static/map.svg, the folders of the package and their imports:
`python docs/map_page.py`.

A test fails where the picture is stale. Bands are packages, the uppermost imports from all others;
boxes are their folders. What is drawn is found in the sources: a box stands right of all that it
imports, and an arrow leads to what it imports directly, unless it gets there by other arrows, too.
Imports inside functions are left out.
"""

from __future__ import annotations

import ast
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[1]
SOURCE = ROOT / "src" / "kempe"
WIDTH = 104
HEIGHT = 34
LEFT = 150
ACROSS = 138
DOWN = 44
"""Sizes of a box, the left margin, and the distances of boxes [px]."""
BELOW = "shared"
ABOVE = "on top"
"""Names of the boxes of modules that lie in no folder: those that import from no folder of the
package, and others."""

Arrows = dict[str, set[str]]


@cache
def modules() -> dict[str, Path]:
    """The modules of the package by dotted name below `kempe`, packages themselves left out."""
    paths = (p for p in sorted(SOURCE.rglob("*.py")) if p.stem != "__init__")
    return {".".join(p.relative_to(SOURCE).with_suffix("").parts): p for p in paths}


@cache
def imported(path: Path) -> tuple[str, ...]:
    """Dotted names below `kempe` that a module imports at its top, type checking left out."""
    body = ast.parse(path.read_text(encoding="utf-8")).body
    nodes = [
        n
        for n in body
        if isinstance(n, ast.ImportFrom) and (n.module or "").split(".")[0] == "kempe"
    ]
    return tuple(f"{n.module}.{a.name}".removeprefix("kempe.") for n in nodes for a in n.names)


def arrows(box_of: dict[str, str]) -> Arrows:
    """For each box of modules the other boxes that it imports from; `box_of` gives the box by
    module.
    """
    found: Arrows = {box: set() for box in box_of.values()}
    for module, box in box_of.items():
        for name in imported(modules()[module]):
            target = next((m for m in (name, name.rpartition(".")[0]) if m in box_of), None)
            if target and box_of[target] != box:
                found[box].add(box_of[target])
    return found


def levels(found: Arrows) -> dict[str, int]:
    """For each box the length of the longest path of arrows that begins there."""
    out: dict[str, int] = {}
    while len(out) < len(found):
        ready = [box for box in found if box not in out and found[box] <= out.keys()]
        if not ready:
            raise ValueError(f"these import one another: {sorted(found.keys() - out.keys())}")
        out |= {box: max((out[b] + 1 for b in found[box]), default=0) for box in ready}
    return out


def direct(found: Arrows) -> Arrows:
    """The arrows that are no short cut of others."""
    level = levels(found)
    reached: Arrows = {}
    for box in sorted(found, key=lambda b: level[b]):
        reached[box] = found[box].union(*(reached[b] for b in found[box]))
    return {
        box: {b for b in to if not any(b in reached[c] for c in to)} for box, to in found.items()
    }


def placed(box_of: dict[str, str]) -> dict[str, str]:
    """The box of each module of a package, where "" stands for no folder: those lie below or above."""
    if not any(box_of.values()):
        return dict.fromkeys(box_of, "modules")
    own = {m: set(imported(modules()[m])) for m, box in box_of.items() if not box}
    above = {m for m, box in box_of.items() if box}
    while more := {
        m
        for m in own.keys() - above
        if any(f"{n}.".startswith(f"{a}.") for n in own[m] for a in above)
    }:
        above |= more
    return {m: box or (ABOVE if m in above else BELOW) for m, box in box_of.items()}


def bands() -> list[tuple[str, dict[str, str]]]:
    """The packages from the top down, each with the boxes of their modules; last the single modules
    that they use.
    """
    packages: dict[str, dict[str, str]] = {}
    alone: dict[str, str] = {}
    for module in modules():
        first, *rest = module.split(".")
        parts = rest if rest[:1] != ["analytic"] or len(rest) < 3 else rest[1:]
        package = f"{first}/analytic" if parts is not rest else first
        if rest:
            packages.setdefault(package, {})[module] = parts[0] if len(parts) > 1 else ""
        else:
            alone[module] = module
    level = levels(arrows({m: p for p, box_of in packages.items() if "/" not in p for m in box_of}))
    order = sorted(packages, key=lambda p: (-level[p.split("/")[0]], "/" not in p, p))
    shared = {
        name.split(".")[0]
        for box_of in packages.values()
        for m in box_of
        for name in imported(modules()[m])
    }
    alone = {m: m for m in alone if m in shared}
    return [*((p, placed(packages[p])) for p in order), ("single modules", alone)]


def band(name: str, box_of: dict[str, str], top: int) -> tuple[list[str], int]:
    """One band of the picture, and the height where the next begins."""
    found = arrows(box_of)
    level = levels(found)
    straight = direct(found)
    columns = [sorted(b for b in found if level[b] == k) for k in range(max(level.values()) + 1)]
    at = {
        b: (LEFT + k * ACROSS, top + 12 + i * DOWN)
        for k, c in enumerate(columns)
        for i, b in enumerate(c)
    }
    bottom = top + 12 + max(map(len, columns)) * DOWN
    lines = [
        f'<rect class="band" x="0" y="{top}" width="980" height="{bottom - top}"/>',
        f'<text class="name" x="12" y="{top + 33}">{name}</text>',
    ]
    for box in sorted(found):
        for to in sorted(straight[box]):
            (x1, y1) = at[box]
            (x2, y2) = at[to]
            a = x1
            b = x2 + WIDTH + 4
            y1 = y1 + HEIGHT // 2
            y2 = y2 + HEIGHT // 2
            lines.append(f'<path d="M{a},{y1} C{a - 20},{y1} {b + 20},{y2} {b},{y2}"/>')
    for box, (x, y) in sorted(at.items()):
        count = sum(b == box for b in box_of.values())
        lines.append(
            f'<rect class="box" x="{x}" y="{y}" width="{WIDTH}" height="{HEIGHT}" rx="4"/>'
        )
        lines.append(f'<text x="{x + WIDTH // 2}" y="{y + 15}">{box}</text>')
        if name != "single modules":
            text = "1 module" if count == 1 else f"{count} modules"
            lines.append(f'<text class="count" x="{x + WIDTH // 2}" y="{y + 28}">{text}</text>')
    return lines, bottom + 10


def picture() -> str:
    """The picture as SVG."""
    body: list[str] = []
    top = 0
    for name, box_of in bands():
        lines, top = band(name, box_of, top)
        body += lines
    style = (
        ".band{fill:#f3f5f7} .box{fill:#fff;stroke:#57606a} "
        "path{fill:none;stroke:#0969da;marker-end:url(#head)} text{font:12px "
        "sans-serif;text-anchor:middle;fill:#1f2328} .name{font-weight:bold;text-anchor:start} "
        ".count{font-size:10px;fill:#57606a}"
    )
    head = (
        '<marker id="head" viewBox="0 0 6 6" refX="4" refY="3" markerWidth="6" markerHeight="6" '
        'orient="auto"><path d="M0,0 L6,3 L0,6 z" '
        'style="fill:#0969da;stroke:none;marker-end:none"/></marker>'
    )
    return "\n".join(
        [
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 980 {top}" width="980" '
            f'height="{top}">',
            f"<style>{style}</style>",
            f"<defs>{head}</defs>",
            *body,
            "</svg>\n",
        ]
    )


if __name__ == "__main__":
    (Path(__file__).parent / "_static" / "map.svg").write_text(picture(), encoding="utf-8")
