"""Short vectors of float64 as a type of compiled code: `Vec`, its operators, loads, stores and shuffles.

LLVM's loop vectoriser gives up on most loops over two-dimensional arrays, and Numba leaves straight-line code scalar.
Here a kernel says outright what is one vector: four columns of a matrix row (`load4`, `pack4`) or `LANES`
configurations side by side (`load_lanes`, `gather`). LLVM splits vectors that are wider than the machine's.
Formulas written with + - * / abs and `where` hold for plain floats too, so that none is written twice.
Loads and stores take the pointer that `raw` makes of a C-contiguous array, and a flat index: arrays that are handed
from function to function cost reference counting in loops, pointers nothing. Nothing checks bounds.
"""

from __future__ import annotations

import operator

import llvmlite.binding
from llvmlite import ir
from numba import types
from numba.core import cgutils, config
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import intrinsic, lower_builtin, models, register_model

DOUBLE = ir.DoubleType()
INT64 = ir.IntType(64)
SIGN_BIT = -(2**63)


def _lanes() -> int:
    """Configurations swept side by side: eight with 512-bit registers, else four."""
    if config.CPU_NAME or config.CPU_FEATURES:  # the user compiles for another processor than this
        wide = "+avx512f" in (config.CPU_FEATURES or "")
    else:
        wide = llvmlite.binding.get_host_cpu_features().get("avx512f", False)
    return 8 if wide else 4


LANES = _lanes()
"""Width of the vectors that hold one number of several configurations."""


class Vec(types.Type):
    """`width` numbers of type float64 in a register."""

    def __init__(self, width: int):
        self.width = width
        super().__init__(name=f"Vec({width})")


class Mask(types.Type):
    """`width` truth values, as comparisons of `Vec` give them."""

    def __init__(self, width: int):
        self.width = width
        super().__init__(name=f"Mask({width})")


@register_model(Vec)
class _VecModel(models.PrimitiveModel):
    def __init__(self, dmm, fe_type):
        super().__init__(dmm, fe_type, ir.VectorType(DOUBLE, fe_type.width))


@register_model(Mask)
class _MaskModel(models.PrimitiveModel):
    def __init__(self, dmm, fe_type):
        super().__init__(dmm, fe_type, ir.VectorType(ir.IntType(1), fe_type.width))


def _splat(builder, value, width: int):
    """The vector whose entries are all `value`."""
    vector = ir.VectorType(DOUBLE, width)
    one = builder.insert_element(ir.Constant(vector, ir.Undefined), value, ir.Constant(ir.IntType(32), 0))
    return _shuffle(builder, one, one, [0] * width)


def _shuffle(builder, a, b, order: list[int]):
    """Entries `order` of a and b laid end to end."""
    return builder.shuffle_vector(a, b, ir.Constant(ir.VectorType(ir.IntType(32), len(order)), order))


def _llvm(builder, name: str, its_type, args):
    """Call LLVM's own function `name` of vectors."""
    vector = args[0].type
    call = ir.FunctionType(vector, [vector] * len(args))
    function = cgutils.get_or_insert_function(builder.module, call, f"llvm.{name}.v{its_type.width}f64")
    return builder.call(function, args)


def _like(context, builder, value, its_type, width: int):
    """`value` as a vector: vectors stay, numbers are spread."""
    if isinstance(its_type, Vec):
        return value
    return _splat(builder, context.cast(builder, value, its_type, types.float64), width)


def _binary(operation, emit, result) -> None:
    """Declare `operation` for (Vec, Vec), (Vec, number) and (number, Vec)."""

    @infer_global(operation)
    class _Template(AbstractTemplate):
        def generic(self, args, kws):
            if len(args) == 2 and not kws and any(isinstance(a, Vec) for a in args):
                width = next(a.width for a in args if isinstance(a, Vec))
                if all(a == Vec(width) if isinstance(a, Vec) else isinstance(a, types.Number) for a in args):
                    return signature(result(width), *args)
            return None

    def lower(context, builder, sig, args):
        width = next(a.width for a in sig.args if isinstance(a, Vec))
        a, b = (_like(context, builder, v, t, width) for v, t in zip(args, sig.args, strict=True))
        return emit(builder, a, b)

    for pair in ((Vec, Vec), (Vec, types.Number), (types.Number, Vec)):
        lower_builtin(operation, *pair)(lower)


def _comparison(sign: str):
    """Emitter of an ordered comparison."""
    return lambda builder, a, b: builder.fcmp_ordered(sign, a, b)


for _operation, _emit in (
    (operator.add, lambda builder, a, b: builder.fadd(a, b)),
    (operator.sub, lambda builder, a, b: builder.fsub(a, b)),
    (operator.mul, lambda builder, a, b: builder.fmul(a, b)),
    (operator.truediv, lambda builder, a, b: builder.fdiv(a, b)),
):
    _binary(_operation, _emit, Vec)
