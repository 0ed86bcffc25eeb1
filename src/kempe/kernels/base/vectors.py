"""Short vectors of float64 as a type of compiled code: `Vec`, its operators, loads, stores and
shuffles.

LLVM's loop vectoriser gives up on most loops over two-dimensional arrays, and straight-line code
stays scalar. Here a kernel says outright what is one vector: four columns of a matrix row (`load4`,
`pack_four`) or `LANES` configurations side by side (`load_lanes`, `gather_lanes`). Formulas written
with + -
* / abs and `select_where` hold for plain floats too, so that none is written twice. Loads and
  stores take
the pointer that `get_pointer` makes of a C-contiguous array, and a flat index: arrays handed on
cost reference counting in loops, pointers nothing. Nothing checks bounds.
"""

from __future__ import annotations

import operator
from typing import Any

import llvmlite.binding
from llvmlite import ir
from numba import types
from numba.core import cgutils, config
from numba.core.typing.templates import AbstractTemplate, signature
from numba.core.typing.templates import infer_global as _infer_global
from numba.extending import intrinsic as _intrinsic
from numba.extending import lower_builtin as _lower_builtin
from numba.extending import models, register_model

# a type checker would count the typing context as an argument, and sees no values of settings
intrinsic: Any = _intrinsic
infer_global: Any = _infer_global
lower_builtin: Any = _lower_builtin
settings: Any = config

DOUBLE = ir.DoubleType()
INT64 = ir.IntType(64)
SIGN_BIT = -(2**63)


def _count_lanes() -> int:
    """Return how many configurations are swept side by side: eight with 512-bit registers, else
    four.
    """
    if (
        settings.CPU_NAME or settings.CPU_FEATURES
    ):  # the user compiles for another processor than this
        wide = "+avx512f" in (settings.CPU_FEATURES or "")
    else:
        wide = llvmlite.binding.get_host_cpu_features().get("avx512f", False)
    return 8 if wide else 4


LANES = _count_lanes()
"""Width of the vectors that hold one number of several configurations."""


class _Register(types.Type):
    """`width` numbers or truth values in a register."""

    entry: ir.Type

    def __init__(self, width: int):
        self.width = width
        super().__init__(f"{type(self).__name__}({width})")


class Vec(_Register):
    """`width` numbers of type float64."""

    entry = DOUBLE


class Mask(_Register):
    """`width` truth values, as comparisons of `Vec` give them."""

    entry = ir.IntType(1)


class _VectorModel(models.PrimitiveModel):
    def __init__(self, dmm, fe_type):
        super().__init__(dmm, fe_type, ir.VectorType(fe_type.entry, fe_type.width))


register_model(Vec)(_VectorModel)  # pyright: ignore
register_model(Mask)(_VectorModel)  # pyright: ignore


def _pack_vector(builder, values):
    """Emit the vector with these entries."""
    vector = ir.Constant(ir.VectorType(DOUBLE, len(values)), ir.Undefined)
    for i, value in enumerate(values):
        vector = builder.insert_element(vector, value, ir.Constant(ir.IntType(32), i))
    return vector


def _spread_value(builder, value, width: int):
    """Emit the vector whose entries are all `value`."""
    one = _pack_vector(builder, [value])
    return _shuffle_entries(builder, one, one, [0] * width)


def _shuffle_entries(builder, a, b, order: list[int]):
    """Emit the entries `order` of the vectors a and b laid end to end."""
    return builder.shuffle_vector(
        a, b, ir.Constant(ir.VectorType(ir.IntType(32), len(order)), order)
    )


def _call_llvm(builder, name: str, value):
    """Emit a call of LLVM's function `name` for a number or vector."""
    lanes = f"v{value.type.count}" if isinstance(value.type, ir.VectorType) else ""
    call = ir.FunctionType(value.type, [value.type])
    return builder.call(
        cgutils.get_or_insert_function(builder.module, call, f"llvm.{name}.{lanes}f64"), [value]
    )


