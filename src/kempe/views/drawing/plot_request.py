"""What one picture is of: configurations with their names, a motion, curves, frames, and the
options.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe.arrays import is_sequence
from kempe.equations.judge import judge_configurations
from kempe.errors import InputError
from kempe.model.configurations import compute_distance, find_home, make_q, read_q
from kempe.spatial import Array
from kempe.values import Expression
from kempe.views.drawing import style
from kempe.views.drawing.scene import Scene, SeenJoint
from kempe.views.plot_options import PlotOptions

if TYPE_CHECKING:
    from kempe.model.model import Model

IN_PLACE = 4
SHORT = (2, 12)
"""Configurations whose names stand beside them, and letters of these in space and in the plane;
others have a key."""
NOTHING = 1e-12
"""Values up to this are rounding [m, rad]."""
ACROSS = 3
"""Names and values of a joint that are written in one line."""


@dataclass(frozen=True)
class Subject:
    """All that there is to draw of a system: the scene in full, others over it, earlier positions,
    curves, frames.
    """

    system: Model
    scene: Scene
    options: PlotOptions
    others: tuple[Scene, ...] = ()
    """Further configurations, drawn over the first."""
    titles: tuple[str, ...] = ()
    """Names of all configurations, or none."""
    ghosts: tuple[Scene, ...] = ()
    way: Array | None = None
    """Configurations (n, nq) of a motion."""
    curves: dict[str, Array] = field(default_factory=dict[str, Array])
    """Curves (n, 3) of frames over the motion."""
    here: dict[str, Array] = field(default_factory=dict[str, Array])
    """Poses (4, 4) of the frames that are marked: by a dot on their curve, else by their axes."""
    axes: dict[str, Array] = field(default_factory=dict[str, Array])
    """Poses (4, 4) of the frames whose axes are drawn with their names."""
    workspace: Any = None
    radius: float | None = None
    """Radius [m] of a pin, the same in all frames of a motion; None: as suits the scene."""
    missed: Array | None = None
    """A place that was wanted and is not reached, after the place nearest to it (2, 3)."""
    units: dict[str, str] = field(default_factory=dict[str, str])
    """The unit of each coordinate."""

    @property
    def marks(self) -> dict[str, Array]:
        """Poses (4, 4) of the frames whose axes are drawn, by name."""
        return {**({} if self.curves else self.here), **self.axes}

    @property
    def keyed(self) -> bool:
        """Whether configurations have numbers in the picture, and their names in a key beside it."""
        longest = max(map(len, self.titles), default=0)
        many = len(self.titles) > IN_PLACE and longest > SHORT[0]
        return bool(self.others) and (many or longest > SHORT[self.system.dim == 2])

    @property
    def missed_text(self) -> str:
        """Distance to a target that is not reached, as text."""
        from kempe.views.drawing.page import format_length

        gap = 0.0 if self.missed is None else float(np.linalg.norm(self.missed[1] - self.missed[0]))
        return format_length(float(f"{gap:.3g}"), self.system.unit)

    def place_names(self, points: list[Array]) -> list[tuple[Array, str, dict[str, Any]]]:
        """List the name or number of each configuration with its position and text style.

        It stands at the point (d,) of the configuration that is farthest from the others.
        """
        if not self.others or not any(self.titles):
            return []
        out: list[tuple[Array, str, dict[str, Any]]] = []
        for k, (title, own) in enumerate(zip(self.titles, points, strict=False)):
            rest = np.concatenate([p for i, p in enumerate(points) if i != k])
            gap = np.linalg.norm(own[:, None] - rest, axis=-1).min(axis=1)
            look = {
                "gid": f"label:configuration{k}",
                "color": style.choose_configuration_colour(k),
                "weight": "bold",
            }
            out.append((own[int(np.argmax(gap))], str(k + 1) if self.keyed else title, look))
        return out

    def list_coordinates(self, joint: SeenJoint) -> list[str]:
        """List the names of the coordinates of a joint."""
        return self.system.structure.coordinates_of_joint(joint.name)

    def format_joint(self, joint: SeenJoint) -> str:
        """Format the label of a joint: its name, or its coordinates with their values."""
        words = self.options.words
        names = self.list_coordinates(joint)
        with_values = [format_coordinate(self, n) for n in names] if "coordinates" in words else []
        angles = bool(self.options.angles) and names == [joint.name]
        if "joints" not in words or angles or (with_values and names == [joint.name]):
            return ", ".join(with_values if not angles else [])
        parts = [joint.name, *with_values]
        return ",\n".join(", ".join(parts[k : k + ACROSS]) for k in range(0, len(parts), ACROSS))

    def format_coordinate(self, name: str) -> str:
        """Format the label of a coordinate's arc or length: its name, with its value if requested."""
        return format_coordinate(self, name) if "coordinates" in self.options.words else name

    def format_bodies(self, link: Any) -> str:
        """Format the names of the bodies of a link, with their numbers where names lack these."""
        number = {name: k for k, name in enumerate(self.system.body_names)}
        names = [
            b if b.endswith(str(number[b])) or number[b] == 0 else f"{number[b]} {b}"
            for b in link.bodies
        ]
        return ", ".join(names[:3]) + (", ..." if len(names) > 3 else "")

    def format_parameters(self) -> str:
        """Format the parameters with their values, in lines of four; '' if not requested."""
        parts = [f"{k} = {v:.4g}" for k, v in self.system.structure.parameters.items()]
        if "parameters" not in self.options.words:
            return ""
        return "\n".join("   ".join(parts[k : k + 4]) for k in range(0, len(parts), 4))


