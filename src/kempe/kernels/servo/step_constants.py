"""Constants of steps of velocities, in radians and characteristic lengths.

The kernels read them, and the steps of systems with loops in NumPy.
"""

# ---- rounding

EDGE = 1e-15
"""Part of a coordinate by which it is at a limit."""
BESIDE = 1e-12
"""How near to a bound a velocity is at it."""
BEYOND = 1e-12
"""By how much a bound may seem to be exceeded."""
INWARD = 1e-14
"""Gradients below this fraction of what is required release no bound."""
SLACK = 1e-13
"""By how much a row that no step moves may seem to be beyond its bound."""
NOISE = 1e-9
"""Part of the largest velocity up to which one is rounding."""
NOTHING = 1e-14
"""Length of what is missed that rounding makes."""
REACHED = 1e-12
"""Length of what is missed up to which a goal counts as reached."""
ROUNDING = 1e-12
"""Singular values, as parts of the largest, that rounding makes."""
DIFFERENCE = 1e-5
"""Step of the differences of Jacobians and gradients."""

# ---- first order

NEAR = 0.05
"""Singular values below this part of the largest are damped, those at zero fully."""
LEAST = 1e-5
"""Weight of small corrections against what is corrected, so that the best ones are unique."""
SHIFT = 2.0
"""Weight, as a multiple of `NEAR`, by which joints beside those at a bound keep the velocities
without bounds."""
BENT = 0.01
"""Sine of the angle by which a direction that is kept may be bent, at singular values of zero."""
WALL = 0.25
"""Largest part by which a singular value may fall in one cycle where a direction is kept."""
AWAY = 1e-6
"""Least curvature by which a singular configuration is left."""
NULL_SPEED = 0.1
"""Cost of self-motion, against that of a slower twist."""
NO_PART = 1e-6
"""Part of what is wished up to which none of it is had."""

# ---- second order

LARGEST = 0.5
ASIDE = 0.05
"""Longest step of a coordinate where no speed bounds it, and where a singular configuration is
left."""
FLAT = 1e-10
SADDLE = 1e-6
"""Parts of the largest curvature: up to the first it counts as none, below minus the second as
negative."""
TAKEN = 0.1
"""Part of the promised decrease that must be had."""
STILL = 1e-20
BLIND = 1e-13
"""Promised decreases, as parts of the square of the error, below which one rests, or rounding hides
the true one."""
TRIALS = 16
"""Steps tried in one cycle, each shorter than the one before."""

# ---- directions that are kept

LITTLE = 0.01
LEADS = 0.05
"""Decreases of the error, as parts of what the joints move: up to the first no direction is kept,
from the second on it alone counts; between them the straight step and the one towards the nearest
pose are mixed."""
LITTLE_USE = 0.1
MUCH_USE = 0.5
"""The same for the part of the speed, or of the rest of the way, that a straight step makes use
of."""

# ---- levels of tasks

HALF = 0.5
ENOUGH = 1e-13
BUSY = 2.0
"""Part of what is required that a step of first order may leave; what may be left in any case; and
what earlier levels miss, as a multiple of the square of the step, to count as not arrived."""

# ---- from one cycle to the next

SLOW = 0.0499
"""Part of its speed above which no joint turns back from one cycle to the next."""
SHORTER = 5
"""Halvings of a step so that no joint turns back from one cycle to the next."""
