"""Solids for a system in space: links, ground marks, and a symbol for each joint type."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from kempe import spatial
from kempe.joints import P, Q
from kempe.spatial import Array
from kempe.views.drawing import style
from kempe.views.drawing.scene import (
    Scene,
    SeenJoint,
    SeenLink,
    SeenMark,
    compute_travel,
    remove_duplicates,
)
from kempe.views.drawing.solids import Solids, find_flat_hull
from kempe.views.drawing.style import DRIVER, GROUND, INK, OPEN, WRONG

OF_SIZE = 0.02
OF_LINK = 0.13
LEAST = 0.0125
"""Radius of a hinge: as part of the drawing, at most as part of a short link, at least of the
drawing."""
DETOUR = 1.76
"""How much longer the way along two axes and their common normal may be than the straight one:
sqrt(3) and a bit."""
LINK = 0.5
"""Radius of a link's tube in radii of a hinge."""
STRONG = 0.64
"""The same of a solid link, which tapers from one bearing to the next."""
OF_ROOM = 0.3
MOST = 1.8
"""Radius of a solid bearing: as part of the distance to the next one on its links, and at most, in
radii of a hinge."""
HANDLE = 7.0
"""Length of the bar that stands for a link that has nothing but its joint."""
BEYOND = 3.5
"""How far a rail goes on beyond the ends of what slides on it."""
JOINT = "#dfe4e8"
TURNING = ("revolute", "cylindrical", "helical")


def choose_radius(scene: Scene) -> float:
    """Choose the radius [m] of hinges from the size of the drawing and its shorter links."""
    lengths = scene.lengths
    short = float(np.quantile(lengths, 0.35)) if len(lengths) else scene.size
    return max(min(OF_SIZE * scene.size, OF_LINK * short), LEAST * scene.size)


def choose_bearing_radii(scene: Scene, r: float) -> list[float]:
    """Choose the radius [m] of each joint: of a revolute one by the room for it, of others `r`.

    The room is the distance to the next point on its links.
    """
    out: list[float] = []
    for joint in scene.joints:
        room = np.inf
        for link in (joint.parent, joint.child):
            off = scene.list_points(scene.links[link]) - joint.find_pose_on(link)[:3, 3]
            away = np.linalg.norm(off, axis=1)
            room = min(room, float(away[away > 1e-6 * scene.size].min(initial=np.inf)))
        own = min(OF_ROOM * room, MOST * r)
        out.append(max(own, r) if joint.kind == "revolute" else r)
    return out


def add_scene(solids: Solids, scene: Scene, r: float, configurations: Array | None) -> list[Array]:
    """Add all solids of a scene; return the polylines (n, 3) of its links."""
    skeleton: list[Array] = []
    radii = [r] * len(scene.joints) if solids.by_depth else choose_bearing_radii(scene, r)
    _add_ground(solids, scene, r, radii, skeleton)
    for link in scene.links[1:]:
        _add_link(solids, scene, link, r, radii, skeleton)
    for joint, own in zip(scene.joints, radii, strict=True):
        colour = style.mix_colours(DRIVER, style.PAPER, 0.45) if joint.driven else JOINT
        SYMBOLS.get(joint.kind, _add_other_joint)(solids, scene, joint, own, colour, configurations)
        if joint.driven and joint.kind in TURNING:
            _add_turning_arrow(solids, joint, own)
        _add_gap(solids, joint, own)
    for name, _, ends, wrong in scene.rods:
        colour = OPEN if abs(wrong) > WRONG * scene.size else style.FAINT
        solids.add_tube(f"rod:{name}", ends[0], ends[1], 0.35 * r, colour)
        for end in ends:
            solids.add_ball(f"rod:{name}", end, 0.8 * r, JOINT)
        skeleton.append(ends)
    for mark in scene.marks:
        _add_constraint(solids, mark, r)
    for name, _, A, point in scene.lines:
        along = A[:3, 2] * 6 * r
        solids.add_tube(f"line:{name}", point - along, point + along, 0.2 * r, GROUND)
        solids.add_ball(f"line:{name}", point, 0.8 * r, JOINT)
    return skeleton