def _convert_to_vector(context, builder, value, its_type, width: int):
    """Emit `value` as a vector: a vector stays as it is, a number is repeated in all entries."""
    if isinstance(its_type, Vec):
        return value
    return _spread_value(builder, context.cast(builder, value, its_type, types.float64), width)


def _declare_binary(operation, emit, result) -> None:
    """Declare the operator for two vectors, and for a vector and a number in either order."""

    @infer_global(operation)
    class _Template(AbstractTemplate):
        def generic(self, args, kws):
            if len(args) == 2 and not kws and any(isinstance(a, Vec) for a in args):
                width = next(a.width for a in args if isinstance(a, Vec))
                if all(
                    a == Vec(width) if isinstance(a, Vec) else isinstance(a, types.Number)
                    for a in args
                ):
                    return signature(result(width), *args)
            return None

    def lower_operation(context, builder, sig, args):
        width = next(a.width for a in sig.args if isinstance(a, Vec))
        a, b = (
            _convert_to_vector(context, builder, v, t, width)
            for v, t in zip(args, sig.args, strict=True)
        )
        return emit(builder, a, b)

    for pair in ((Vec, Vec), (Vec, types.Number), (types.Number, Vec)):
        lower_builtin(operation, *pair)(lower_operation)


def _declare_unary(operation, emit) -> None:
    """Declare the operator for a vector."""

    @infer_global(operation)
    class _Template(AbstractTemplate):
        def generic(self, args, kws):
            if len(args) == 1 and isinstance(args[0], Vec):
                return signature(args[0], args[0])
            return None

    lower_builtin(operation, Vec)(lambda context, builder, sig, args: emit(builder, args[0]))


_declare_binary(operator.add, lambda builder, a, b: builder.fadd(a, b), Vec)
_declare_binary(operator.sub, lambda builder, a, b: builder.fsub(a, b), Vec)
_declare_binary(operator.mul, lambda builder, a, b: builder.fmul(a, b), Vec)
_declare_binary(operator.truediv, lambda builder, a, b: builder.fdiv(a, b), Vec)
_declare_binary(operator.gt, lambda builder, a, b: builder.fcmp_ordered(">", a, b), Mask)
_declare_binary(operator.eq, lambda builder, a, b: builder.fcmp_ordered("==", a, b), Mask)
_declare_unary(operator.neg, lambda builder, a: builder.fneg(a))
_declare_unary(abs, lambda builder, a: _call_llvm(builder, "fabs", a))


FLOATS = types.CPointer(types.float64)


@intrinsic
def get_pointer(typingctx, array):
    """Return the pointer to the first entry of a C-contiguous array; p[k] is entry k of the
    flattened array.

    The pointer does not keep the array alive: a scratch array must be named again after its last
    use: `keep_alive`.
    """
    if not (isinstance(array, types.Array) and array.layout == "C"):
        return None

    def emit_code(context, builder, sig, args):
        return context.make_array(sig.args[0])(context, builder, args[0]).data

    return types.CPointer(array.dtype)(array), emit_code


@intrinsic
def keep_alive(typingctx, array):
    """Keep the memory of the array allocated until this call."""

    def emit_code(context, builder, sig, args):
        return context.get_dummy_value()

    return types.void(array), emit_code


def _make_loader(width: int):
    """Make the function that reads `width` consecutive numbers as a vector."""

    @intrinsic
    def load_vector(typingctx, pointer, index):
        def emit_code(context, builder, sig, args):
            place = builder.gep(args[0], [args[1]])
            vector = ir.VectorType(DOUBLE, width)
            return builder.load(builder.bitcast(place, vector.as_pointer()), align=8)

        return Vec(width)(FLOATS, types.int64), emit_code

    return load_vector


