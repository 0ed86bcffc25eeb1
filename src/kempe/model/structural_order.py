"""An order of joints by the structure of a mechanism; names decide only between equal joints.

Bodies get colours that are refined until neighbours tell nothing new (Weisfeiler and Leman, 1968):
first by what is connected to what by which type of joint, then by the placements of joints, then by
limits. Colours are numbers whose order follows from these data, not from names and not from the
order of declaration.
"""

from __future__ import annotations

import math
import re
from collections import defaultdict
from collections.abc import Mapping
from typing import Any

from kempe.constraints.base import make_content_key
from kempe.description.mechanism import Mechanism
from kempe.description.parts import Joint
from kempe.poses import Placement
from kempe.values import Expression, Value, evaluate_value

SWEEPS = 16
"""Refinements at most of one stage, each from the ground outwards and back; two are usual."""
DIGITS = 9
"""Decimals to which placements are compared, in parts of the largest distance and in numbers of a
rotation."""


def make_sort_key(name: str) -> tuple[Any, ...]:
    """Return a sort key of a name by which 'J2' comes before 'J10'."""
    parts = ((p, p.lstrip("0")) for p in re.split(r"(\d+)", name) if p)
    return tuple((0, len(d), d) if p.isdecimal() else (1, 0, p) for p, d in parts) + (
        (-1, 0, name),
    )


def order_joints(
    mechanism: Mechanism, level: Mapping[str, int], first: Mapping[str, Any]
) -> dict[str, int]:
    """Number the joints of `first` by structure; names decide last.

    Parameters
    ----------
    mechanism
        The mechanism.
    level
        For each body the number of joints on a shortest way from the ground to it.
    first
        For each joint that is ordered a key that comes before everything else, of structure only.
    """
    joints = [mechanism.joints[name] for name in first]
    colours = _Colours(mechanism, joints, level)
    coupled = _list_couplings(mechanism)
    labels: dict[str, list[Any]] = {
        j.name: [
            first[j.name],
            j.type.type_name,
            repr(sorted(j.type.options.items())),
            coupled[j.name],
        ]
        for j in joints
    }
    colours.refine_colours(labels)
    if not colours.can_tell_joints_apart(labels):
        size = _find_largest_coordinate(mechanism)
        for j in joints:
            labels[j.name] += [_round_placement(j.X_PF, size), _round_placement(j.X_CM, size)]
        colours.refine_colours(labels)
    if not colours.can_tell_joints_apart(labels):
        for j in joints:
            labels[j.name].append(
                sorted((name, low, high) for name, (low, high) in j.limits.items())
            )
        colours.refine_colours(labels)
    alike = not colours.can_tell_joints_apart(labels)
    key: dict[str, tuple[Any, ...]] = {
        j.name: (
            labels[j.name],
            colours.of[j.parent],
            colours.of[j.child],
            (str(j.X_PF), str(j.X_CM), make_sort_key(j.name)) if alike else (),
        )
        for j in joints
    }
    return {name: k for k, name in enumerate(sorted(first, key=key.__getitem__))}