def _add_constraint(solids: Solids, mark: SeenMark, r: float) -> None:
    """Add the symbol of a constraint: wheels, a wheel or ball on its plane, or a point."""
    name = f"mark:{mark.name}"
    c = mark.point
    axle = mark.B[:3, 1]
    colour = style.choose_link_colour(mark.link)
    if mark.plane is not None:
        X = np.eye(4)
        X[:3, :3] = spatial.align_z(mark.plane[1])
        X[:3, 3] = mark.plane[0]
        solids.add_plate(
            f"{name}:plane",
            _list_square_corners(X, max(2.0 * mark.radius, 6.0 * r)),
            GROUND,
            0.25,
            GROUND,
        )
    if mark.radius > 0.0 and mark.disc:
        half = 0.08 * mark.radius * axle
        solids.add_tube(name, c - half, c + half, mark.radius, colour, 1, sides=24)
    elif mark.radius > 0.0:
        solids.add_ball(name, c, mark.radius, colour)
    elif mark.symbol == "wheel":
        solids.add_tube(name, c - 6.0 * r * axle, c + 6.0 * r * axle, 0.4 * r, INK)
        for end in (c - 6.0 * r * axle, c + 6.0 * r * axle):
            solids.add_tube(name, end - 0.5 * r * axle, end + 0.5 * r * axle, 2.4 * r, INK, 1)
    else:
        solids.add_ball(name, c, 0.8 * r, JOINT)


def iterate_link_lines(scene: Scene) -> Iterator[tuple[SeenLink, Array]]:
    """Iterate over the moving links and the polylines (n, 3) along which each is drawn."""
    for link in scene.links[1:]:
        for line in list_link_lines(scene, link):
            yield link, line


def list_link_lines(scene: Scene, link: SeenLink) -> list[Array]:
    """List the polylines (n, 3) along which a link is drawn."""
    joints = [scene.joints[j] for j in link.joints]
    centres = remove_duplicates(
        np.array(
            [j.find_pose_on(link.number)[:3, 3] for j in joints]
            + [e[k] for _, n, e, _ in scene.rods for k in (0, 1) if n[k] == link.number]
            + [p for _, n, _, p in scene.lines if n[1] == link.number]
            + [m.point for m in scene.marks if m.link == link.number]
        ).reshape(-1, 3)
    )
    ends = [X[:3, 3] for X in link.frames.values()]
    out: list[Array] = []
    rim = None
    if len(joints) == 2 and len(centres) <= 2:
        first, last = joints
        turns = first.kind in TURNING, last.kind in TURNING
        out.append(
            _connect_axes(first.find_pose_on(link.number), last.find_pose_on(link.number), *turns)
        )
        hub = centres
    elif len(centres) > 2:
        rim = find_flat_hull(centres, 0.02 * scene.size)
        middle = centres.mean(axis=0)
        if rim is None:
            out += [np.array([middle, c]) for c in centres]
        else:
            out.append(centres[[*rim, rim[0]]])
            out += [np.array([middle, c]) for k, c in enumerate(centres) if k not in rim]
        hub = centres if rim is None else np.concatenate([centres, [middle]])
    else:
        hub = centres
        if len(centres) == 2:
            out.append(centres)
        if not ends and len(centres):
            ends = [next(iter(link.bodies.values()))[:3, 3]]
    for p in ends:
        near = hub[int(np.argmin(np.linalg.norm(hub - p, axis=1)))] if len(hub) else p
        if rim is not None:
            near = hub[-1]
        out.append(np.array([near, p]))
    least = 1e-9 * scene.size
    out = [line for line in out if np.linalg.norm(np.diff(line, axis=0), axis=1).sum() > least]
    # nothing but its joint: a handle along x shows it
    if not out and len(joints) == 1 and not link.particle:
        X = next(iter(link.bodies.values()))
        out.append(np.stack([X[:3, 3], X[:3, 3] + HANDLE * choose_radius(scene) * X[:3, 0]]))
    return out