load4 = _make_loader(4)
"""load4(p, k): the vector p[k : k + 4]."""
load_lanes = _make_loader(LANES)
"""load_lanes(p, k): the vector p[k : k + LANES]."""


@intrinsic
def store_value(typingctx, pointer, index, value):
    """Write a number, or the entries of a vector, to p[k] and the places after it."""
    if not (value == types.float64 or isinstance(value, Vec)):
        return None

    def emit_code(context, builder, sig, args):
        place = builder.gep(args[0], [args[1]])
        builder.store(args[2], builder.bitcast(place, args[2].type.as_pointer()), align=8)
        return context.get_dummy_value()

    return types.void(FLOATS, types.int64, value), emit_code


@intrinsic
def gather_lanes(typingctx, pointer, index, stride):
    """Read the vector of the numbers p[k], p[k + stride], p[k + 2 stride], ..."""

    def emit_code(context, builder, sig, args):
        places = [builder.gep(args[0], [args[1]])]
        for _ in range(LANES - 1):
            places.append(builder.gep(places[-1], [args[2]]))
        return _pack_vector(builder, [builder.load(place) for place in places])

    return Vec(LANES)(FLOATS, types.int64, types.int64), emit_code


@intrinsic
def store_columns(typingctx, pointer, index, stride, a, b, c, d):
    """Write (a, b, c, d) of lane l to p[k + l stride : k + l stride + 4]: a transposition in
    registers.
    """
    if any(v != Vec(LANES) for v in (a, b, c, d)):
        return None

    def emit_code(context, builder, sig, args):
        a, b, c, d = args[3:]
        even = [i + j for i in range(0, LANES, 2) for j in (0, LANES)]
        odd = [i + 1 for i in even]
        pairs = [
            (_shuffle_entries(builder, a, b, o), _shuffle_entries(builder, c, d, o))
            for o in (even, odd)
        ]
        place = builder.gep(args[0], [args[1]])
        vector = ir.VectorType(DOUBLE, 4).as_pointer()
        for lane in range(LANES):
            ab, cd = pairs[lane % 2]
            # lanes l and l + 2 leave one 512-bit shuffle together, the halves are stored apart
            first = lane // 4 * 4
            order = [i for k in (first, first + 2) for i in (k, k + 1, LANES + k, LANES + k + 1)]
            both = _shuffle_entries(builder, ab, cd, order)
            half = _shuffle_entries(
                builder, both, both, [0, 1, 2, 3] if lane % 4 < 2 else [4, 5, 6, 7]
            )
            builder.store(half, builder.bitcast(place, vector), align=8)
            place = builder.gep(place, [args[2]])
        return context.get_dummy_value()

    return types.void(FLOATS, types.int64, types.int64, a, b, c, d), emit_code


@intrinsic
def spread_lanes(typingctx, value):
    """Return the vector whose LANES entries are all `value`."""

    def emit_code(context, builder, sig, args):
        return _spread_value(builder, args[0], LANES)

    return Vec(LANES)(types.float64), emit_code


@intrinsic
def pack_four(typingctx, a, b, c, d):
    """Return the vector with the entries a, b, c, d."""

    def emit_code(context, builder, sig, args):
        return _pack_vector(builder, args)

    return Vec(4)(*[types.float64] * 4), emit_code


def _make_shuffler(order: list[int]):
    """Make the function that picks four entries of a vector of four, or zeros (4 to 7)."""

    @intrinsic
    def shuffle_row(typingctx, row):
        def emit_code(context, builder, sig, args):
            return _shuffle_entries(builder, args[0], ir.Constant(args[0].type, [0.0] * 4), order)

        return Vec(4)(Vec(4)), emit_code

    return shuffle_row


last_of = _make_shuffler([4, 5, 6, 3])
"""last_of(row): the vector (0, 0, 0, row[3])."""
swapped = _make_shuffler([1, 0, 2, 3])
"""swapped(row): the vector (row[1], row[0], row[2], row[3])."""


