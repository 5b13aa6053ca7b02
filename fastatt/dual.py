"""Dual numbers for compiled code: a value and its derivatives along a few directions.

A kernel, a method's step or a user's rate or torque that is compiled for ``Dual`` computes its
derivatives along with its value, by the same formula: forward differentiation (Griewank and
Walther, *Evaluating Derivatives*, 2008, ch. 3), exact but for rounding. Constants written
``type(x)(0.5)`` stay plain numbers and cost nothing. Comparisons look at values; the derivative of
a number that is selected away is never used; that of a number that is not finite means nothing.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.core.imputils import lower_builtin, lower_cast
from numba.core.typeconv import Conversion
from numba.core.typing.templates import (
    AbstractTemplate,
    AttributeTemplate,
    infer_getattr,
    infer_global,
    signature,
)
from numba.extending import intrinsic, models, register_model

# a derivative that is 0 then drops out of sums and products
_FLAGS = ("nnan", "ninf", "nsz", "contract")


class Dual(types.Type):
    """A float of type ``dtype`` and ``size`` derivatives."""

    def __init__(self, dtype: types.Float, size: int) -> None:
        self.dtype, self.size = dtype, size
        super().__init__(name=f"Dual({dtype}, {size})")

    def unify(self, typingctx: Any, other: types.Type) -> Dual | None:
        """The type of a variable that is either: a number counts as constant."""
        return self if isinstance(other, types.Number) else None

    def can_convert_from(self, typingctx: Any, other: types.Type) -> Any:
        """Whether a number of another type may stand for one of this."""
        return Conversion.safe if isinstance(other, types.Number) else None


class DualClass(types.Callable):
    """``type(x)`` of a dual number: makes plain numbers of its precision."""

    def __init__(self, instance: Dual) -> None:
        self.instance = instance
        super().__init__(name=f"class({instance})")

    def get_call_type(self, context: Any, args: Any, kws: Any) -> Any:
        """Signature of a cast."""
        given = types.unliteral(args[0])
        return signature(given if isinstance(given, Dual) else self.instance.dtype, given)

    def get_call_signatures(self) -> Any:
        """None known beforehand."""
        return (), False

    def get_impl_key(self, sig: Any) -> type:
        """What the lowering is registered for."""
        return DualClass


@register_model(Dual)
class _DualModel(models.PrimitiveModel):
    """{value, derivatives}: the derivatives one vector, so that LLVM sees one sum, not ``size``."""

    def __init__(self, dmm: Any, fe_type: Dual) -> None:
        number = dmm.lookup(fe_type.dtype).get_value_type()
        pair = ir.LiteralStructType([number, ir.VectorType(number, fe_type.size)])
        super().__init__(dmm, fe_type, pair)


register_model(DualClass)(models.OpaqueModel)


@infer_getattr
class _DualAttributes(AttributeTemplate):
    key = Dual

    def resolve___class__(self, ty: Dual) -> DualClass:
        return DualClass(ty)


class _Emitter:
    """LLVM instructions on the parts of dual numbers: a value, and a vector or, if plain, None."""

    def __init__(self, context: Any, builder: Any, ty: Dual) -> None:
        self.context, self.builder, self.ty = context, builder, ty
        self.vector = context.get_value_type(ty).elements[1]

    def parts(self, value: Any, ty: Any) -> tuple[Any, Any]:
        """(value, derivatives)."""
        if not isinstance(ty, Dual):
            return value, None
        return self.builder.extract_value(value, 0), self.builder.extract_value(value, 1)

    def make(self, value: Any, derivatives: Any) -> Any:
        out = ir.Constant(self.context.get_value_type(self.ty), ir.Undefined)
        out = self.builder.insert_value(out, value, 0)
        return self.builder.insert_value(out, derivatives, 1)

    def constants(self, numbers: list[float]) -> Any:
        return ir.Constant(self.vector, numbers)

    def scaled(self, k: Any, derivatives: Any) -> Any:
        if derivatives is None:
            return None
        index = ir.IntType(32)
        first = self.builder.insert_element(
            ir.Constant(self.vector, ir.Undefined), k, ir.Constant(index, 0)
        )
        spread = self.builder.shuffle_vector(
            first, first, ir.Constant(ir.VectorType(index, self.ty.size), None)
        )
        return self.builder.fmul(spread, derivatives, flags=_FLAGS)

    def sum(self, a: Any, b: Any) -> Any:
        if a is None or b is None:
            return b if a is None else a
        return self.builder.fadd(a, b, flags=_FLAGS)

    def negated(self, a: Any) -> Any:
        return None if a is None else self.builder.fneg(a, flags=_FLAGS)


def _is_operand(ty: Any) -> bool:
    return isinstance(ty, (Dual, types.Number))


def _define(function: Any, n: int, emit: Callable[..., Any], result: Any = None) -> None:
    """``function`` of n numbers of which one at least is dual; ``result``: its type, else dual."""

    class Template(AbstractTemplate):
        key = function

        def generic(self, args: Any, kws: Any) -> Any:
            found = {a for a in args if isinstance(a, Dual)}
            if len(args) != n or len(found) != 1 or not all(map(_is_operand, args)):
                return None
            (dual,) = found
            given = (a if isinstance(a, Dual) else dual.dtype for a in args)
            return signature(dual if result is None else result(dual), *given)

    infer_global(function)(Template)

    def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        dual = next(a for a in sig.args if isinstance(a, Dual))
        e = _Emitter(context, builder, dual)
        return emit(e, *(e.parts(x, ty) for x, ty in zip(args, sig.args, strict=True)))

    kinds = [(Dual,)] if n == 1 else [(Dual, Dual), (Dual, types.Float), (types.Float, Dual)]
    for kind in kinds:
        lower_builtin(function, *kind)(lower)


def _add(e: Any, a: Any, b: Any) -> Any:
    return e.make(e.builder.fadd(a[0], b[0]), e.sum(a[1], b[1]))


def _sub(e: Any, a: Any, b: Any) -> Any:
    return e.make(e.builder.fsub(a[0], b[0]), e.sum(a[1], e.negated(b[1])))


def _mul(e: Any, a: Any, b: Any) -> Any:
    return e.make(e.builder.fmul(a[0], b[0]), e.sum(e.scaled(b[0], a[1]), e.scaled(a[0], b[1])))


def _div(e: Any, a: Any, b: Any) -> Any:
    value = e.builder.fdiv(a[0], b[0])
    inverse = e.builder.fdiv(ir.Constant(value.type, 1.0), b[0], flags=_FLAGS)
    return e.make(value, e.scaled(inverse, e.sum(a[1], e.negated(e.scaled(value, b[1])))))


def _neg(e: Any, a: Any) -> Any:
    return e.make(e.builder.fneg(a[0]), e.negated(a[1]))


def _pos(e: Any, a: Any) -> Any:
    return e.make(*a)


def _abs(e: Any, a: Any) -> Any:
    below = e.builder.fcmp_ordered("<", a[0], ir.Constant(a[0].type, 0.0))
    value = e.builder.select(below, e.builder.fneg(a[0]), a[0])
    return e.make(value, e.builder.select(below, e.negated(a[1]), a[1]))


for _function, _n, _emit in (
    (operator.add, 2, _add),
    (operator.sub, 2, _sub),
    (operator.mul, 2, _mul),
    (operator.truediv, 2, _div),
    (operator.iadd, 2, _add),
    (operator.isub, 2, _sub),
    (operator.imul, 2, _mul),
    (operator.itruediv, 2, _div),
    (operator.neg, 1, _neg),
    (operator.pos, 1, _pos),
    (abs, 1, _abs),
):
    _define(_function, _n, _emit)


def _comparison(function: Any, symbol: str) -> None:
    def emit(e: Any, a: Any, b: Any) -> Any:
        compare = e.builder.fcmp_unordered if symbol == "!=" else e.builder.fcmp_ordered
        return compare(symbol, a[0], b[0])

    _define(function, 2, emit, lambda dual: types.boolean)


for _function, _symbol in (
    (operator.lt, "<"),
    (operator.le, "<="),
    (operator.gt, ">"),
    (operator.ge, ">="),
    (operator.eq, "=="),
    (operator.ne, "!="),
):
    _comparison(_function, _symbol)


def _call(e: Any, function: Any, *values: Any) -> Any:
    """What Numba has for ``function`` of plain numbers."""
    dtype = e.ty.dtype
    sig = e.context.typing_context.resolve_function_type(function, (dtype,) * len(values), {})
    fn = e.context.get_function(e.context.typing_context.resolve_value_type(function), sig)
    return fn(e.builder, values)


def _elementary(function: Any, slope: Callable[..., Any] | None) -> None:
    """A function of one number; ``slope(e, x, f(x))``: its derivative, None: 0."""

    def emit(e: Any, a: Any) -> Any:
        value = _call(e, function, a[0])
        return value if slope is None else e.make(value, e.scaled(slope(e, a[0], value), a[1]))

    _define(function, 1, emit, None if slope else lambda dual: dual.dtype)


def _over(e: Any, numerator: float, denominator: Any) -> Any:
    return e.builder.fdiv(ir.Constant(denominator.type, numerator), denominator, flags=_FLAGS)


def _one_and(e: Any, sign: float, x: Any) -> Any:
    """1 ± x²."""
    square = e.builder.fmul(x, e.builder.fmul(ir.Constant(x.type, sign), x))
    return e.builder.fadd(ir.Constant(x.type, 1.0), square)


# function: its derivative from x and f(x)
_SLOPES: dict[str, Callable[..., Any]] = {
    "sqrt": lambda e, x, f: _over(e, 0.5, f),
    "sin": lambda e, x, f: _call(e, math.cos, x),
    "cos": lambda e, x, f: e.builder.fneg(_call(e, math.sin, x)),
    "tan": lambda e, x, f: _one_and(e, 1.0, f),
    "atan": lambda e, x, f: _over(e, 1.0, _one_and(e, 1.0, x)),
    "exp": lambda e, x, f: f,
    "log": lambda e, x, f: _over(e, 1.0, x),
    "tanh": lambda e, x, f: _one_and(e, -1.0, f),
}
for _name, _slope in _SLOPES.items():
    _elementary(getattr(math, _name), _slope)
    _elementary(getattr(np, "arctan" if _name == "atan" else _name), _slope)
_elementary(np.rint, None)
_elementary(np.floor, None)


def _pick(symbol: str) -> Callable[..., Any]:
    def emit(e: Any, a: Any, b: Any) -> Any:
        first = e.builder.fcmp_ordered(symbol, a[0], b[0])
        zero = e.constants([0.0] * e.ty.size)
        da, db = (zero if d is None else d for d in (a[1], b[1]))
        return e.make(e.builder.select(first, a[0], b[0]), e.builder.select(first, da, db))

    return emit


def _power(e: Any, a: Any, b: Any) -> Any:
    value = _call(e, operator.pow, a[0], b[0])
    less = e.builder.fsub(b[0], ir.Constant(b[0].type, 1.0))
    slope = e.builder.fmul(b[0], _call(e, operator.pow, a[0], less))
    # of a plain exponent the logarithm is not asked for: the base may be negative
    growth = None if b[1] is None else e.builder.fmul(value, _call(e, math.log, a[0]))
    return e.make(value, e.sum(e.scaled(slope, a[1]), e.scaled(growth, b[1])))


def _angle(e: Any, y: Any, x: Any) -> Any:
    square = e.builder.fadd(e.builder.fmul(x[0], x[0]), e.builder.fmul(y[0], y[0]))
    turned = e.sum(e.scaled(x[0], y[1]), e.negated(e.scaled(y[0], x[1])))
    return e.make(_call(e, math.atan2, y[0], x[0]), e.scaled(_over(e, 1.0, square), turned))


_define(min, 2, _pick("<"))
_define(max, 2, _pick(">"))
_define(math.atan2, 2, _angle)
_define(operator.pow, 2, _power)


@lower_builtin(DualClass, types.Any)
def _cast(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    return context.cast(builder, args[0], sig.args[0], sig.return_type)


@lower_cast(types.Number, Dual)
def _number_to_dual(context: Any, builder: Any, fromty: Any, toty: Any, value: Any) -> Any:
    plain = context.cast(builder, value, fromty, toty.dtype)
    e = _Emitter(context, builder, toty)
    return e.make(plain, e.constants([0.0] * toty.size))


@intrinsic(prefer_literal=True)
def seed(typingctx: Any, values: Any, size: Any, first: Any, mask: Any) -> Any:
    """A tuple of numbers as dual ones of ``size`` directions: 1 along ``first`` and on.

    Numbers whose bit in ``mask`` is 0 stay plain and take no direction; −1 means all. All but
    ``values`` are literals.
    """
    ty = Dual(values.dtype, size.literal_value)
    start, wanted = first.literal_value, mask.literal_value
    kinds = [ty if wanted >> k & 1 else values.dtype for k in range(values.count)]

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        e = _Emitter(context, builder, ty)
        numbers = []
        direction = start
        for k, kind in enumerate(kinds):
            number = builder.extract_value(args[0], k)
            if kind is ty:
                units = [float(i == direction) for i in range(ty.size)]
                number = e.make(number, e.constants(units))
                direction += 1
            numbers.append(number)
        return context.make_tuple(builder, sig.return_type, numbers)

    made = types.Tuple(kinds)
    return signature(made, values, size, first, mask), codegen


@intrinsic
def constant(typingctx: Any, x: Any, like: Any) -> Any:
    """x as a dual number of the type of ``like``; of a plain x all derivatives are 0."""

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return context.cast(builder, args[0], x, like)

    return signature(like, x, like), codegen


@intrinsic
def value(typingctx: Any, x: Any) -> Any:
    """The value of a number, dual or plain."""

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return builder.extract_value(args[0], 0) if isinstance(x, Dual) else args[0]

    return signature(x.dtype if isinstance(x, Dual) else x, x), codegen


@intrinsic
def derivatives(typingctx: Any, x: Any) -> Any:
    """The derivatives of a dual number."""

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        _, vector = _Emitter(context, builder, x).parts(args[0], x)
        places = (ir.Constant(ir.IntType(32), i) for i in range(x.size))
        found = [builder.extract_element(vector, place) for place in places]
        return context.make_tuple(builder, sig.return_type, found)

    return signature(types.UniTuple(x.dtype, x.size), x), codegen