def _connect_axes(A: Array, B: Array, use_a: bool, use_b: bool) -> Array:
    """Connect two joints by a polyline along their axes and the common normal.

    Denavit and Hartenberg (1955).

    Straight where a joint has no axis, where axes are parallel, and where the way would be a
    detour.
    """
    a = A[:3, 3]
    b = B[:3, 3]
    d = b - a
    u = A[:3, 2]
    v = B[:3, 2]
    straight = np.array([a, b])
    if not (use_a or use_b):
        return straight
    c = float(u @ v) if use_a and use_b else 0.0
    sine2 = 1.0 - c * c
    if sine2 < 1e-6:  # parallel: along the first axis, then across
        foot = a + u * float(u @ d)
        line = np.array([a, foot, b])
    else:
        s = (float(u @ d) - c * float(v @ d)) / sine2 if use_a else 0.0
        t = (c * float(u @ d) - float(v @ d)) / sine2 if use_b else 0.0
        line = np.array([a, a + s * u, b + t * v, b])
    length = float(np.linalg.norm(np.diff(line, axis=0), axis=1).sum())
    return line if length <= DETOUR * float(np.linalg.norm(d)) else straight


def _add_link(
    solids: Solids,
    scene: Scene,
    link: SeenLink,
    r: float,
    radii: list[float],
    skeleton: list[Array],
) -> None:
    """Add the solids of a link: tubes along its polylines, or a plate.

    `radii` are those of the bearings of all joints [m].
    """
    colour = style.choose_link_colour(link.number)
    name = f"link:{link.name}"
    drawn = list_link_lines(scene, link)
    fill = style.mix_colours(colour, style.PAPER, 0.15)
    for line in drawn:
        if solids.by_depth:
            _add_pipe(solids, name, line, LINK * r, fill)
            continue
        ends = [_choose_thickness(scene, link, p, r, radii) for p in (line[0], line[-1])]
        _add_pipe(solids, name, line, ends[0], fill, ends[1])
        if len(link.joints) == 1 and any(
            np.allclose(line[-1], X[:3, 3]) for X in link.frames.values()
        ):
            _add_flange(solids, name, line, 1.4 * ends[1], colour)
        if len(line) > 3 and np.allclose(line[0], line[-1]):
            solids.add_plate(name, line[:-1], colour, 0.22)
    skeleton += drawn
    if link.particle:
        solids.add_ball(name, next(iter(link.bodies.values()))[:3, 3], 1.3 * r, colour)
        return
    for frame, X in link.frames.items():
        _add_frame(solids, f"frame:{frame}", X, r)
        skeleton += [np.stack([X[:3, 3], X[:3, 3] + 4.5 * r * X[:3, axis]]) for axis in range(3)]


def _choose_thickness(
    scene: Scene, link: SeenLink, p: Array, r: float, radii: list[float]
) -> float:
    """Choose the radius [m] of a solid link at the end p (3,) of a line: by the bearing there, else
    by the smallest one of the link.
    """
    at = [
        radii[j]
        for j in link.joints
        if np.linalg.norm(scene.joints[j].find_pose_on(link.number)[:3, 3] - p) < 1e-6 * scene.size
    ]
    return STRONG * min(at or [radii[j] for j in link.joints] or [r])


def _add_flange(solids: Solids, name: str, line: Array, radius: float, colour: str) -> None:
    """Add the disc at the end of a line (n, 3) to which a tool is screwed."""
    way = line[-1] - line[-2]
    length = float(np.linalg.norm(way))
    if length > radius:
        solids.add_tube(
            name, line[-1] - 0.3 * radius * way / length, line[-1], radius, colour, edge=INK
        )


def _add_pipe(
    solids: Solids, name: str, line: Array, thick: float, colour: str, end: float | None = None
) -> None:
    """Add a tube along a polyline (n, 3), whose radius goes from `thick` to `end` [m]."""
    steps = np.linalg.norm(np.diff(line, axis=0), axis=1)
    part = np.cumsum([0.0, *steps]) / max(float(steps.sum()), 1e-300)
    radius = (thick + ((thick if end is None else end) - thick) * part).tolist()
    for k, step in enumerate(steps):
        if step > 1e-12:
            last = None if end is None else radius[k + 1]
            solids.add_tube(name, line[k], line[k + 1], radius[k], colour, end_radius=last)
    for k in range(1, len(line) - 1):
        if min(steps[k - 1], steps[k]) > 1e-12:
            solids.add_ball(name, line[k], radius[k], colour)


