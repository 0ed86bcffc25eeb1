"""Conversion of systems and configurations to other coordinates.

These are the coordinates of Pinocchio, MuJoCo and ROS, the poses of all bodies, and chains of turns
and slides.

>>> import kempe
>>> robot = kempe.load("two_link")
>>> poses = kempe.convert.to_maximal(robot, robot.mid)
>>> bool(abs(kempe.convert.from_maximal(robot, poses) - robot.mid).max() < 1e-12)
True
>>> kempe.convert.maximal(robot).name
'two_link, maximal'
"""

from kempe.assemble.from_poses import from_maximal
from kempe.forward.expand_joints import expand_joints
from kempe.forward.maximal import maximal, maximal_q, to_maximal
from kempe.forward.neighbours import (
    Correspondence,
    from_joint_state,
    from_mujoco,
    from_pinocchio,
    to_joint_state,
    to_mujoco,
    to_pinocchio,
)

__all__ = [
    "Correspondence",
    "expand_joints",
    "from_joint_state",
    "from_maximal",
    "from_mujoco",
    "from_pinocchio",
    "maximal",
    "maximal_q",
    "to_joint_state",
    "to_maximal",
    "to_mujoco",
    "to_pinocchio",
]
