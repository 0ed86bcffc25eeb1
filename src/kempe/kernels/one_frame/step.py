"""Steps of the inverse kinematics inside the limits."""

from __future__ import annotations

from kempe.kernels.base._jit import device, routine
from kempe.kernels.base.linear import solve6
from kempe.kernels.base.rotations import turn_ball
from kempe.kernels.base.vectors import entry, load4, pack4
from kempe.kernels.one_frame.residual import (
    BOX_STRIDE,
    COLUMN_INTS,
    FREE,
    HIGH,
    JACOBIAN_STRIDE,
    LOW,
    PLACE,
    PLACE_INTS,
    ROUND,
    SCALE,
    STEP,
    along,
)


@device
def place_of(chain, v):
    """Index in q of velocity coordinate v, -1 if no row reads it."""
    return chain.notes[COLUMN_INTS * chain.columns + PLACE_INTS * v + PLACE]


@device
def is_round(chain, v):
    """Whether v is one of the three velocity coordinates of a ball."""
    return chain.notes[COLUMN_INTS * chain.columns + PLACE_INTS * v + ROUND] != 0


@device
def blocked(chain, v, push):
    """Whether coordinate v stands at a limit and `push` points outwards."""
    q = chain.q[place_of(chain, v)]
    box = chain.box
    k = BOX_STRIDE * v
    return (push > 0.0 and q >= box[k + HIGH]) or (push < 0.0 and q <= box[k + LOW])


@device
def within(chain, v, step):
    """The step of coordinate v cut off at its limits."""
    q = chain.q[place_of(chain, v)]
    box = chain.box
    k = BOX_STRIDE * v
    return min(max(step, box[k + LOW] - q), box[k + HIGH] - q)


@device
def normal6(jacobian, count, damping):
    """Lower triangle (21 numbers, row by row) of J D J^T + damping I, D picking the columns marked
    FREE.
    """
    r0 = pack4(damping, 0.0, 0.0, 0.0)
    r1 = pack4(0.0, damping, 0.0, 0.0)
    r2 = pack4(0.0, 0.0, damping, 0.0)
    r4 = r5 = pack4(0.0, 0.0, 0.0, 0.0)
    a33 = a44 = a55 = damping
    a54 = 0.0
    for i in range(count):
        k = JACOBIAN_STRIDE * i
        if jacobian[k + FREE] != 0.0:
            head = load4(jacobian, k)
            c3 = jacobian[k + 3]
            c4 = jacobian[k + 4]
            c5 = jacobian[k + 5]
            r0 = r0 + jacobian[k] * head
            r1 = r1 + jacobian[k + 1] * head
            r2 = r2 + jacobian[k + 2] * head
            r4 = r4 + c4 * head
            r5 = r5 + c5 * head
            a33 = a33 + c3 * c3
            a44 = a44 + c4 * c4
            a54 = a54 + c5 * c4
            a55 = a55 + c5 * c5
    return (
        entry(r0, 0),
        entry(r0, 1),
        entry(r1, 1),
        entry(r0, 2),
        entry(r1, 2),
        entry(r2, 2),
        entry(r0, 3),
        entry(r1, 3),
        entry(r2, 3),
        a33,
        entry(r4, 0),
        entry(r4, 1),
        entry(r4, 2),
        entry(r4, 3),
        a44,
        entry(r5, 0),
        entry(r5, 1),
        entry(r5, 2),
        entry(r5, 3),
        a54,
        a55,
    )


@routine
def damped_step(chain, e, damping):
    """Write the damped least-squares step with an active set of limits.

    Coordinates at a limit that the gradient pushes outwards stay. The others take the step D J^T (J
    D J^T + damping I)^-1 e (Wampler 1986; Nakamura and Hanafusa 1986), D marking them. Those that
    it would carry out of their limits stop there, and the rest takes the step anew with what is
    left of the error.
    """
    jacobian = chain.jacobian
    box = chain.box
    for v in range(chain.nv):
        k = JACOBIAN_STRIDE * v
        jacobian[k + FREE] = 0.0 if blocked(chain, v, along(jacobian, v, e)) else 1.0
        jacobian[k + STEP] = 0.0
    for _ in range(2):
        y = solve6(normal6(jacobian, chain.nv, damping), e)
        stopped = False
        for v in range(chain.nv):
            k = JACOBIAN_STRIDE * v
            if jacobian[k + FREE] != 0.0:
                scale = box[BOX_STRIDE * v + SCALE]
                wish = scale * along(jacobian, v, y)
                step = within(chain, v, wish)
                jacobian[k + STEP] = step
                if step != wish:
                    stopped = True
                    jacobian[k + FREE] = 0.0
                    d = step / scale
                    e = (
                        e[0] - d * jacobian[k],
                        e[1] - d * jacobian[k + 1],
                        e[2] - d * jacobian[k + 2],
                        e[3] - d * jacobian[k + 3],
                        e[4] - d * jacobian[k + 4],
                        e[5] - d * jacobian[k + 5],
                    )
        if not stopped:
            break


@device
def advance(chain):
    """Move q by the step, never out of the limits."""
    q = chain.q
    box = chain.box
    jacobian = chain.jacobian
    v = 0
    while v < chain.nv:
        i = place_of(chain, v)
        k = JACOBIAN_STRIDE * v + STEP
        if is_round(chain, v):
            turn_ball(
                q, i, jacobian[k], jacobian[k + JACOBIAN_STRIDE], jacobian[k + 2 * JACOBIAN_STRIDE]
            )
            v += 3
            continue
        if i >= 0:
            q[i] = min(
                max(q[i] + jacobian[k], box[BOX_STRIDE * v + LOW]), box[BOX_STRIDE * v + HIGH]
            )
        v += 1