def _add_frame(solids: Solids, name: str, X: Array, r: float) -> None:
    """Add the three axes of a pose (4, 4); where they are shown on request, a dot."""
    if solids.by_depth:
        _add_triad(solids, name, X, r)
    else:
        solids.add_ball(name, X[:3, 3], 0.45 * r, INK)


def _add_triad(solids: Solids, name: str, X: Array, r: float) -> None:
    """Add the three axes of a pose (4, 4)."""
    for axis, colour in enumerate(style.AXES):
        tip = X[:3, 3] + 3.6 * r * X[:3, axis]
        solids.add_tube(name, X[:3, 3], tip, 0.17 * r, colour, pieces=2, sides=6)
        solids.add_tube(
            name,
            tip,
            tip + 1.1 * r * X[:3, axis],
            0.42 * r,
            colour,
            pieces=1,
            sides=8,
            end_radius=0.0,
        )


# ---- ground


def _add_ground(
    solids: Solids, scene: Scene, r: float, radii: list[float], skeleton: list[Array]
) -> None:
    """Add ground symbols below the joints of the ground, whose bearings have `radii` [m]."""
    link = scene.links[0]
    joints = [
        scene.joints[j]
        for j in link.joints
        if scene.joints[j].kind not in ("free", "planar", "translation")
    ]
    origin = next(iter(link.bodies.values()))[:3, 3]
    rods = [ends[k] for _, links, ends, _ in scene.rods for k in (0, 1) if links[k] == 0]
    centres = remove_duplicates(
        np.array([*(j.find_pose_on(0)[:3, 3] for j in joints), *rods]).reshape(-1, 3)
    )
    alone = len(centres) == 1
    above = 2.0
    if alone:
        r = max([radii[j] for j in link.joints] or [r])
        gap = float(np.linalg.norm(centres[0] - origin))
        if (4 if solids.by_depth else 0.5) * r < gap < 2 * scene.size:
            _add_pipe(
                solids,
                "ground",
                np.array([origin, centres[0]]),
                0.9 * r,
                style.mix_colours(GROUND, style.PAPER, 0.35),
            )
            skeleton.append(np.array([origin, centres[0]]))
            centres = np.array([origin])
            above = 0.0
    elif len(centres) == 2:
        _add_pipe(solids, "ground", centres, 0.4 * r, style.mix_colours(GROUND, style.PAPER, 0.35))
        skeleton.append(centres)
    elif len(centres) > 2:
        rim = find_flat_hull(centres, 0.02 * scene.size)
        if rim is not None:
            solids.add_plate("ground", centres[rim], GROUND, 0.12)
            _add_pipe(
                solids,
                "ground",
                centres[[*rim, rim[0]]],
                0.2 * r,
                style.mix_colours(GROUND, style.PAPER, 0.4),
            )
            skeleton.append(centres[[*rim, rim[0]]])
    for frame, X in link.frames.items():
        _add_frame(solids, f"frame:{frame}", X, r)
    for k, c in enumerate(centres):
        if alone and not solids.by_depth:
            _add_base_plate(solids, f"ground:{k}", c, r, above)
        else:
            _add_ground_symbol(solids, f"ground:{k}", c, r)


def _add_base_plate(solids: Solids, name: str, p: Array, r: float, above: float) -> None:
    """Add the round plate on which an arm stands, and a foot where it is below p (3,).

    `above` is the height of p above the plate in radii `r` [m].
    """
    z = np.array([0.0, 0.0, 1.0])
    plate = p - above * r * z
    fill = style.mix_colours(GROUND, style.PAPER, 0.35)
    if above:
        solids.add_tube(name, plate, p, 1.7 * r, fill, end_radius=0.9 * r)
    solids.add_tube(name, plate - 0.5 * r * z, plate, 2.2 * r, fill, edge=GROUND)


def _add_ground_symbol(solids: Solids, name: str, p: Array, r: float) -> None:
    """Add a ground symbol below p (3,): a pyramid on a hatched plate."""
    base = p - np.array([0.0, 0.0, 3.0 * r])
    square = np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    foot = base + 1.5 * r * square
    fill = style.mix_colours(GROUND, style.PAPER, 0.55)
    for k in range(4):
        corners = np.array([p, foot[k], foot[(k + 1) % 4]])
        normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
        solids.add_face(name, corners, normal / np.linalg.norm(normal), fill, edge=GROUND)
    solids.add_plate(
        name, base + 2.4 * r * square, style.mix_colours(GROUND, style.PAPER, 0.2), 0.45, GROUND
    )


