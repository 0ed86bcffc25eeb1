"""Planar systems as a textbook's kinematic diagram, on matplotlib axes.

Every artist has a `gid` that says what it is ("joint:A", "ground:A", "link:crank", ...), which is
its id in SVG.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.patches import PathPatch
from matplotlib.transforms import Affine2D

from kempe.joints import P, R
from kempe.spatial import Array
from kempe.views.drawing import shapes, style
from kempe.views.drawing.labels import Obstacles
from kempe.views.drawing.scene import Scene, SeenJoint, SeenLink, compute_travel, remove_duplicates
from kempe.views.drawing.solids import DrawnPiece, find_hull, make_fan, make_fans, parse_colour
from kempe.views.drawing.style import BAR, BLOCK, DRIVER, GROUND, INK, OPEN, PAPER, WRONG
from kempe.views.drawing.symbols import SYMBOLS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.path import Path

    from kempe.views.drawing.scene import SeenMark


# ---- wheels and contacts

# Wheels on an axle, or a wheel or ball on a line, that touch, roll or do not slip.

AXLE = 0.22
"""Half of an axle without a length of its own, as part of the whole drawing."""


def draw_contact(sheet: Sheet, mark: SeenMark) -> None:
    """Draw the symbol of a constraint: wheels, a wheel or ball on its line, or a point."""
    r = sheet.r
    c = mark.point[:2]
    gid = f"mark:{mark.name}"
    label = c
    colour = style.choose_link_colour(mark.link)
    if mark.plane is not None:
        foot = mark.plane[0][:2]
        down = -mark.plane[1][:2]
        half = max(mark.radius, 4.0 * r) * 1.6 * np.array([-down[1], down[0]])
        sheet.add_outline(
            shapes.make_hatched_line(foot - half, foot + half, down, r),
            f"{gid}:plane",
            style.RAILS,
            fc="none",
            ec=GROUND,
            lw=1.1,
        )
        sheet.obstacles.add_segment(foot - half, foot + half, r)
    if mark.radius > 0.0:
        sheet.add_outline(
            shapes.make_circle(c, mark.radius),
            f"{gid}:round",
            style.POLYGONS,
            fc=(colour, 0.2),
            ec=INK,
            lw=1.2,
        )
        sheet.obstacles.add_segment(c, c, mark.radius)
    elif mark.symbol == "wheel":
        label = draw_wheels(sheet, mark, gid)
    sheet.add_outline(shapes.make_circle(c, 0.6 * r), gid, style.PINS, fc=PAPER, ec=INK, lw=1.2)
    sheet.labels.append((mark.name, label, 1.2 * r, {"gid": f"label:{mark.name}", "color": INK}))


def draw_wheels(sheet: Sheet, mark: SeenMark, gid: str, colour: str = INK) -> Array:
    """Draw an axle with its wheels; return the point (2,) where there is room for its name."""
    r = sheet.r
    c = mark.point[:2]
    if mark.symbol != "wheel" or mark.radius > 0.0:
        return c
    along = mark.B[:2, 0]
    across = mark.B[:2, 1]
    half = max(4.0 * r, AXLE * sheet.scene.size) * across
    sheet.add_line(np.array([c - half, c + half]), f"{gid}:axle", style.BARS, color=colour, lw=1.8)
    for k, end in enumerate((c - half, c + half)):
        sheet.add_outline(
            shapes.make_box(end, along, 2.4 * r, 0.8 * r),
            f"{gid}:wheel{k}",
            style.BLOCKS,
            fc=colour,
            ec=colour,
        )
        sheet.obstacles.add_segment(end - 2.4 * r * along, end + 2.4 * r * along, r)
    return c + half + 1.2 * r * across


# ---- the diagram

PIN_OF_SIZE = 0.020
PIN_OF_LINK = 0.15
PIN_LEAST = 0.008
"""Radius of a pin: as part of the whole drawing, at most as part of a short link, at least of the
drawing."""


@dataclass
class Sheet:
    """A drawing in progress: the axes, the scene, the radius `r` of a pin in metres, what is
    covered already.
    """

    ax: Axes
    scene: Scene
    r: float
    configurations: Array | None = None
    obstacles: Obstacles = field(default_factory=Obstacles)
    extent: list[Array] = field(default_factory=list[Array])
    labels: list[tuple[str, Array, float, dict[str, Any]]] = field(
        default_factory=list[tuple[str, Array, float, dict[str, Any]]]
    )
    """Text, point, clearance and text properties: they are placed when everything else is drawn."""
    arcs: list[Array] = field(default_factory=list[Array])
    """Where angles are measured."""
    steady: bool = False
    """Whether it is a frame of a motion: symbols then keep their side."""

    def add_outline(self, path: Path, gid: str, layer: float, **how: Any) -> None:
        """Draw an outline, filled and edged."""
        self.extent.append(np.asarray(path.vertices))
        # axes that stay know what is on them; frames of a motion have their limits
        add = self.ax.add_artist if self.steady else self.ax.add_patch
        add(PathPatch(path, gid=gid, zorder=layer, **{"lw": 0.9, "joinstyle": "round", **how}))

    def add_line(self, points: Array, gid: str, layer: float, **how: Any) -> None:
        """Draw a polyline (n, 2)."""
        finite = points[np.isfinite(points).all(axis=1)]
        self.extent.append(finite)
        drawn: dict[str, Any] = {"color": INK, **how}
        self.ax.plot(points[:, 0], points[:, 1], gid=gid, zorder=layer, **drawn)


class SheetRecord(Sheet):
    """The drawing of a planar system as pieces, in layers above one another."""

    def __init__(self, scene: Scene, r: float, configurations: Array | None):
        super().__init__(None, scene, r, configurations)  # type: ignore[arg-type]
        self.pieces: list[DrawnPiece] = []

    def add_outline(self, path: Path, gid: str, layer: float, **how: Any) -> None:
        """Add an outline, filled and with its line."""
        scale = 100.0 / self.r
        for line in path.to_polygons(Affine2D().scale(scale), closed_only=False):
            corners = np.asarray(line) / scale
            if len(corners) > 2 and (fill := how.get("fc", "none")) != "none":
                self._add_piece(gid, corners, make_fan(len(corners)), layer, mix_paper_colour(fill))
            if (edge := how.get("ec", "none")) != "none":
                self._add_stroke(
                    gid, corners, layer + 0.5, mix_paper_colour(edge), how.get("lw", 0.9)
                )

    def add_line(self, points: Array, gid: str, layer: float, **how: Any) -> None:
        """Add a polyline (n, 2)."""
        colour = mix_paper_colour(how.get("color", style.INK))
        self._add_stroke(
            gid, points[np.isfinite(points).all(axis=1)], layer + 0.5, colour, how.get("lw", 1.5)
        )

    def _add_stroke(self, gid: str, points: Array, layer: float, colour: Any, width: float) -> None:
        a = points[:-1]
        b = points[1:]
        length = np.linalg.norm(b - a, axis=1, keepdims=True)
        a, b, along = (
            x[length[:, 0] > 1e-12] for x in (a, b, (b - a) / np.maximum(length, 1e-300))
        )
        if not len(a):
            return
        half = 0.5 * style.POINT * width * self.r
        side = half * np.stack([-along[:, 1], along[:, 0]], axis=1)
        a = a - 0.6 * half * along
        b = b + 0.6 * half * along
        corners = np.stack([a - side, b - side, b + side, a + side], axis=1).reshape(-1, 2)
        quads = make_fans(len(a), 4).reshape(-1, 3)
        self._add_piece(gid, corners, quads, layer, colour)

    def _add_piece(
        self, gid: str, corners: Array, triangles: np.ndarray, layer: float, colour: Any
    ) -> None:
        above = np.full((len(corners), 1), style.THICK * self.r * layer)
        both = np.concatenate([triangles, triangles[:, ::-1]])
        self.pieces.append(DrawnPiece(gid, np.concatenate([corners, above], axis=1), both, colour))


def mix_paper_colour(colour: Any) -> tuple[float, float, float, float]:
    """Mix a colour of the drawings with that of the paper, for parts that are transparent."""
    pair: Any = colour
    if isinstance(colour, tuple):
        return (
            *parse_colour(style.mix_colours(pair[0], style.PAPER, 0.85 * (1.0 - float(pair[1])))),
            1.0,
        )
    return (*parse_colour(colour), 1.0)


def choose_pin_radius(scene: Scene) -> float:
    """Choose the radius [m] of pins from the size of the drawing and its short links."""
    lengths = scene.lengths
    short = float(np.quantile(lengths, 0.2)) if len(lengths) else scene.size
    return max(min(PIN_OF_SIZE * scene.size, PIN_OF_LINK * short), PIN_LEAST * scene.size)


def project_to_plane(X: Array) -> Array:
    """Project poses (..., 4, 4) or points (..., 3) to positions (..., 2) in the plane."""
    return X[:2, 3] if X.shape == (4, 4) else X[..., :2]


def draw_scene(sheet: Sheet, texts: dict[str, str], frames: bool = True) -> None:
    """Draw the kinematic diagram: links, rails, blocks, ground symbols, pins, frames, drivers.

    Labels are only collected: `texts` of the joints, and names of frames.
    """
    scene = sheet.scene
    for joint in scene.joints:
        if joint.kind == "prismatic":
            _draw_prismatic(sheet, joint)
        elif joint.kind == "translation" or joint.kind not in SYMBOLS:
            _draw_slides(sheet, joint)
    for link in scene.links[1:]:
        _draw_link(sheet, link)
    _draw_rods(sheet)
    pins = _draw_pins(sheet)
    for link in scene.links:
        _draw_frames(sheet, link, frames)
    for joint in scene.joints:
        _draw_gap(sheet, joint)
    for joint in scene.joints:
        if joint.driven:
            _draw_driver(sheet, joint)
    _label_joints(sheet, pins, texts)


def _draw_slides(sheet: Sheet, joint: SeenJoint) -> None:
    """Draw strokes along the axes of F along which a joint slides."""
    c = project_to_plane(joint.M)
    along = [joint.F[:2, "xyz".index(p.axis)] for p in joint.motions if p.kind == P]
    if along:
        ends = [(c - 2.6 * sheet.r * d, c + 2.6 * sheet.r * d) for d in along]
        sheet.add_outline(shapes.make_strokes(ends), f"joint:{joint.name}", style.PINS, ec=INK)


def _is_pin(joint: SeenJoint) -> bool:
    """Whether a joint is drawn as a pin: a revolute joint, or a turning one without another symbol."""
    return joint.kind == "revolute" or (
        joint.kind not in SYMBOLS and any(p.kind == R for p in joint.motions)
    )


def draw_ghost(sheet: Sheet, scene: Scene, number: int) -> None:
    """Draw the links of an earlier position faintly."""
    for link in scene.links[1:]:
        p = project_to_plane(scene.list_points(link))
        if len(p) > 1:
            colour = style.choose_link_colour(link.number)
            fill = 0.13 if len(find_hull(p)) == 2 else 0.05
            look = {"fc": (colour, fill), "ec": (colour, 0.25), "lw": 0.5}
            sheet.add_outline(
                shapes.make_rounded_outline(p, 0.5 * BAR * sheet.r),
                f"ghost{number}:{link.name}",
                style.GHOSTS,
                **look,
            )


# ---- links


def _draw_link(sheet: Sheet, link: SeenLink) -> None:
    """Draw a link as a bar or polygon through its joints."""
    scene = sheet.scene
    r = sheet.r
    p = project_to_plane(scene.list_points(link))
    colour = style.choose_link_colour(link.number)
    gid = f"link:{link.name}"
    if link.particle:
        X = next(iter(link.bodies.values()))
        sheet.add_outline(
            shapes.make_circle(project_to_plane(X), 1.1 * r), gid, style.POINTS, fc=colour, ec=INK
        )
        return
    # nothing but its joint: its own origin is the other end
    if len(p) == 1 and len(link.joints) == 1:
        p = remove_duplicates(
            np.concatenate([p, [project_to_plane(next(iter(link.bodies.values())))]])
        )
    if len(p) < 2:
        if any(scene.joints[j].kind == "prismatic" for j in link.joints) or any(
            links[0] == link.number for _, links, _, _ in scene.lines
        ):
            return  # the block or the slot is all of it
        _draw_cross(sheet, next(iter(link.bodies.values())), gid, colour)
        return
    corners = find_hull(p)
    dark = style.mix_colours(colour, INK, 0.45)
    if len(corners) > 2:
        sheet.add_outline(
            shapes.make_rounded_outline(p, BAR * r),
            gid,
            style.POLYGONS,
            fc=(colour, 0.28),
            ec=dark,
            lw=1.1,
        )
        for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
            sheet.obstacles.add_segment(a, b, 1.1 * r, 0.8)
        middle = p.mean(axis=0)
        for a in corners:
            sheet.obstacles.add_segment(a, middle, 1.5 * r, 0.08)
    else:
        sheet.add_outline(
            shapes.make_rounded_outline(p, BAR * r),
            gid,
            style.BARS,
            fc=style.mix_colours(colour, PAPER, 0.25),
            ec=dark,
        )
        sheet.obstacles.add_segment(corners[0], corners[1], 1.0 * r)


def _draw_cross(sheet: Sheet, X: Array, gid: str, colour: str) -> None:
    """Draw a body without extent as its axes x and y."""
    c = project_to_plane(X)
    arms = X[:2, :2].T * 3.2 * sheet.r
    for name, arm, part in (("x", arms[0], 0.0), ("y", arms[1], 0.45)):
        line = np.array([c, c + arm])
        sheet.add_line(
            line,
            f"{gid}:{name}",
            style.POINTS,
            color=style.mix_colours(colour, PAPER, part),
            lw=1.6,
        )
        sheet.add_outline(
            shapes.make_arrow_head(c + 1.35 * arm, arm, 1.3 * sheet.r),
            f"{gid}:{name}",
            style.POINTS,
            fc=style.mix_colours(colour, PAPER, part),
            ec="none",
        )
        sheet.obstacles.add_segment(c, c + 1.35 * arm, 0.8 * sheet.r)
    sheet.add_outline(shapes.make_circle(c, 0.5 * sheet.r), gid, style.POINTS, fc=colour, ec="none")


def _draw_rods(sheet: Sheet) -> None:
    """Draw rods between two points, and the pins that run in slots."""
    r = sheet.r
    pivots = [
        project_to_plane(j.find_pose_on(0))
        for j in sheet.scene.joints
        if j.kind == "revolute" and 0 in (j.parent, j.child)
    ]
    for name, links, ends, wrong in sheet.scene.rods:
        p = project_to_plane(ends)
        colour = OPEN if abs(wrong) > WRONG * sheet.scene.size else INK
        sheet.add_outline(
            shapes.make_rounded_outline(p, 0.4 * BAR * r),
            f"rod:{name}",
            style.BARS,
            fc=style.FAINT,
            ec=colour,
        )
        sheet.obstacles.add_segment(p[0], p[1], r)
        sheet.labels.append((name, p.mean(axis=0), 1.2 * r, {"gid": f"label:{name}", "color": INK}))
        for link, end in zip(links, p, strict=True):
            if link == 0 and not any(np.linalg.norm(c - end) < 0.3 * r for c in pivots):
                _draw_ground(sheet, end, _choose_ground_direction(sheet, end), name)
                pivots.append(end)
            sheet.add_outline(
                shapes.make_circle(end, 0.7 * r),
                f"rod:{name}:end",
                style.PINS,
                fc=PAPER,
                ec=INK,
                lw=1.2,
            )
    for mark in sheet.scene.marks:
        draw_contact(sheet, mark)
    for name, links, A, point in sheet.scene.lines:
        along = A[:2, 2]
        c = project_to_plane(point)
        at = float(along @ (c - project_to_plane(A)))
        ends = project_to_plane(A) + np.outer([min(0.0, at - 5 * r), max(0.0, at + 5 * r)], along)
        colour = style.choose_link_colour(links[0])
        sheet.add_outline(
            shapes.make_rounded_outline(ends, 1.25 * r),
            f"line:{name}",
            style.POLYGONS,
            fc=style.mix_colours(colour, PAPER, 0.45),
            ec=style.mix_colours(colour, INK, 0.45),
        )
        slot = project_to_plane(A) + np.outer([at - 4 * r, at + 4 * r], along)
        sheet.add_outline(
            shapes.make_rounded_outline(slot, 0.6 * r),
            f"slot:{name}",
            style.RAILS,
            fc=PAPER,
            ec=colour,
        )
        sheet.add_outline(
            shapes.make_circle(c, 0.6 * r),
            f"line:{name}:point",
            style.PINS,
            fc=PAPER,
            ec=INK,
            lw=1.2,
        )
        sheet.obstacles.add_segment(ends[0], ends[1], 1.3 * r)
        sheet.labels.append((name, c, 1.2 * r, {"gid": f"label:{name}", "color": INK}))


# ---- joints


def _draw_pins(sheet: Sheet) -> list[tuple[Array, list[SeenJoint]]]:
    """Draw revolute joints and ground symbols; return the joints at each point."""
    scene = sheet.scene
    r = sheet.r
    groups: list[tuple[Array, list[SeenJoint]]] = []
    for joint in scene.joints:
        c = project_to_plane(scene.find_seat(joint, r))
        group = next((g for g in groups if np.linalg.norm(g[0] - c) < 0.3 * r), None)
        if group is None:
            groups.append((c, [joint]))
        else:
            group[1].append(joint)
    for _, joints in groups:
        grounded = [j for j in joints if j.kind == "revolute" and 0 in (j.parent, j.child)]
        if grounded:
            base = project_to_plane(grounded[0].find_pose_on(0))
            _draw_ground(sheet, base, _choose_ground_direction(sheet, base), grounded[0].name)
    for c, joints in groups:
        turning = [j for j in joints if _is_pin(j)]
        for joint in turning:
            sheet.add_outline(
                shapes.make_circle(project_to_plane(joint.M), r),
                f"joint:{joint.name}",
                style.PINS,
                fc=PAPER,
                ec=INK,
                lw=1.5,
            )
        if turning:
            sheet.obstacles.add_segment(c, c, 1.3 * r, 2.0)
    return groups


def _choose_ground_direction(sheet: Sheet, p: Array) -> Array:
    """Choose the direction (2,) of the ground symbol at p (2,): down, unless a link lies there."""
    best = np.array([0.0, -1.0])
    least = np.inf
    if sheet.steady:
        return best
    for down, dislike in (
        ((0.0, -1.0), 0.0),
        ((0.0, 1.0), 0.35),
        ((-1.0, 0.0), 0.45),
        ((1.0, 0.0), 0.45),
    ):
        d = np.array(down)
        along = np.array([-d[1], d[0]])
        where = p + np.outer(np.linspace(1.5, style.GROUND_HEIGHT + style.HATCH, 6), d) * sheet.r
        where = where[:, None] + np.outer(np.linspace(-1.2, 1.2, 5), along) * sheet.r
        cost = float((sheet.obstacles.find_covering_weights(where) > 0.5).mean()) + dislike
        if cost < least:
            best = d
            least = cost
    return best


def _draw_ground(sheet: Sheet, p: Array, down: Array, name: str) -> None:
    """Draw the ground symbol at p (2,) in the direction `down` (2,)."""
    triangle, base = shapes.make_ground_symbol(p, down, sheet.r)
    sheet.add_outline(
        triangle,
        f"ground:{name}",
        style.RAILS,
        fc=style.mix_colours(GROUND, PAPER, 0.75),
        ec=GROUND,
        lw=1.1,
    )
    sheet.add_outline(base, f"hatch:{name}", style.RAILS, fc="none", ec=GROUND, lw=1.0)
    sheet.obstacles.add_segment(p, p + style.GROUND_HEIGHT * sheet.r * down, 1.3 * sheet.r)
    along = style.GROUND_HALF * sheet.r * np.array([-down[1], down[0]])
    foot = p + (style.GROUND_HEIGHT + 0.5 * style.HATCH) * sheet.r * down
    sheet.obstacles.add_segment(foot - along, foot + along, sheet.r)


def _draw_prismatic(sheet: Sheet, joint: SeenJoint) -> None:
    """Draw a prismatic joint as a block on a rail, or as cylinder and rod."""
    scene = sheet.scene
    r = sheet.r
    if scene.is_telescopic(joint, r):
        _draw_telescope(sheet, joint)
        return
    ends = joint.parent, joint.child
    rail = (
        0
        if 0 in ends
        else max(ends, key=lambda k: (scene.compute_reach(joint, k), k == joint.parent))
    )
    block = joint.child if rail == joint.parent else joint.parent
    c = project_to_plane(joint.find_pose_on(block))
    along = joint.axis[:2]
    lo, hi = compute_travel(scene, joint, sheet.configurations)
    now = float(along @ (project_to_plane(joint.M) - project_to_plane(joint.F)))
    if block == joint.parent:
        along = -along
        lo = lo
        hi = hi
        now = now
    a = c + (lo - now - 4.2 * r) * along
    b = c + (hi - now + 4.2 * r) * along
    if rail == 0:
        _draw_ground_rail(sheet, joint, a, b)
    else:
        own = project_to_plane(joint.find_pose_on(rail))
        ends = np.array([a, b, own])[np.argsort([along @ (x - c) for x in (a, b, own)])][[0, 2]]
        if not scene.links[rail].particle and float(along @ (own - c)) < 0:
            ends = np.array([own, b])
        colour = style.choose_link_colour(rail)
        sheet.add_outline(
            shapes.make_rounded_outline(ends, 0.5 * BAR * r),
            f"rail:{joint.name}",
            style.BARS,
            fc=style.mix_colours(colour, PAPER, 0.25),
            ec=style.mix_colours(colour, INK, 0.45),
        )
        sheet.obstacles.add_segment(ends[0], ends[1], r)
    colour = style.choose_link_colour(block)
    sheet.add_outline(
        shapes.make_box(c, along, BLOCK[0] * r, BLOCK[1] * r),
        f"block:{joint.name}",
        style.BLOCKS,
        fc=style.mix_colours(colour, PAPER, 0.55),
        ec=style.mix_colours(colour, INK, 0.45),
        lw=1.2,
    )
    sheet.obstacles.add_segment(c - BLOCK[0] * r * along, c + BLOCK[0] * r * along, 1.8 * r, 1.5)


def _draw_ground_rail(sheet: Sheet, joint: SeenJoint, a: Array, b: Array) -> None:
    """Draw the rail from a to b on the ground, at the lower side of the block."""
    along = (b - a) / np.linalg.norm(b - a)
    side = np.array([-along[1], along[0]])
    if abs(side[1]) > 0.3:
        down = side if side[1] < 0 else -side
    else:
        points = np.concatenate(
            [project_to_plane(sheet.scene.list_points(link)) for link in sheet.scene.links]
        )
        down = side if side @ (points.mean(axis=0) - a) < 0 else -side
    shift = BLOCK[1] * sheet.r * down
    sheet.add_outline(
        shapes.make_hatched_line(a + shift, b + shift, down, sheet.r),
        f"rail:{joint.name}",
        style.RAILS,
        fc="none",
        ec=GROUND,
        lw=1.1,
    )
    sheet.obstacles.add_segment(a + 1.3 * shift, b + 1.3 * shift, sheet.r)


def _draw_telescope(sheet: Sheet, joint: SeenJoint) -> None:
    """Draw a prismatic joint as a cylinder on the parent and a rod of the child."""
    r = sheet.r
    p = project_to_plane(joint.F)
    m = project_to_plane(joint.M)
    along = m - p
    for (a, b, half), link, part in (
        ((0.12, 0.58, 1.35), joint.parent, "cylinder"),
        ((0.5, 1.0, 0.45), joint.child, "rod"),
        ((0.0, 0.12, 0.7), joint.parent, "neck"),
    ):
        colour = style.choose_link_colour(link)
        ends = np.array([p + a * along, p + b * along])
        unit = along / np.linalg.norm(along)
        outline = shapes.make_box(
            ends.mean(axis=0), unit, float(np.linalg.norm(ends[1] - ends[0])) / 2, half * r
        )
        layer = style.BLOCKS if part == "cylinder" else style.BARS
        sheet.add_outline(
            outline,
            f"{part}:{joint.name}",
            layer,
            fc=style.mix_colours(colour, PAPER, 0.35),
            ec=style.mix_colours(colour, INK, 0.45),
        )
        sheet.obstacles.add_segment(ends[0], ends[1], half * r)


def _draw_gap(sheet: Sheet, joint: SeenJoint) -> None:
    """Draw a dashed red line between the two parts of a joint whose loop is not closed."""
    a = project_to_plane(joint.F)
    b = project_to_plane(joint.M)
    if joint.kind == "prismatic":
        b = b - joint.axis[:2] * float(joint.axis[:2] @ (b - a))
    elif joint.kind not in SYMBOLS:
        a = b if joint.gap is None else b - joint.gap[:2]
    elif joint.kind != "revolute":
        return
    if np.linalg.norm(b - a) > WRONG * sheet.scene.size:
        sheet.add_line(
            np.array([a, b]), f"open:{joint.name}", style.ARROWS, color=OPEN, lw=1.3, ls=(0, (3, 2))
        )
        sheet.add_outline(
            shapes.make_circle(a, 0.6 * sheet.r),
            f"open:{joint.name}:end",
            style.PINS,
            fc=PAPER,
            ec=OPEN,
            lw=1.2,
        )


def _draw_driver(sheet: Sheet, joint: SeenJoint) -> None:
    """Draw a curved arrow around a driven pin, or a straight arrow beside a driven slider."""
    r = sheet.r
    c = project_to_plane(joint.M)
    gid = f"driver:{joint.name}"
    look = {"fc": DRIVER, "ec": "none"}
    if joint.kind == "prismatic":
        along = joint.axis[:2]
        c = project_to_plane(sheet.scene.find_seat(joint, r))
        side = np.array([-along[1], along[0]])
        side = side if side[1] > 0 else -side
        start = c + 2.6 * r * side - 2.2 * r * along
        sheet.add_line(
            np.array([start, start + 3.4 * r * along]), gid, style.ARROWS, color=DRIVER, lw=1.7
        )
        sheet.add_outline(
            shapes.make_arrow_head(start + 4.6 * r * along, along, 1.5 * r),
            f"{gid}:head",
            style.ARROWS,
            **look,
        )
        sheet.obstacles.add_segment(start, start + 4.6 * r * along, 0.8 * r)
        return
    radius = 3.0 * r
    sweep = float(np.deg2rad(110.0))
    begin: float
    costs: list[tuple[float, float]] = []
    for begin in np.deg2rad(np.arange(0.0, 360.0, 15.0)):
        angles = np.linspace(begin, begin + sweep, 12)
        line = c + radius * np.stack([np.cos(angles), np.sin(angles)], axis=1)
        up = 0.15 * np.sin(begin + sweep / 2)
        costs.append((float(sheet.obstacles.find_covering_weights(line).mean()) - up, begin))
    start = 0.6 if sheet.steady else min(costs)[1]
    line, head = shapes.make_arc(c, radius, start, start + sweep, 1.5 * r)
    sheet.add_line(line, gid, style.ARROWS, color=DRIVER, lw=1.7, solid_capstyle="butt")
    sheet.add_outline(head, f"{gid}:head", style.ARROWS, **look)
    sheet.obstacles.add_line(line, 0.8 * r)


# ---- frames and labels


def _draw_frames(sheet: Sheet, link: SeenLink, labels: bool) -> None:
    """Draw the frames of a link that are not at a joint, with their names if `labels`."""
    centres = [project_to_plane(j.M) for j in sheet.scene.joints]
    for name, X in link.frames.items():
        c = project_to_plane(X)
        gid = f"frame:{name}"
        if link.is_ground:
            d = 0.8 * sheet.r * np.array([[1.0, 1.0], [1.0, -1.0]])
            sheet.add_outline(
                shapes.make_strokes([(c - e, c + e) for e in d]),
                gid,
                style.POINTS,
                ec=GROUND,
                lw=1.2,
            )
        elif any(np.linalg.norm(c - p) < 0.3 * sheet.r for p in centres):
            sheet.add_outline(
                shapes.make_circle(c, 0.35 * sheet.r), gid, style.POINTS, fc=INK, ec="none"
            )
        else:
            sheet.add_outline(
                shapes.make_circle(c, 0.55 * sheet.r), gid, style.POINTS, fc=INK, ec=PAPER, lw=0.8
            )
        sheet.obstacles.add_segment(c, c, 0.8 * sheet.r, 2.0)
        if labels:
            look = {
                "gid": f"label:{name}",
                "style": "italic",
                "color": style.mix_colours(INK, PAPER, 0.3),
            }
            sheet.labels.append((name, c, 0.9 * sheet.r, {**look, "size": style.FONT - 1}))


def draw_frame(sheet: Sheet, name: str, X: Array, labels: bool) -> None:
    """Draw the axes x and y of a frame (4, 4), and its name if it has no label yet."""
    c = project_to_plane(X)
    gid = f"mark:{name}"
    for k, axis in enumerate("xy"):
        along = X[:2, k]
        colour = style.AXES[k]
        tip = c + style.MARK * sheet.r * along
        sheet.add_line(
            np.array([c, tip]),
            f"{gid}:{axis}",
            style.ARROWS,
            color=colour,
            lw=1.8,
            solid_capstyle="round",
        )
        head = shapes.make_arrow_head(tip + 1.4 * sheet.r * along, along, 1.4 * sheet.r)
        sheet.add_outline(head, f"{gid}:{axis}:head", style.ARROWS, fc=colour, ec="none")
        sheet.obstacles.add_segment(c, tip + 1.4 * sheet.r * along, 0.8 * sheet.r)
    sheet.add_outline(
        shapes.make_circle(c, 0.6 * sheet.r), gid, style.ARROWS, fc=PAPER, ec=INK, lw=1.2
    )
    if labels and not any(name in link.frames for link in sheet.scene.links):
        look = {
            "gid": f"label:{name}",
            "style": "italic",
            "color": style.mix_colours(INK, PAPER, 0.3),
        }
        sheet.labels.append((name, c, 1.2 * sheet.r, {**look, "size": style.FONT - 1}))


def _label_joints(
    sheet: Sheet, groups: list[tuple[Array, list[SeenJoint]]], texts: dict[str, str]
) -> None:
    """Collect the labels of joints; joints at one point share a label."""
    for c, joints in groups:
        if not (names := ", ".join(texts[j.name] for j in joints if texts.get(j.name))):
            continue
        clearance = (1.9 if any(j.kind == "prismatic" for j in joints) else 1.25) * sheet.r
        look = {"gid": f"label:{names}", "color": INK}
        sheet.labels.insert(0, (names, c, clearance, look))