for _operation, _sign in ((operator.lt, "<"), (operator.gt, ">"), (operator.le, "<="), (operator.eq, "==")):
    _binary(_operation, _comparison(_sign), Mask)


def _unary(operation) -> None:
    @infer_global(operation)
    class _Template(AbstractTemplate):
        def generic(self, args, kws):
            if len(args) == 1 and isinstance(args[0], Vec):
                return signature(args[0], args[0])
            return None


_unary(operator.neg)
_unary(abs)


@lower_builtin(operator.neg, Vec)
def _neg(context, builder, sig, args):
    return builder.fneg(args[0])


@lower_builtin(abs, Vec)
def _abs(context, builder, sig, args):
    return _llvm(builder, "fabs", sig.args[0], args)


FLOATS = types.CPointer(types.float64)


@intrinsic
def raw(typingctx, array):
    """Pointer to the first entry of a C-contiguous array; p[k] is entry k of the flattened array.

    The pointer does not keep the array alive: a scratch array must be named again after its last use (`keep`).
    """
    if not (isinstance(array, types.Array) and array.layout == "C"):
        return None

    def codegen(context, builder, sig, args):
        return context.make_array(sig.args[0])(context, builder, args[0]).data

    return types.CPointer(array.dtype)(array), codegen


@intrinsic
def keep(typingctx, array):
    """Nothing; but the array lives until here."""

    def codegen(context, builder, sig, args):
        return context.get_dummy_value()

    return types.void(array), codegen


def _loader(width: int):
    """Intrinsic that reads `width` consecutive numbers."""

    @intrinsic
    def load(typingctx, pointer, index):
        def codegen(context, builder, sig, args):
            place = builder.gep(args[0], [args[1]])
            vector = ir.VectorType(DOUBLE, width)
            return builder.load(builder.bitcast(place, vector.as_pointer()), align=8)

        return Vec(width)(FLOATS, types.int64), codegen

    return load


load4 = _loader(4)
"""load4(p, k): the vector p[k : k + 4]."""
load_lanes = _loader(LANES)
"""load_lanes(p, k): the vector p[k : k + LANES]."""


@intrinsic
def store(typingctx, pointer, index, value):
    """Write a number or a vector from p[k] on."""
    if not (value == types.float64 or isinstance(value, Vec)):
        return None

    def codegen(context, builder, sig, args):
        place = builder.gep(args[0], [args[1]])
        builder.store(args[2], builder.bitcast(place, args[2].type.as_pointer()), align=8)
        return context.get_dummy_value()

    return types.void(FLOATS, types.int64, value), codegen


@intrinsic
def gather(typingctx, pointer, index, stride):
    """The lanes p[k], p[k + stride], p[k + 2 stride], …"""

    def codegen(context, builder, sig, args):
        vector = ir.Constant(ir.VectorType(DOUBLE, LANES), ir.Undefined)
        place = builder.gep(args[0], [args[1]])
        for lane in range(LANES):
            value = builder.load(place)
            vector = builder.insert_element(vector, value, ir.Constant(ir.IntType(32), lane))
            place = builder.gep(place, [args[2]])
        return vector

    return Vec(LANES)(FLOATS, types.int64, types.int64), codegen


@intrinsic
def store_columns(typingctx, pointer, index, stride, a, b, c, d):
    """Write (a, b, c, d) of lane l to p[k + l stride : k + l stride + 4]: a transposition in registers."""
    if any(v != Vec(LANES) for v in (a, b, c, d)):
        return None

    def codegen(context, builder, sig, args):
        a, b, c, d = args[3:]
        even = [i + j for i in range(0, LANES, 2) for j in (0, LANES)]
        odd = [i + 1 for i in even]
        pairs = [(_shuffle(builder, a, b, o), _shuffle(builder, c, d, o)) for o in (even, odd)]
        place = builder.gep(args[0], [args[1]])
        vector = ir.VectorType(DOUBLE, 4).as_pointer()
        for lane in range(LANES):
            ab, cd = pairs[lane % 2]
            # lanes l and l + 2 leave one 512-bit shuffle together, the halves are stored apart
            first = lane // 4 * 4
            both = [i for k in (first, first + 2) for i in (k, k + 1, LANES + k, LANES + k + 1)]
            both = _shuffle(builder, ab, cd, both)
            half = _shuffle(builder, both, both, [0, 1, 2, 3] if lane % 4 < 2 else [4, 5, 6, 7])
            builder.store(half, builder.bitcast(place, vector), align=8)
            place = builder.gep(place, [args[2]])
        return context.get_dummy_value()

    return types.void(FLOATS, types.int64, types.int64, a, b, c, d), codegen


def _spread(width: int):
    """Intrinsic that makes a vector of equal entries."""

    @intrinsic
    def spread(typingctx, value):
        def codegen(context, builder, sig, args):
            return _splat(builder, args[0], width)

        return Vec(width)(types.float64), codegen

    return spread