# ---- joints


def _choose_parent_colour(link: int) -> str:
    """Return the colour of the parent's half of a joint, darker than the child's."""
    return style.mix_colours(style.choose_link_colour(link), INK, 0.2)


def _choose_child_colour(j: SeenJoint, colour: str) -> str:
    """Return the colour of the child's half of a joint, which marks drivers."""
    return (
        colour
        if j.driven
        else style.mix_colours(style.choose_link_colour(j.child), style.PAPER, 0.5)
    )


def _find_link_side(scene: Scene, j: SeenJoint, link: int, usual: float) -> Array:
    """Find the direction (3,) along the joint's z axis in which a link lies.

    The `usual` side of z counts where both are open.
    """
    axis = j.find_pose_on(link)[:3, 2]
    away = (
        float((scene.list_points(scene.links[link]) - j.centre).sum(axis=0) @ axis) if link else 0.0
    )
    return axis * (np.sign(away) if abs(away) > 1e-6 * scene.size else usual)


def _add_revolute(
    solids: Solids, scene: Scene, j: SeenJoint, r: float, colour: str, configurations: Array | None
) -> None:
    """Add a revolute joint: a barrel of the child between two knuckles of the parent."""
    name = f"joint:{j.name}"
    c = j.centre
    solids.add_tube(
        name, c - r * j.axis, c + r * j.axis, r, _choose_child_colour(j, colour), 1, edge=INK
    )
    for sign in (-1.0, 1.0):
        solids.add_tube(
            name,
            c + sign * r * j.axis,
            c + 1.7 * sign * r * j.axis,
            r,
            _choose_parent_colour(j.parent),
            1,
            edge=INK,
        )


def _find_rail_ends(
    scene: Scene, j: SeenJoint, r: float, configurations: Array | None
) -> tuple[Array, Array]:
    """Find the ends of a sliding joint's rail: from F to M, or along its travel on the ground."""
    origin = j.F[:3, 3]
    axis = j.axis
    now = float(axis @ (j.centre - origin))
    if 0 not in (j.parent, j.child) or j.kind != "prismatic":
        lo = min(now, 0.0)
        hi = max(now, 0.0)
    else:
        lo, hi = compute_travel(scene, j, configurations)
        lo = min(lo, now)
        hi = max(hi, now)
    c = j.centre - now * axis
    return c + (lo - BEYOND * r) * axis, c + (hi + BEYOND * r) * axis


def _add_split_rail(
    solids: Solids, j: SeenJoint, a: Array, b: Array, half: float, thick: float, colour: str
) -> None:
    """Add the rail from a to b without the part inside the joint's symbol."""
    if not solids.by_depth:
        solids.add_tube(f"rail:{j.name}", a, b, thick, colour)
        return
    for end, sign in ((a, -1.0), (b, 1.0)):
        solids.add_tube(f"rail:{j.name}", j.centre + sign * half * j.axis, end, thick, colour)


def _add_prismatic(
    solids: Solids, scene: Scene, j: SeenJoint, r: float, colour: str, configurations: Array | None
) -> None:
    """Add a prismatic joint: a block on a rail, or cylinder and rod."""
    X = j.M.copy()
    if scene.is_telescopic(j, r):
        along = j.centre - j.F[:3, 3]
        low = j.F[:3, 3] + 0.16 * along
        high = j.F[:3, 3] + 0.56 * along
        X[:3, 3] = scene.find_seat(j, r)
        own = style.mix_colours(style.choose_link_colour(j.child), style.PAPER, 0.35)
        base = style.mix_colours(style.choose_link_colour(j.parent), style.PAPER, 0.15)
        solids.add_tube(f"rod:{j.name}", j.F[:3, 3], low, LINK * r, base)
        solids.add_tube(f"rod:{j.name}", high, j.centre, 0.8 * LINK * r, own)
        half = np.array([1.1 * r, 1.1 * r, 0.2 * float(np.linalg.norm(along))])
        solids.add_box(f"joint:{j.name}", X, half, colour if j.driven else base, INK)
        return
    a, b = _find_rail_ends(scene, j, r, configurations)
    on_ground = 0 in (j.parent, j.child)
    rail = GROUND if on_ground else style.choose_link_colour(j.parent)
    _add_split_rail(solids, j, a, b, 2.0 * r, 0.4 * r, style.mix_colours(rail, style.PAPER, 0.2))
    solids.add_box(
        f"joint:{j.name}",
        X,
        np.array([1.3 * r, 1.3 * r, 2.0 * r]),
        _choose_child_colour(j, colour),
        INK,
    )


