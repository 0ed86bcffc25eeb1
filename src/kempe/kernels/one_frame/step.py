"""Steps of the inverse kinematics inside the limits."""

from __future__ import annotations

from kempe.kernels.base._jit import device, routine
from kempe.kernels.base.linear import solve_definite_six
from kempe.kernels.base.rotations import turn_quaternion
from kempe.kernels.base.vectors import extract_entry, load4, pack_four
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
    multiply_column,
)


@device
def find_place(chain, v):
    """Return the index in q of velocity coordinate v, -1 if no row reads it."""
    return chain.notes[COLUMN_INTS * chain.columns + PLACE_INTS * v + PLACE]


@device
def is_ball_coordinate(chain, v):
    """Return whether v is one of the three velocity coordinates of a ball."""
    return chain.notes[COLUMN_INTS * chain.columns + PLACE_INTS * v + ROUND] != 0


@device
def is_blocked(chain, v, push):
    """Return whether coordinate v stands at a limit and `push` points outwards."""
    q = chain.q[find_place(chain, v)]
    box = chain.box
    k = BOX_STRIDE * v
    return (push > 0.0 and q >= box[k + HIGH]) or (push < 0.0 and q <= box[k + LOW])


@device
def clip_step(chain, v, step):
    """Return the step of coordinate v, cut off at its limits."""
    q = chain.q[find_place(chain, v)]
    box = chain.box
    k = BOX_STRIDE * v
    return min(max(step, box[k + LOW] - q), box[k + HIGH] - q)


@device
def compute_normal_matrix(jacobian, count, damping):
    """Return the lower triangle (21 numbers, row by row) of J D J^T + damping I, where D picks the
    columns marked FREE.
    """
    r0 = pack_four(damping, 0.0, 0.0, 0.0)
    r1 = pack_four(0.0, damping, 0.0, 0.0)
    r2 = pack_four(0.0, 0.0, damping, 0.0)
    r4 = r5 = pack_four(0.0, 0.0, 0.0, 0.0)
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
        extract_entry(r0, 0),
        extract_entry(r0, 1),
        extract_entry(r1, 1),
        extract_entry(r0, 2),
        extract_entry(r1, 2),
        extract_entry(r2, 2),
        extract_entry(r0, 3),
        extract_entry(r1, 3),
        extract_entry(r2, 3),
        a33,
        extract_entry(r4, 0),
        extract_entry(r4, 1),
        extract_entry(r4, 2),
        extract_entry(r4, 3),
        a44,
        extract_entry(r5, 0),
        extract_entry(r5, 1),
        extract_entry(r5, 2),
        extract_entry(r5, 3),
        a54,
        a55,
    )


@routine
def compute_damped_step(chain, e, damping):
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
        jacobian[k + FREE] = 0.0 if is_blocked(chain, v, multiply_column(jacobian, v, e)) else 1.0
        jacobian[k + STEP] = 0.0
    for _ in range(2):
        y = solve_definite_six(compute_normal_matrix(jacobian, chain.nv, damping), e)
        stopped = False
        for v in range(chain.nv):
            k = JACOBIAN_STRIDE * v
            if jacobian[k + FREE] != 0.0:
                scale = box[BOX_STRIDE * v + SCALE]
                wish = scale * multiply_column(jacobian, v, y)
                step = clip_step(chain, v, wish)
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
def advance_configuration(chain):
    """Move q by the step, cut off at the limits."""
    q = chain.q
    box = chain.box
    jacobian = chain.jacobian
    v = 0
    while v < chain.nv:
        i = find_place(chain, v)
        k = JACOBIAN_STRIDE * v + STEP
        if is_ball_coordinate(chain, v):
            turn_quaternion(
                q, i, jacobian[k], jacobian[k + JACOBIAN_STRIDE], jacobian[k + 2 * JACOBIAN_STRIDE]
            )
            v += 3
            continue
        if i >= 0:
            q[i] = min(
                max(q[i] + jacobian[k], box[BOX_STRIDE * v + LOW]), box[BOX_STRIDE * v + HIGH]
            )
        v += 1
