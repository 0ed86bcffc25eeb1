"""Random planar mechanisms with one freedom, and their components counted by brute force."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

import kempe
from kempe import Mechanism


def crank_and_dyads(rng: np.random.Generator, most: int = 2) -> kempe.System:
    """A crank and up to `most` dyads of turns and slides, each hung on two bodies that are there
    already.
    """
    m = Mechanism("crank and dyads", dim=2)
    bodies = [m.ground, m.body("crank")]
    m.revolute("crank", m.ground, bodies[1], at=rng.uniform(-1.0, 1.0, 2))
    for d in range(rng.integers(1, most + 1)):
        i, j = rng.choice(len(bodies), 2, replace=False)
        a = m.body(f"a{d}")
        b = m.body(f"b{d}")
        kind = str(rng.choice(["RRR", "RRP", "RPR", "PRP"], p=[0.6, 0.25, 0.12, 0.03]))
        for end, (letter, body, hung) in enumerate(
            ((kind[0], bodies[i], a), (kind[2], bodies[j], b))
        ):
            at = rng.uniform(-1.0, 1.0, 2)
            own = (rng.uniform(0.3, 2.0) * end, 0.0)
            if letter == "R":
                m.revolute(f"{d}{'ac'[end]}", body, hung, at=at, child_at=own)
            else:
                m.prismatic(f"{d}{'ac'[end]}", body, hung, at=at, axis=(*rng.normal(size=2), 0.0))
        if kind[1] == "R":
            m.revolute(f"{d}b", a, b, at=(rng.uniform(0.3, 2.0), 0.0))
        else:
            m.prismatic(f"{d}b", a, b, axis=(1.0, 0.0, 0.0), at=(0.0, rng.uniform(0.0, 0.2)))
        bodies += [a, b]
    return m.build()


def limited(system: kempe.System, rng: np.random.Generator) -> kempe.System:
    """The same with limits of one or two coordinates around a configuration that is drawn."""
    q = system.assemble({"crank": rng.uniform(-3.0, 3.0)}).q
    names = rng.choice(system.coordinate_names, rng.integers(1, 3), replace=False)
    place = system.coordinate_names.index
    return system.with_limits(
        {
            str(n): (q[place(n)] - rng.uniform(0.1, 2.0), q[place(n)] + rng.uniform(0.1, 1.0))
            for n in names
        }
    )


def counted_on_a_grid(system: kempe.System, n: int) -> int:
    """Components, from all assemblies at n angles of the crank.

    Assemblies of one branch at neighbouring angles are joined. One that is not there at the next
    angle is joined to the nearest one whose end of that branch it may share: one other sign, not
    more than 0.35 away.
    """
    plan = system.loops.closed_form("crank")
    # planar: one velocity a coordinate, in the same order
    low = system.lower
    high = system.upper
    crank = system.coordinate_names.index("crank")
    free = not np.isfinite(low[crank])
    x = np.linspace(*((-np.pi, np.pi) if free else (low[crank], high[crank])), n, endpoint=not free)
    q, there = plan.all(x[:, None])
    turning = system.structure.coordinates.turning
    inside = (q >= low - 1e-12) & (q <= high + 1e-12)
    for shift in (-2.0 * np.pi, 2.0 * np.pi):
        inside |= turning & (q + shift >= low - 1e-12) & (q + shift <= high + 1e-12)
    there &= inside.all(axis=-1)
    node = np.arange(there.size).reshape(there.shape)
    signs = plan.branches()
    pairs = []
    rows = np.arange(n if free else n - 1)
    following = (rows + 1) % n
    i, k = np.nonzero(there[rows] & there[following])
    pairs += zip(node[rows[i], k], node[following[i], k], strict=True)
    for here, other in ((rows, following), (following, rows)):
        for row, k in zip(*np.nonzero(there[here] & ~there[other]), strict=True):
            ends = np.flatnonzero(
                there[here[row]] & ~there[other[row]] & ((signs != signs[k]).sum(axis=1) == 1)
            )
            way = q[here[row], ends] - q[here[row], k]
            way -= np.where(turning, 2.0 * np.pi * np.round(way / (2.0 * np.pi)), 0.0)
            far = np.linalg.norm(way, axis=1)
            if len(far) and far.min() < 0.35:
                pairs.append((node[here[row], k], node[here[row], ends[np.argmin(far)]]))
    a, b = np.array(pairs, dtype=int).reshape(-1, 2).T
    found = connected_components(coo_matrix((np.ones(len(a)), (a, b)), shape=(there.size,) * 2))[1]
    return len(np.unique(found[there.ravel()]))
