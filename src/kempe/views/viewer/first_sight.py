"""What a page shows at first: the posture of the system, the frame that is dragged, and the camera."""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING

import numpy as np

from kempe.equations.judge import judge_configurations
from kempe.forward.fk import fk, jacobian
from kempe.model.configurations import (
    compute_mid_configuration,
    has_loops,
    list_units,
    make_q,
    sample_configurations,
)
from kempe.numerics.rank import Level, Spectrum
from kempe.spatial import Array
from kempe.views.drawing.plot_request import choose_configuration
from kempe.views.drawing.scene import number_links

if TYPE_CHECKING:
    from kempe.model.model import Model


# ---- the frame

TOOLS = ("tcp", "tool0", "tool", "effector", "ee", "hand", "gripper", "flange")
"""Words in names of frames that people drag, the likeliest first."""
PARTS_OF_TOOLS = ("finger", "thumb", "index", "middle", "ring", "little", "optical", "camera")
"""Words in names of frames that are a part of a tool, or look at it."""


def sort_frames_by_use(system: Model) -> tuple[str, ...]:
    """Sort the names of frames and bodies by how likely they are to be dragged.

    Names of tools come first, then frames, then bodies; among these what is on the last moving link.
    """
    number = number_links(system)
    frames = [(number[f.body] > 0, 1, name) for name, f in system.structure.frames.items()]
    bodies = [(number[name] > 0, 0, name) for name in system.body_names[1:]]
    every = [*reversed(frames), *reversed(bodies)]
    every.sort(key=lambda x: (not x[0], _rank_tool(x[2]), -x[1]))
    return tuple(x[2] for x in every) or system.frame_names


def _rank_tool(name: str) -> int:
    """Return the rank of a name among those of tools; names without such a word come after."""
    words = "".join(c if c.isalnum() else " " for c in name.lower()).split()
    if any(part in word for word in words for part in PARTS_OF_TOOLS):
        return len(TOOLS)
    return next((k for k, tool in enumerate(TOOLS) if tool in words), len(TOOLS))


# ---- the posture

NAMED = ("home", "rest", "ready", "stand", "standing", "half_sitting", "closed")
"""Names of postures that are taken as the first one, the best first."""
BENDS = np.deg2rad([-45.0, 45.0, -90.0, 90.0])
"""Angles by which joints of an arm are bent out of a singular configuration."""
BENT = 3
"""Joints that are bent at most."""
MOST_BENT = 8
"""Joints of an arm up to which combinations of bends are tried."""
LIMB = 3
"""Joints of a limb at least, and joints between the ground and a limb at most: fingers are none."""
SIMPLE = 0.1
"""Mean height that a further bend must bring, in parts of the reach."""
REGULAR = 0.5
"""Part of the best conditioning that a configuration must have."""


def choose_first_posture(system: Model, frame: str) -> Array:
    """Choose the configuration (nq,) that is shown at first.

    It is a posture named `home`, `rest`, `stand`, `closed` or alike; else the neutral configuration
    of what has several limbs, where limits allow it; else one inside the limits in which the frame
    of an arm is far from singular.
    """
    names = {name.lower(): name for name in reversed(system.structure.posture_names)}
    for name in (names[n] for n in NAMED if n in names):
        q = make_q(system, name)
        if judge_configurations(system, q):
            return q
    if has_loops(system) or system.mechanism.constraints:
        return choose_configuration(system, None)
    inside = bool(np.all((system.lower <= 0.0) & (system.upper >= 0.0)))
    if inside and _count_limbs(system) > 1:
        return system.neutral.copy()
    return (
        _bend_arm(system, frame) if system.nq == system.nv else choose_configuration(system, None)
    )


def map_links_above(system: Model) -> dict[int, int]:
    """Map the number of each moving link to that of the link before it in the tree."""
    number = number_links(system)
    out = dict[int, int]()
    for body, parent in enumerate(system.parent, 1):
        above, link = (number[system.body_names[k]] for k in (parent, body))
        if above != link:
            out[link] = above
    return out


def _count_limbs(system: Model) -> int:
    """Count the ends of the tree that hang on `LIMB` joints of their own, near the ground."""
    above = map_links_above(system)
    children = np.bincount([*above.values()], minlength=len(system.body_names) + 1)

    def count_joints(link: int, fork: bool) -> tuple[int, int]:
        """Count the joints from a link to the next fork or to the ground, and return its link."""
        count = 0
        while link in above and (not count or not fork or children[link] == 1):
            link = above[link]
            count += 1
        return count, link

    count = 0
    for end in (link for link in above if not children[link]):
        own, fork = count_joints(end, True)
        count += own >= LIMB and count_joints(fork, False)[0] <= LIMB
    return count