def format_coordinate(subject: Subject, name: str) -> str:
    """Format a coordinate with its value and unit."""
    from kempe.equations.judge import compute_coordinate_value
    from kempe.views.drawing.page import format_length

    value = float(compute_coordinate_value(subject.system, subject.scene.q, name))
    value = value if abs(value) > NOTHING else 0.0
    unit = subject.units.get(name, "")
    said = (
        format_length(round(value, 4), unit)
        if unit == subject.system.unit and abs(value) >= 1e-4
        else f"{value:.3g} {unit}".rstrip()
    )
    return f"{name} = {said}"


def choose_subscript(system: Model, frame: str) -> str:
    """Choose the subscript of a frame's axes x and y: the number of a body, or a short name."""
    if frame in system.body_names:
        return f"_{{{system.body_names.index(frame)}}}"
    return f"_{{{frame}}}" if len(frame) <= 3 and frame.isalnum() else ""


def list_named_lengths(system: Model, bodies: Any) -> list[tuple[str, float]]:
    """List the parameter expressions that place joints and frames on bodies, with their values."""
    m = system.mechanism
    placed = [j.X_PF for j in m.joints.values() if j.parent in bodies]
    placed += [j.X_CM for j in m.joints.values() if j.child in bodies]
    placed += [f.X_BF for f in m.frames.values() if f.body in bodies]
    values = [
        x for p in placed for _, numbers in p.steps for x in numbers if isinstance(x, Expression)
    ]
    return [(x.text.lstrip("-"), abs(float(x.evaluate(m.parameters)))) for x in values]


def name_length(known: list[tuple[str, float]], length: float, unit: str) -> str:
    """Return the shortest parameter expression with this length, or the length itself."""
    from kempe.views.drawing.page import format_length

    same = [text for text, value in known if abs(value - length) < 1e-9 * max(length, 1e-9)]
    return min(same, key=len) if same else format_length(float(f"{length:.3g}"), unit)


# ---- configurations

FARTHEST = 1e15
"""Coordinates up to which a configuration is drawn: squares of distances must stay finite."""
MOST = 32
"""Configurations that one picture shows at most."""


def read_configuration(system: Model, q: Any, way: Array | None = None) -> Array:
    """Read the configuration (nq,) to be drawn from the argument `q` of `plot`; of several the
    first.
    """
    return read_configurations(system, q, way)[0][0]


def read_configurations(system: Model, q: Any, way: Array | None) -> tuple[Array, tuple[str, ...]]:
    """Read the configurations (k, nq) to be drawn, and their names if they have any."""
    if q is None:
        return choose_configuration(system, way)[None], ()
    titles = tuple(getattr(q, "titles", ()))
    if isinstance(q, str):
        q = make_q(system, q)
    elif isinstance(getattr(q, "q", None), np.ndarray):
        q = q.q
    given = read_q(system, q)
    found = given.reshape(math.prod(given.shape[:-1]), system.nq)
    good = (np.abs(found) < FARTHEST).all(axis=1)
    if not good.all() and (np.ndim(q) == 1 or not good.any()):
        raise InputError(
            f"q holds numbers that are not finite, or beyond {FARTHEST:g}: there is nothing to draw"
        )
    if not len(found):
        raise InputError("q holds no configuration: there is nothing to draw")
    if good.sum() > MOST:
        raise InputError(
            f"q holds {good.sum()} configurations; at most {MOST} are drawn, more of a motion as "
            "`path`"
        )
    return found[good], tuple(t for t, ok in zip(titles, np.ravel(good), strict=False) if ok)


def choose_configuration(system: Model, configurations: Array | None) -> Array:
    """Choose the configuration that is drawn by default."""
    q = find_home(system)
    if configurations is None:
        if judge_configurations(system, q):
            return q
        from kempe.assemble.assemble import assemble

        closed = assemble(system, start=q)
        return closed.q if closed else q
    finite = configurations[np.isfinite(configurations).all(axis=1)]
    return finite[int(np.argmin(compute_distance(system, finite, q)))]


def read_motion(system: Model, path: Any) -> tuple[Array | None, tuple[str, ...]]:
    """Read the configurations (n, nq) of a path and the names of its driven joints.

    `path` is an array, or an answer with a field `q`, and perhaps `driver`, a name or names; None
    gives (None, ()). Errors: `InputError` for other shapes.
    """
    if path is None:
        return None, ()
    way: Any = path
    configurations = read_q(
        system, path if isinstance(path, np.ndarray) else getattr(path, "q", path)
    )
    if configurations.ndim != 2 or not np.isfinite(configurations).all(axis=1).any():
        raise InputError(
            f"path has shape {configurations.shape}; it must be (n, {system.nq}), not all of it NaN"
        )
    driver: Any = getattr(way, "driver", None)
    names: list[Any] = (
        [driver] if isinstance(driver, str) else list(driver) if is_sequence(driver) else []
    )
    joints = {c: j for j in system.joint_names for c in system.structure.coordinates_of_joint(j)}
    return configurations, tuple(joints.get(n, n) for n in names if isinstance(n, str))