class _Colours:
    """Colours of bodies as numbers, in `of`: bodies with equal structure have equal colours.

    Those of a level closer to the ground are smaller.
    """

    def __init__(self, mechanism: Mechanism, joints: list[Joint], level: Mapping[str, int]):
        self.joints = joints
        self.at: dict[str, list[tuple[str, bool, str]]] = defaultdict(list)
        for j in joints:
            self.at[j.parent].append((j.name, False, j.child))
            self.at[j.child].append((j.name, True, j.parent))
        ties: dict[str, list[str]] = defaultdict(list)
        for c in mechanism.constraints.values():
            for end, body in enumerate((c.parent, c.child)):
                ties[body].append(f"{c.kind} {end} {len(make_content_key(c.of))}")
        layers: dict[int, list[str]] = defaultdict(list)
        for body in self.at:
            layers[level[body]].append(body)
        self.layers = [layers[k] for k in sorted(layers)]
        self.of: dict[str, int] = {}
        self.own = {b: (mechanism.bodies[b].particle, sorted(ties[b])) for b in self.at}
        before = 0
        for layer in self.layers:
            self._colour_layer(layer, self.own, before)
            before += len(layer)

    def _colour_layer(self, layer: list[str], key: Mapping[str, Any], before: int) -> None:
        """Colour the bodies of a layer by the number of bodies with smaller keys.

        Those of earlier layers count.
        """
        last: Any = None
        colour = before
        for k, body in enumerate(sorted(layer, key=key.__getitem__)):
            if k == 0 or key[body] != last:
                colour = before + k
                last = key[body]
            self.of[body] = colour

    def refine_colours(self, labels: Mapping[str, Any]) -> None:
        """Refine the colours by labels of joints until their number stays the same.

        Layers are refined from the ground outwards and back.
        """
        places = {repr(x): x for x in labels.values()}
        number = {text: k for k, text in enumerate(sorted(places, key=places.__getitem__))}
        label = {name: number[repr(x)] for name, x in labels.items()}
        before = [0]
        for layer in self.layers:
            before.append(before[-1] + len(layer))
        for _ in range(SWEEPS):
            count = len(set(self.of.values()))
            if count == before[-1]:
                return
            for k in (*range(len(self.layers)), *reversed(range(len(self.layers)))):
                layer = self.layers[k]
                if len({self.of[b] for b in layer}) < len(layer):
                    key = {
                        b: (
                            self.of[b],
                            sorted(
                                (label[j], back, self.of[other]) for j, back, other in self.at[b]
                            ),
                        )
                        for b in layer
                    }
                    self._colour_layer(layer, key, before[k])
            if len(set(self.of.values())) == count:
                return

    def can_tell_joints_apart(self, labels: Mapping[str, Any]) -> bool:
        """Tell whether no two joints have the same label and ends of the same colours."""
        keys = {(repr(labels[j.name]), self.of[j.parent], self.of[j.child]) for j in self.joints}
        return len(keys) == len(self.joints)


def _list_couplings(mechanism: Mechanism) -> dict[str, list[Any]]:
    """List, for each joint, the couplings it takes part in, with their factors."""
    out: dict[str, list[Any]] = defaultdict(list)
    for coupling in mechanism.couplings.values():
        terms = [
            (coupling.of, True, -1.0),
            *((c, False, _evaluate_number(x)) for c, x in coupling.sources.items()),
        ]
        factors = sorted(factor for _, _, factor in terms[1:])
        for name, of, factor in terms:
            joint = name if name in mechanism.joints else name.rpartition(".")[0]
            out[joint].append((of, factor, factors))
    for roles in out.values():
        roles.sort()
    return out


def _evaluate_number(x: Value) -> float:
    """Evaluate a number of the description with all parameters taken as 1.

    So neither names nor values of parameters decide.
    """
    found = float(
        evaluate_value(x, dict.fromkeys(x.names, 1.0) if isinstance(x, Expression) else {})
    )
    return found if math.isfinite(found) else 0.0


def _evaluate_placement(placement: Placement) -> list[float]:
    """Evaluate the first three rows of a placement with all parameters taken as 1."""
    X = placement.evaluate_pose(dict.fromkeys(placement.names, 1.0))[:3].ravel().tolist()
    return [x if math.isfinite(x) else 0.0 for x in X]


def _find_largest_coordinate(mechanism: Mechanism) -> float:
    """Return the largest coordinate of a joint's frames on their bodies, in metres; 1 if all are 0."""
    poses = (_evaluate_placement(X) for j in mechanism.joints.values() for X in (j.X_PF, j.X_CM))
    return max((abs(x) for X in poses for x in (X[3], X[7], X[11])), default=0.0) or 1.0


def _round_placement(placement: Placement, size: float) -> list[float]:
    """Round the numbers of a placement, so that it is the same however it was written.

    Position first, the largest x first: the legs of most parallel robots are counted from the one
    on the x axis.
    """
    X = _evaluate_placement(placement)
    position = [round(-X[k] / size, DIGITS) + 0.0 for k in (3, 7, 11)]
    return position + [round(-x, DIGITS) + 0.0 for k, x in enumerate(X) if k % 4 != 3]
