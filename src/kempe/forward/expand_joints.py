"""Systems whose joints are replaced by chains of revolute and prismatic joints."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

from kempe import spatial
from kempe.arguments import explain_errors
from kempe.description.mechanism import Mechanism, choose_unused_name
from kempe.description.parts import Body, Coupling, Joint
from kempe.errors import InputError
from kempe.joints import Primitive, Prismatic, Q, R, Revolute, Spherical
from kempe.model.coordinates import list_coordinate_names
from kempe.poses import Placement, place

if TYPE_CHECKING:
    from kempe.model.model import SystemType


class _SingleJoint(NamedTuple):
    """One turn or slide of a joint: full name of its coordinate, name in the joint, primitive."""

    name: str
    key: str
    motion: Primitive


@explain_errors
def expand_joints(system: SystemType) -> SystemType:
    """Return the same system with revolute and prismatic joints only.

    Parameters
    ----------
    system
        System with joints of any type.

    Returns
    -------
    System
        System in which links of zero length connect the parts of a joint. Coordinates keep their
        names, so that `q` is the same unless a joint has a quaternion.

    Raises
    ------
    InputError
        If a quaternion is coupled or locked.

    Notes
    -----
    A joint with one freedom stays as it is. A screw becomes a turn and a slide that follows it. A
    ball becomes three turns about z, y and x, with angles in place of its quaternion.

    Examples
    --------
    >>> import kempe
    >>> m = kempe.Mechanism("shaft")
    >>> _ = m.universal("U", m.ground, m.body("shaft"))
    >>> kempe.convert.expand_joints(m.build()).coordinate_names
    ('U.rx', 'U.ry')
    """
    m = system.mechanism
    joints = m.joints
    m.joints = {}
    m.name = f"{m.name}, expanded"
    for joint in joints.values():
        parts = _split_joint(m, joint)
        if len(parts) == 1 and parts[0].motion.multiplier == 1.0 or not parts:
            m.joints[joint.name] = joint
        else:
            _add_joint_chain(m, joint, parts)
    return type(system)(m)


def _split_joint(m: Mechanism, joint: Joint) -> list[_SingleJoint]:
    """Split a joint into turns and slides; a quaternion becomes three angles, in postures, too."""
    keys, steps = joint.type.layout(m.dim, m.bodies[joint.child].particle)
    names = list_coordinate_names(m, joint)
    out = list[_SingleJoint]()
    for p in steps:
        if p.kind != Q:
            out.append(_SingleJoint(names[p.coordinate], keys[p.coordinate], p))
            continue
        four = names[p.coordinate : p.coordinate + 4]
        tied = {*m.locks, *m.couplings, *(s for c in m.couplings.values() for s in c.sources)}
        if tied & set(four):
            raise InputError(
                f"joint {joint.name!r} has a quaternion that is locked or coupled, and no angles"
            )
        angles, turns = Spherical(angles=True).layout()
        out += [
            _SingleJoint(f"{joint.name}.{a}", a, turn)
            for a, turn in zip(angles, turns, strict=True)
        ]
        for posture in m.postures.values():
            if set(four) & set(posture):
                q = [posture.pop(n, float(k == 0)) for k, n in enumerate(four)]
                rpy = spatial.matrix_to_rpy(spatial.quat_wxyz_to_matrix(q)).tolist()
                posture |= {part.name: x for part, x in zip(out[-3:], rpy[::-1], strict=True)}
    return out


def _add_joint_chain(m: Mechanism, joint: Joint, parts: list[_SingleJoint]) -> None:
    """Add a joint to a mechanism as a chain of turns and slides."""
    here = joint.parent
    X = joint.X_PF
    for k, (name, key, motion) in enumerate(parts):
        last = k == len(parts) - 1
        axis = place(axis=motion.axis)
        there = joint.child if last else choose_unused_name(m, f"{joint.name} {k + 1}")
        if not last:
            m.bodies[there] = Body(there)
        follows = name in m.joints
        if follows:
            name, source = choose_unused_name(m, f"{name} slide"), name
            m.couplings[name] = Coupling(name, {source: motion.multiplier})
        tables: tuple[Mapping[str, Any], ...] = (
            joint.limits,
            joint.velocity_limits,
            joint.effort_limits,
        )
        own: list[Any] = [
            {"": table[key]} if key in table and not follows else {} for table in tables
        ]
        m.joints[name] = Joint(
            name,
            Revolute() if motion.kind == R else Prismatic(),
            here,
            there,
            X @ axis,
            (joint.X_CM if last else Placement()) @ axis,
            *own,
            actuated=None if follows else joint.actuated,
            cut=joint.cut and last,
            where=joint.where,
            dim=joint.dim,
            of_particle=joint.of_particle and last,
        )
        here = there
        X = Placement()
