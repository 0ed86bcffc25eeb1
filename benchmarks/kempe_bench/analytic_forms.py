"""A chain of six turns in the forms that libraries ask for: table, axes, ortho-parallel parameters."""

from __future__ import annotations

from typing import Any

import numpy as np

from kempe import spatial
from kempe.errors import UnsupportedError
from kempe.spatial import Array
from kempe_bench.analytic_arms import Chain

STRAIGHT = 1e-9
"""Sine below which axes count as parallel, and metres below which they meet."""


def chain_of(kinbody: Any) -> Chain:
    """The chain that ssik describes by axes and by placements before and after each turn."""
    steps = []
    X = np.eye(4)
    for joint in kinbody.joints:
        turned = spatial.pose(spatial.align_z(joint.axis))
        steps.append(X @ joint.T_left @ turned)
        X = spatial.inverse(turned) @ joint.T_right
    return Chain(np.array(steps), X)


def dh_table(chain: Chain) -> tuple[list[tuple[float, float, float]], Array, Array, Array]:
    """Rows (a, alpha, d) in the standard convention, zeros of the joints, and what makes a target
    of a pose.

    The target is base @ pose @ tool, the pose of the table's last frame in its first. A placement
    before a joint is Tx(a) Rx(alpha) of one row and Rz(theta) Tz(d) of the next (Denavit and
    Hartenberg, 1955). Errors: `UnsupportedError` where it is not.
    """
    x, z = zip(*(_screws(X) for X in (*chain.X, chain.tool)), strict=True)
    rows = [(a, alpha, d) for (a, alpha), (d, _) in zip(x[1:], z[:-1], strict=True)]
    first = spatial.pose(spatial.rot_x(x[0][1]), [x[0][0], 0.0, 0.0])
    last = spatial.pose(spatial.rot_z(z[-1][1]), [0.0, 0.0, z[-1][0]])
    return (
        rows,
        np.array([theta for _, theta in z[:-1]]),
        spatial.inverse(first),
        spatial.inverse(last),
    )


def _screws(X: Array) -> tuple[tuple[float, float], tuple[float, float]]:
    """(a, alpha) and (d, theta) of X = Tx(a) Rx(alpha) Rz(theta) Tz(d)."""
    alpha = float(np.arctan2(-X[1, 2], X[2, 2]))
    theta = float(np.arctan2(-X[0, 1], X[0, 0]))
    a = float(X[0, 3])
    d = float(X[2, 3] * np.cos(alpha) - X[1, 3] * np.sin(alpha))
    made = spatial.pose(spatial.rot_x(alpha), [a, 0.0, 0.0]) @ spatial.pose(
        spatial.rot_z(theta), [0.0, 0.0, d]
    )
    if np.max(np.abs(made - X)) > STRAIGHT:
        raise UnsupportedError(
            "a placement has six freedoms: no Denavit-Hartenberg table has it in one row"
        )
    return (a, alpha), (d, theta)


def decomposed(chain: Chain) -> tuple[str, Array, Array]:
    """ik-geo's name of the chain's family, its axes h (6, 3) and the steps p (7, 3) between points
    on them, at q = 0.

    Steps vanish between axes that meet, as the closed forms want it. Errors: `UnsupportedError`
    where a search over one or two angles would be needed: with the published package such searches
    find no answers of these arms.
    """
    h = chain.frames[:6, :3, 2]
    o = chain.frames[:6, :3, 3].copy()
    first, elbow, wrist = (_meeting(h, o, i) for i in (0, 3, 4))
    level = [np.linalg.norm(np.cross(h[i], h[i + 1])) < STRAIGHT for i in (1, 2)]
    if all(level) and wrist is not None:
        family = "three_parallel_two_intersecting"
        o[4:] = wrist
    elif wrist is not None and elbow is not None and np.linalg.norm(wrist - elbow) < STRAIGHT:
        o[3:] = wrist
        if first is not None:
            o[:2] = first
        other = "spherical" if first is None else "spherical_two_intersecting"
        family = "spherical_two_parallel" if level[0] else other
    else:
        raise UnsupportedError("ik-geo has no closed form for this arm")
    return family, h, np.diff(np.vstack([np.zeros(3), o, chain.frames[6, :3, 3]]), axis=0)