def _add_cylindrical(
    solids: Solids, scene: Scene, j: SeenJoint, r: float, colour: str, configurations: Array | None
) -> None:
    """Add a cylindrical joint: a sleeve on a round rail."""
    a, b = _find_rail_ends(scene, j, r, configurations)
    rail = GROUND if 0 in (j.parent, j.child) else style.choose_link_colour(j.parent)
    _add_split_rail(solids, j, a, b, 1.5 * r, 0.55 * r, style.mix_colours(rail, style.PAPER, 0.2))
    half = 1.5 * r * j.axis
    solids.add_tube(
        f"joint:{j.name}",
        j.centre - half,
        j.centre + half,
        1.1 * r,
        _choose_child_colour(j, colour),
        1,
        edge=INK,
    )
    for end in (a, b):  # collars, at which the sleeve turns and stops
        out = 0.3 * r * (end - j.centre) / float(np.linalg.norm(end - j.centre))
        solids.add_tube(
            f"rail:{j.name}",
            end - out,
            end,
            0.95 * r,
            style.mix_colours(rail, style.PAPER, 0.2),
            1,
            edge=INK,
        )


def _add_helical(
    solids: Solids, scene: Scene, j: SeenJoint, r: float, colour: str, configurations: Array | None
) -> None:
    """Add a helical joint: a cylindrical joint with a thread."""
    _add_cylindrical(solids, scene, j, r, colour, configurations)
    turns = np.linspace(0.0, 6 * np.pi, 37)
    along = np.linspace(-1.4, 1.4, 37) * r
    x = j.F[:3, 0]
    y = j.F[:3, 1]
    helix = (
        j.centre
        + 1.15 * r * (np.cos(turns)[:, None] * x + np.sin(turns)[:, None] * y)
        + along[:, None] * j.axis
    )
    for p, q in zip(helix[:-1], helix[1:], strict=True):
        solids.add_tube(f"joint:{j.name}", p, q, 0.14 * r, INK, 1, caps=False, sides=5)


def _add_spherical(
    solids: Solids, scene: Scene, j: SeenJoint, r: float, colour: str, configurations: Array | None
) -> None:
    """Add a spherical joint: a ball of the child in a socket of the parent."""
    solids.add_ball(f"joint:{j.name}", j.centre, 1.35 * r, _choose_child_colour(j, colour))
    solids.add_bowl(
        f"socket:{j.name}",
        j.centre,
        1.6 * r,
        _find_link_side(scene, j, j.parent, -1.0),
        _choose_parent_colour(j.parent),
    )


def _add_universal(
    solids: Solids, scene: Scene, j: SeenJoint, r: float, colour: str, configurations: Array | None
) -> None:
    """Add a universal joint: a cross with arms along x of F and y of M, in the forks of its links."""
    for arm, link, usual in ((j.F[:3, 0], j.parent, -1.0), (j.M[:3, 1], j.child, 1.0)):
        a = j.centre - 1.8 * r * arm
        b = j.centre + 1.8 * r * arm
        solids.add_tube(f"joint:{j.name}", a, b, 0.4 * r, colour, 2, edge=INK)
        tint = _choose_parent_colour(link) if link == j.parent else _choose_child_colour(j, JOINT)
        back = 2.4 * r * _find_link_side(scene, j, link, usual)
        for end, sign in ((a, -1.0), (b, 1.0)):
            solids.add_tube(
                f"joint:{j.name}", end, end + 0.35 * sign * r * arm, 0.62 * r, tint, 1, edge=INK
            )
            solids.add_tube(f"fork:{j.name}", end, end + back, 0.33 * r, tint, 2, edge=INK)
        more = 0.3 * r * arm
        solids.add_tube(
            f"fork:{j.name}", a + back - more, b + back + more, 0.33 * r, tint, 2, edge=INK
        )
    solids.add_ball(f"joint:{j.name}", j.centre, 0.7 * r, colour)