@intrinsic
def extract_entry(typingctx, vector, index):
    """Return entry `index` of a vector as a number."""

    def emit_code(context, builder, sig, args):
        return builder.extract_element(args[0], args[1])

    return types.float64(vector, types.int64), emit_code


@intrinsic
def compute_square_root(typingctx, value):
    """Return the square root of a number, or of each entry of a vector."""
    kind = value if isinstance(value, Vec) else types.float64

    def emit_code(context, builder, sig, args):
        return _call_llvm(builder, "sqrt", args[0])

    return kind(kind), emit_code


@intrinsic
def are_all_between(typingctx, low, value, high):
    """Return whether low <= value <= high in every lane (False with NaN in a lane); low and high
    are numbers.
    """
    if not isinstance(value, Vec):
        return None

    def emit_code(context, builder, sig, args):
        low, value, high = args
        width = sig.args[1].width
        above = builder.fcmp_ordered(">=", value, _spread_value(builder, low, width))
        below = builder.fcmp_ordered("<=", value, _spread_value(builder, high, width))
        bits = builder.bitcast(builder.and_(above, below), ir.IntType(width))
        return builder.icmp_unsigned("==", bits, ir.Constant(ir.IntType(width), -1))

    return types.boolean(types.float64, value, types.float64), emit_code


@intrinsic
def expect_false(typingctx, condition):
    """Return the condition, and tell the compiler that it is nearly always false."""

    def emit_code(context, builder, sig, args):
        bit = ir.IntType(1)
        expect = cgutils.get_or_insert_function(
            builder.module, ir.FunctionType(bit, [bit, bit]), "llvm.expect.i1"
        )
        return builder.call(expect, [args[0], ir.Constant(bit, 0)])

    return types.boolean(types.boolean), emit_code


@intrinsic
def select_where(typingctx, condition, yes, no):
    """Return `yes` where the condition holds, else `no`, without a branch; for numbers or vectors."""
    widths = [v.width for v in (condition, yes, no) if isinstance(v, (Vec, Mask))]
    result = Vec(widths[0]) if widths else types.float64

    def emit_code(context, builder, sig, args):
        yes, no = args[1:]
        if widths:
            yes, no = (
                _convert_to_vector(context, builder, v, t, widths[0])
                for v, t in zip(args[1:], sig.args[1:], strict=True)
            )
        return builder.select(args[0], yes, no)

    pair = [v if isinstance(v, Vec) else types.float64 for v in (yes, no)]
    return result(condition, *pair), emit_code


def _cast_to_integer(builder, value):
    """Emit the bits of a number or a vector as integers."""
    if isinstance(value.type, ir.VectorType):
        integer = ir.VectorType(INT64, value.type.count)
        return builder.bitcast(value, integer), lambda k: ir.Constant(
            integer, [k] * value.type.count
        )
    return builder.bitcast(value, INT64), lambda k: ir.Constant(INT64, k)


@intrinsic
def is_negative(typingctx, x):
    """Return whether the sign bit is set: True for -0.0."""
    result = Mask(x.width) if isinstance(x, Vec) else types.boolean

    def emit_code(context, builder, sig, args):
        bits, constant = _cast_to_integer(builder, args[0])
        return builder.icmp_signed("<", bits, constant(0))

    return result(x if isinstance(x, Vec) else types.float64), emit_code


@intrinsic
def copy_sign(typingctx, size, x):
    """Return `size`, which is not negative, with the sign of x."""
    kind = x if isinstance(x, Vec) else types.float64

    def emit_code(context, builder, sig, args):
        bits, constant = _cast_to_integer(builder, args[1])
        size, _ = _cast_to_integer(builder, args[0])
        signed = builder.or_(size, builder.and_(bits, constant(SIGN_BIT)))
        return builder.bitcast(signed, args[0].type)

    return kind(kind, kind), emit_code
