"""A system in other coordinates: the poses of all bodies, which the joints tie together; turns and
slides alone.

>>> import kempe
>>> robot = kempe.load("two_link")
>>> poses = kempe.convert.to_maximal(robot, robot.mid)
>>> bool(abs(kempe.convert.from_maximal(robot, poses) - robot.mid).max() < 1e-12)
True
>>> kempe.convert.maximal(robot).name
'two_link, maximal'
"""

from kempe.assemble.from_poses import from_maximal
from kempe.forward.expanded import expanded
from kempe.forward.maximal import maximal, maximal_q, to_maximal

__all__ = ["expanded", "from_maximal", "maximal", "maximal_q", "to_maximal"]