def _add_planar(
    solids: Solids, scene: Scene, j: SeenJoint, r: float, colour: str, configurations: Array | None
) -> None:
    """Add a planar joint: a block on a table."""
    X = j.F.copy()
    solids.add_plate(
        f"joint:{j.name}:table", _list_square_corners(X, 8.0 * r), GROUND, 0.15, GROUND
    )
    solids.add_box(
        f"joint:{j.name}", j.M, np.array([1.8, 1.8, 0.6]) * r, _choose_child_colour(j, colour), INK
    )


def _list_square_corners(X: Array, half: float) -> Array:
    """List the corners (4, 3) of a square in the x-y plane of a pose."""
    corners = np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) * half
    return X[:3, 3] + corners @ X[:3, :3].T


def _add_translation(
    solids: Solids, scene: Scene, j: SeenJoint, r: float, colour: str, configurations: Array | None
) -> None:
    """Add a joint of three translations: a block with three crossed bars."""
    solids.add_box(
        f"joint:{j.name}", j.M, np.full(3, 1.2 * r), _choose_child_colour(j, colour), INK
    )
    for axis in range(3):
        arm = 2.6 * r * j.F[:3, axis]
        solids.add_tube(f"joint:{j.name}", j.centre - arm, j.centre + arm, 0.25 * r, GROUND, 2)


def _add_nothing(
    solids: Solids, scene: Scene, j: SeenJoint, r: float, colour: str, configurations: Array | None
) -> None:
    """Add nothing: a free joint has no symbol."""


def _add_other_joint(
    solids: Solids, scene: Scene, j: SeenJoint, r: float, colour: str, configurations: Array | None
) -> None:
    """Add a joint without its own symbol: a barrel for each rotation, a bar for each translation."""
    for p in j.motions:
        axis = j.F[:3, "xyz".index(p.axis)]
        if p.kind == Q:
            solids.add_ball(f"joint:{j.name}", j.centre, 1.35 * r, colour)
        elif p.kind == P:
            solids.add_tube(
                f"joint:{j.name}",
                j.centre - 2.6 * r * axis,
                j.centre + 2.6 * r * axis,
                0.25 * r,
                GROUND,
                2,
            )
        else:
            solids.add_tube(
                f"joint:{j.name}",
                j.centre - 1.3 * r * axis,
                j.centre + 1.3 * r * axis,
                0.8 * r,
                colour,
                1,
                edge=INK,
            )


SYMBOLS: dict[str, Callable[[Solids, Scene, SeenJoint, float, str, Array | None], None]] = {
    "revolute": _add_revolute,
    "prismatic": _add_prismatic,
    "cylindrical": _add_cylindrical,
    "helical": _add_helical,
    "spherical": _add_spherical,
    "universal": _add_universal,
    "planar": _add_planar,
    "translation": _add_translation,
    "free": _add_nothing,
}
"""Symbols of joint types that have one of their own; `_add_other_joint` draws all others by their
primitives."""


def _add_turning_arrow(solids: Solids, j: SeenJoint, r: float) -> None:
    """Add a curved arrow around the axis of a driven joint."""
    angles = np.linspace(0.0, float(np.deg2rad(235.0)), 22)[:, None]
    circle = np.cos(angles) * j.F[:3, 0] + np.sin(angles) * j.F[:3, 1]
    solids.add_arrow(f"driver:{j.name}", j.centre + 2.2 * r * circle, 0.2 * r, DRIVER)


def _add_gap(solids: Solids, j: SeenJoint, r: float) -> None:
    """Add a red line between the two parts of a joint whose loop is not closed."""
    gap = j.centre - j.F[:3, 3]
    if j.kind not in SYMBOLS:
        gap = np.zeros(3) if j.gap is None else j.gap
    elif j.kind in ("prismatic", "cylindrical", "helical"):
        gap = gap - j.axis * float(j.axis @ gap)
    elif j.kind in ("planar", "translation", "free"):
        return
    if np.linalg.norm(gap) > 0.02 * r:
        solids.add_tube(f"open:{j.name}", j.centre - gap, j.centre, 0.25 * r, OPEN)