spread_lanes = _spread(LANES)
"""spread_lanes(x): the vector of LANES entries x."""


@intrinsic
def pack4(typingctx, a, b, c, d):
    """The vector (a, b, c, d)."""

    def codegen(context, builder, sig, args):
        vector = ir.Constant(ir.VectorType(DOUBLE, 4), ir.Undefined)
        for i, value in enumerate(args):
            vector = builder.insert_element(vector, value, ir.Constant(ir.IntType(32), i))
        return vector

    return Vec(4)(*[types.float64] * 4), codegen


@intrinsic
def last_of(typingctx, row):
    """The vector (0, 0, 0, row[3])."""
    if row != Vec(4):
        return None

    def codegen(context, builder, sig, args):
        zero = ir.Constant(args[0].type, [0.0] * 4)
        return _shuffle(builder, zero, args[0], [0, 1, 2, 7])

    return Vec(4)(row), codegen


@intrinsic
def swapped(typingctx, row):
    """The vector (row[1], row[0], row[2], row[3])."""
    if row != Vec(4):
        return None

    def codegen(context, builder, sig, args):
        return _shuffle(builder, args[0], args[0], [1, 0, 2, 3])

    return Vec(4)(row), codegen


@intrinsic
def entry(typingctx, vector, index):
    """Entry `index` of a vector as a number."""
    if not isinstance(vector, Vec):
        return None

    def codegen(context, builder, sig, args):
        return builder.extract_element(args[0], args[1])

    return types.float64(vector, types.int64), codegen


@intrinsic
def square_root(typingctx, vector):
    """The square roots of a vector's entries."""
    if not isinstance(vector, Vec):
        return None

    def codegen(context, builder, sig, args):
        return _llvm(builder, "sqrt", sig.args[0], args)

    return vector(vector), codegen


@intrinsic
def all_between(typingctx, low, value, high):
    """Whether low <= value <= high in every lane (False with NaN in one); low and high are numbers."""
    if not isinstance(value, Vec):
        return None

    def codegen(context, builder, sig, args):
        low, value, high = args
        width = sig.args[1].width
        above = builder.fcmp_ordered(">=", value, _splat(builder, low, width))
        below = builder.fcmp_ordered("<=", value, _splat(builder, high, width))
        bits = builder.bitcast(builder.and_(above, below), ir.IntType(width))
        return builder.icmp_unsigned("==", bits, ir.Constant(ir.IntType(width), -1))

    return types.boolean(types.float64, value, types.float64), codegen


@intrinsic
def rarely(typingctx, condition):
    """The condition itself, with word to the compiler that it is nearly always false."""

    def codegen(context, builder, sig, args):
        bit = ir.IntType(1)
        expect = cgutils.get_or_insert_function(
            builder.module, ir.FunctionType(bit, [bit, bit]), "llvm.expect.i1"
        )
        return builder.call(expect, [args[0], ir.Constant(bit, 0)])

    return types.boolean(types.boolean), codegen


@intrinsic
def where(typingctx, condition, yes, no):
    """`yes` where the condition holds, else `no`: a selection, never a branch. Numbers, or vectors and their mask."""
    widths = [v.width for v in (condition, yes, no) if isinstance(v, (Vec, Mask))]
    result = Vec(widths[0]) if widths else types.float64

    def codegen(context, builder, sig, args):
        yes, no = args[1:]
        if widths:
            yes, no = (_like(context, builder, v, t, widths[0]) for v, t in zip(args[1:], sig.args[1:], strict=True))
        return builder.select(args[0], yes, no)

    pair = [v if isinstance(v, Vec) else types.float64 for v in (yes, no)]
    return result(condition, *pair), codegen


def _as_integer(builder, value):
    """The bits of a number or a vector."""
    if isinstance(value.type, ir.VectorType):
        integer = ir.VectorType(INT64, value.type.count)
        return builder.bitcast(value, integer), lambda k: ir.Constant(integer, [k] * value.type.count)
    return builder.bitcast(value, INT64), lambda k: ir.Constant(INT64, k)


@intrinsic
def negative(typingctx, x):
    """Whether the sign bit is set: true for -0.0."""
    result = Mask(x.width) if isinstance(x, Vec) else types.boolean

    def codegen(context, builder, sig, args):
        bits, constant = _as_integer(builder, args[0])
        return builder.icmp_signed("<", bits, constant(0))

    return result(x if isinstance(x, Vec) else types.float64), codegen


@intrinsic
def with_sign_of(typingctx, size, x):
    """`size`, which is not negative, with the sign bit of x."""
    kind = x if isinstance(x, Vec) else types.float64

    def codegen(context, builder, sig, args):
        bits, constant = _as_integer(builder, args[1])
        size, _ = _as_integer(builder, args[0])
        signed = builder.or_(size, builder.and_(bits, constant(SIGN_BIT)))
        return builder.bitcast(signed, args[0].type)

    return kind(kind, kind), codegen