def _meeting(h: Array, o: Array, i: int) -> Array | None:
    """Where axes i and i + 1 meet, or None where they pass each other or are parallel."""
    across = np.cross(h[i], h[i + 1])
    apart = o[i + 1] - o[i]
    sine = float(np.linalg.norm(across))
    if sine < STRAIGHT or abs(apart @ across) > STRAIGHT * sine:
        return None
    return o[i] + (np.cross(apart, h[i + 1]) @ across / sine**2) * h[i]


def opw_parameters(chain: Chain) -> tuple[dict[str, float], Array, Array, Array, Array]:
    """Ortho-parallel parameters, directions and zeros of the joints, and what makes a target of a
    pose.

    The chain's q = zeros + directions * (angles of the parameters' arm), whose target is base @
    pose @ tool. That arm stands upright at zero, axes z, y, y, z, y, z (Brandstoetter, Angerer and
    Hofbaur, 2014). Errors: `UnsupportedError` for other arms.
    """
    q = np.zeros(6)
    (h, o) = _axes(chain, np.zeros(6))
    z = h[0]
    y = h[1]
    x = np.cross(y, z)
    wrist = _meeting(h, o, 4)
    elbow = _meeting(h, o, 3)
    right = [h[i] @ h[j] for i, j in ((0, 1), (2, 3), (3, 4), (4, 5))]
    concurrent = (
        wrist is not None and elbow is not None and np.linalg.norm(wrist - elbow) < STRAIGHT
    )
    if not concurrent or np.max(np.abs([*right, *np.cross(h[1], h[2])])) > STRAIGHT:
        raise UnsupportedError("the arm has no ortho-parallel basis with a spherical wrist")
    upper = o[2] - o[1] - ((o[2] - o[1]) @ y) * y
    q[1] = _angle(h[1], upper, z)
    (h, o), way = _axes(chain, q), np.sign(h[3] @ (wrist - o[2]))
    q[2] = _angle(h[2], way * h[3], z)
    for i, aim in ((3, y), (4, z)):
        h, o = _axes(chain, q)
        q[i] = _angle(h[i], h[i + 1], aim)
    h, o = _axes(chain, q)
    centre = _meeting(h, o, 4)
    assert centre is not None
    numbers = {
        "a1": float((o[1] - o[0]) @ x),
        "a2": float((centre - o[2]) @ x),
        "b": float((centre - o[0]) @ y),
        "c1": 0.0,
        "c2": float((o[2] - o[1]) @ z),
        "c3": float((centre - o[2]) @ z),
        "c4": 0.0,
    }
    ways = np.array([1.0 if h[i] @ aim > 0.0 else -1.0 for i, aim in enumerate((z, y, y, z, y, z))])
    base = spatial.pose(np.stack([x, y, z], axis=-1), o[0] + ((o[1] - o[0]) @ z) * z)
    place = [numbers["a1"] + numbers["a2"], numbers["b"], numbers["c2"] + numbers["c3"]]
    tool = spatial.inverse(chain.pose(q[None])[0]) @ base @ spatial.pose(np.eye(3), place)
    return numbers, ways, q, spatial.inverse(base), tool


def _axes(chain: Chain, q: Array) -> tuple[Array, Array]:
    """Directions and points (6, 3) of the axes at q (6,)."""
    X = np.eye(4)
    out = []
    for step, angle in zip(chain.X, q, strict=True):
        X = X @ step
        out.append(X)
        X = X @ spatial.pose(spatial.rot_z(angle))
    return np.array(out)[:, :3, 2], np.array(out)[:, :3, 3]


def _angle(axis: Array, start: Array, end: Array) -> float:
    """Angle about the axis from one direction to another."""
    return float(
        np.arctan2(axis @ np.cross(start, end), start @ end - (start @ axis) * (end @ axis))
    )