def _bend_arm(system: Model, frame: str) -> Array:
    """Return the middle of the limits, with a few joints bent so that the frame is regular there.

    Of such configurations it is a high one: an elbow is up.
    """
    mid = compute_mid_configuration(system)
    scale = np.abs(fk(system, mid)[..., :3, 3]).max() or 1.0
    rng = np.random.default_rng(0)
    some = np.stack([sample_configurations(system, rng) for _ in range(4)])
    moving = np.abs(jacobian(system, some, frame)).max(axis=(0, 1)) > 0.0
    unit = list_units(system)
    turns = [
        k for k in np.flatnonzero(moving).tolist() if unit[system.coordinate_names[k]] == "rad"
    ]
    if not 0 < len(turns) <= MOST_BENT:
        return mid.copy()
    tries = [mid]
    for count in range(1, BENT + 1):
        for joints in itertools.combinations(turns, count):
            bends = np.array(list(itertools.product(BENDS, repeat=count)))
            q = np.repeat(mid[None], len(bends), axis=0)
            q[:, joints] += bends
            tries.extend(q[np.all((q >= system.lower) & (q <= system.upper), axis=1)])
    q = np.array(tries)
    quality = _measure_regularity(system, np.concatenate([q, some]), frame, scale)[: len(q)]
    up = 1 if system.dim == 2 else 2
    height = np.column_stack([fk(system, q)[..., up, 3], fk(system, q, frame)[..., up, 3]])
    low = height.min(axis=1)
    above = low >= min(0.0, float(low.max())) - 1e-9 * scale
    good = above & (quality >= REGULAR * quality[above].max())
    bent = np.count_nonzero(q != mid, axis=1)
    liked = height.mean(axis=1) - SIMPLE * scale * bent
    return q[int(np.argmax(np.where(good, liked.round(6), -np.inf)))]


def _measure_regularity(system: Model, q: Array, frame: str, scale: float) -> Array:
    """Measure how far the frame is from singular at configurations (n, nq), from 0 to 1."""
    J = jacobian(system, q, frame)
    J[:, :3] /= scale
    J = J[:, :2] if system.dim == 2 else J
    spectrum = Spectrum(J)
    rank = int(spectrum.compute_ranks(Level.GENERIC).max())
    return spectrum.values[:, max(rank, 1) - 1] / spectrum.largest


# ---- the camera

FILL = 0.77
"""Part of the picture's width or height that what is drawn takes."""
UPRIGHT = 0.75
"""Width by height of a picture up to which the panel may lie over it, from below, as on phones;
elsewhere it is beside the picture. Browsers report sizes in pixels of the screen, of which a phone
has more than a desk."""
COVERED = 0.6
"""Part of the height that the panel covers there at most."""


def fit_camera(points: Array, away: Array, upright: Array, opening: float, aspect: float) -> Array:
    """Find the nearest place of a camera with all points (n, 3) in sight, and where it looks (2, 3).

    It looks against `away` (3,), with `upright` (3,) upwards. `opening` is the angle of the picture's
    height, `aspect` its width by its height. Of an upright picture the lower part stays free.
    """
    below = COVERED if aspect < UPRIGHT else 0.0
    z = away / np.linalg.norm(away)
    x = np.cross(upright, z)
    x /= np.linalg.norm(x)
    axes = np.stack([x, np.cross(z, x), z])
    p = points @ axes.T
    wide = np.tan(0.5 * opening)
    # the four planes of the pyramid, which touch the points
    filled = FILL * wide * np.array([aspect, 1.0 - below])
    middle = np.array([0.0, below * wide])
    high = (p[:, :2] + (middle + filled) * p[:, 2:]).max(axis=0)
    low = (p[:, :2] + (middle - filled) * p[:, 2:]).min(axis=0)
    far = float((0.5 * (high - low) / filled).max())
    place = 0.5 * (high + low) - middle * far
    near = float(0.5 * (p[:, 2].min() + p[:, 2].max()))
    return np.array([[*place, far], [*place, near]]) @ axes


def is_in_sight(
    points: Array, camera: Array, at: Array, upright: Array, opening: float, aspect: float
) -> bool:
    """Tell whether points (n, 3) are in the picture of a camera (3,) that looks at a place (3,)."""
    z = (camera - at) / np.linalg.norm(camera - at)
    x = np.cross(upright, z)
    x /= np.linalg.norm(x)
    p = (points - camera) @ np.stack([x, np.cross(z, x), z]).T
    slopes = np.tan(0.5 * opening) * np.array([aspect, 1.0])
    return bool(np.all(np.abs(p[:, :2]) <= -slopes * p[:, 2:]))
