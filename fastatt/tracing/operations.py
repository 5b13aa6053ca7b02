"""The operations of numbers, and all that is known of each.

Graphs and functions of users name operations alike. A few are of graphs alone (``fma``,
``larger``), others of functions of users alone: these are formulas of a graph's operations
(``sin``, ``//``). What is no operation of numbers, such as a look-up, is in ``nodes.SPECIAL``.
"""

from __future__ import annotations

import functools
import math
import operator
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from fastatt.tracing import graph
from fastatt.tracing.graph import Recorded

Function = Callable[..., Any]
#: the extremes of a result are where arguments are extreme or zero
AT_ENDS = "at ends"
UNBOUNDED = (-math.inf, math.inf)
#: kernels as formulas, by their names; ``tracing.trace``, which needs operations, adds them
KERNELS: dict[str, Function] = {}


class Operation(NamedTuple):
    """An operation of ``arity`` numbers."""

    #: of arrays and known numbers, by IEEE's rules
    array: Any
    #: of numbers of a graph; None if no function of users has it
    traced: Any = None
    arity: int = 1
    #: in machine code: an instruction, a function of LLVM's, or one of the C library (@)
    llvm: str = ""
    #: in Python, if it is no call by its name
    text: str = ""
    #: further functions of ``math`` and NumPy that it is
    others: tuple[Function, ...] = ()
    #: derivatives by its numbers, from these and the result; None where they are 0
    slope: Function | None = None
    #: the smallest and the largest result, or ``AT_ENDS``
    bounds: Any = AT_ENDS
    #: about how many operations of a processor it takes
    cost: int = 1


def own_type_of(x: Any) -> Any:
    """``type(x)``: the precision of a number; for a constant a function that changes nothing."""
    if isinstance(x, Recorded):
        return x.own_type()
    return as_float if isinstance(x, (float, int)) and not isinstance(x, bool) else type(x)


def as_float(x: Any = 0.0) -> Any:
    """``float``, which leaves traced numbers as they are."""
    return x if isinstance(x, Recorded) else float(x)


def _best(better: Function) -> Function:
    """Of numbers as Python's ``min``: the first of equal ones, and the first if one is NaN."""
    one = lambda a, b: graph.choose(better(b, a), b, a)  # noqa: E731
    return lambda *values: functools.reduce(one, values[0] if len(values) == 1 else values)


def _extreme(better: Function) -> Function:
    """The second of two numbers if it is better or NaN."""
    return lambda a, b: graph.choose(graph.either(better(b, a), b != b), b, a)  # noqa: PLR0124


def _ceil(x: Any) -> Any:
    return -graph.apply("floor", -x)


def _trunc(x: Any) -> Any:
    return graph.choose(x < 0.0, _ceil(x), graph.apply("floor", x))


def _sign(x: Any) -> Any:
    return graph.choose(x > 0.0, 1.0, graph.choose(x < 0.0, -1.0, x))


def _fmod(x: Any, y: Any) -> Any:
    rest = graph.divided(abs(x), abs(y))[1]
    return graph.choose(x < 0.0, -rest, rest)


def _remainder(x: Any, y: Any) -> Any:
    """The remainder of x by the nearest multiple of y, the even one of two."""
    size = abs(y)
    rest = x - graph.apply("rint", x / size) * size
    # a quotient may be rounded to the middle between two whole numbers
    rest = graph.choose(rest > 0.5 * size, rest - size, rest)
    return graph.choose(rest < -0.5 * size, rest + size, rest)


def _copysign(x: Any, y: Any) -> Any:
    """The sign of a zero y is ignored, as in all compiled formulas."""
    size = abs(x)
    return graph.choose(y < 0.0, -size, size)


def _other_side(x: Any) -> Any:
    """The other leg of a right triangle with hypotenuse 1, by a product without cancellation."""
    return applied("sqrt", (1.0 - x) * (1.0 + x))


def _sines(x: Any) -> tuple[Any, Any]:
    """(sin x, cos x); NaN if neighbouring numbers are so far apart that no digit remains."""
    most = {"double": 2.0**50, "single": 2.0**21}.get(getattr(x, "precision", ""), math.inf)
    known = graph.both(x < most, x > -most)
    s, c = KERNELS["sincos"](x)
    return graph.choose(known, s, math.nan), graph.choose(known, c, math.nan)


def applied(function: str, x: Any) -> Any:
    """A function of a number; for a known number evaluated by Python."""
    if isinstance(x, Recorded):
        return graph.apply(function, x)
    with np.errstate(all="ignore"):
        return float(OPERATIONS[function].array(x))


#: derivatives by both numbers
_SUM, _DIFFERENCE = (lambda a, b, f: (1.0, 1.0)), (lambda a, b, f: (1.0, -1.0))
_PRODUCT, _QUOTIENT = (lambda a, b, f: (b, a)), (lambda a, b, f: (1.0 / b, -f / b))
#: derivatives by one
_ABS = lambda x, f: graph.choose(x < 0.0, -1.0, 1.0)  # noqa: E731
_COSH, _SINH = (lambda x, f: applied("cosh", x)), (lambda x, f: applied("sinh", x))
_OF_TANH = lambda x, f: (1.0 - f) * (1.0 + f)  # noqa: E731
_applied = functools.partial(functools.partial, graph.apply)

OPERATIONS: dict[str, Operation] = {
    # operators
    "+": Operation(np.add, operator.add, 2, "fadd", "{0} + {1}", slope=_SUM),
    "-": Operation(np.subtract, operator.sub, 2, "fsub", "{0} - {1}", slope=_DIFFERENCE),
    "*": Operation(np.multiply, operator.mul, 2, "fmul", "{0} * {1}", slope=_PRODUCT),
    "/": Operation(np.divide, operator.truediv, 2, "fdiv", "{0} / {1}", slope=_QUOTIENT),
    "//": Operation(np.floor_divide, operator.floordiv, 2, cost=20),
    "%": Operation(np.mod, operator.mod, 2, cost=20),
    "pow": Operation(np.power, operator.pow, 2),
    "neg": Operation(np.negative, operator.neg, 1, "fneg", "-{0}"),
    # comparisons with NaN are false, except "not equal"
    "<": Operation(np.less, operator.lt, 2, "fcmp olt", "{0} < {1}"),
    "<=": Operation(np.less_equal, operator.le, 2, "fcmp ole", "{0} <= {1}"),
    ">": Operation(np.greater, operator.gt, 2, "fcmp ogt", "{0} > {1}"),
    ">=": Operation(np.greater_equal, operator.ge, 2, "fcmp oge", "{0} >= {1}"),
    "==": Operation(np.equal, operator.eq, 2, "fcmp oeq", "{0} == {1}", bounds=(0.0, 1.0)),
    "!=": Operation(np.not_equal, operator.ne, 2, "fcmp une", "{0} != {1}", bounds=(0.0, 1.0)),
    "and": Operation(np.logical_and, None, 2, "and", "{0} & {1}"),
    "or": Operation(np.logical_or, None, 2, "or", "{0} | {1}"),
    "not": Operation(np.logical_not),
    "select": Operation(lambda *x: np.asarray(np.where(*x))[()], graph.choose, 3),
    # of graphs alone
    "fma": Operation(lambda a, b, c: a * b + c, None, 3, "", "{0} * {1} + {2}"),
    "fms": Operation(lambda a, b, c: a * b - c, None, 3, "", "{0} * {1} - {2}"),
    "fnma": Operation(lambda a, b, c: c - a * b, None, 3, "", "{2} - {0} * {1}"),
    "larger": Operation(np.maximum, None, 2),
    "power_of_two": Operation(None),
    "exponent": Operation(None),
    # functions of one number
    "abs": Operation(np.abs, abs, 1, "llvm.fabs", "", (math.fabs, np.fabs), _ABS),
    "sqrt": Operation(np.sqrt, _applied("sqrt"), 1, "llvm.sqrt", slope=lambda x, f: 0.5 / f),
    "rint": Operation(np.rint, _applied("rint"), 1, "llvm.rint", others=(np.round, np.around)),
    "floor": Operation(np.floor, _applied("floor"), 1, "llvm.floor"),
    "ceil": Operation(np.ceil, _ceil),
    "trunc": Operation(np.trunc, _trunc, others=(np.fix,)),
    "sign": Operation(np.sign, _sign),
    "exp": Operation(np.exp, _applied("exp"), 1, "@exp", slope=lambda x, f: f, cost=20),
    "log": Operation(np.log, _applied("log"), 1, "@log", slope=lambda x, f: 1.0 / x, cost=20),
    "log2": Operation(np.log2, lambda x: graph.apply("log", x) * (1.0 / math.log(2.0)), cost=20),
    "log10": Operation(np.log10, lambda x: graph.apply("log", x) * (1.0 / math.log(10.0)), cost=20),
    "sinh": Operation(np.sinh, _applied("sinh"), 1, "@sinh", slope=_COSH, cost=20),
    "cosh": Operation(np.cosh, _applied("cosh"), 1, "@cosh", slope=_SINH, cost=20),
    "tanh": Operation(np.tanh, _applied("tanh"), 1, "@tanh", slope=_OF_TANH, cost=20),
    "sin": Operation(np.sin, lambda x: _sines(x)[0], bounds=(-1.0, 1.0), cost=45),
    "cos": Operation(np.cos, lambda x: _sines(x)[1], bounds=(-1.0, 1.0), cost=45),
    "tan": Operation(
        np.tan, lambda x: operator.truediv(*_sines(x)), 1, "@tan", slope=lambda x, f: 1.0 + f * f,
        bounds=UNBOUNDED, cost=45,
    ),
    "asin": Operation(
        np.arcsin, lambda x: KERNELS["atan2"](x, _other_side(x)), 1, "@asin", "",
        (), lambda x, f: 1.0 / _other_side(x), (-2.0, 2.0), 45,
    ),
    "acos": Operation(
        np.arccos, lambda x: KERNELS["atan2"](_other_side(x), x), 1, "@acos", "",
        (), lambda x, f: -1.0 / _other_side(x), (0.0, math.pi), 45,
    ),
    "atan": Operation(np.arctan, lambda x: KERNELS["atan2"](x, 1.0), cost=45),
    # functions of two numbers
    "atan2": Operation(
        np.arctan2, lambda y, x: KERNELS["atan2"](y, x), 2,
        bounds=(-math.pi, math.pi), cost=45,
    ),
    "hypot": Operation(np.hypot, lambda x, y: graph.apply("sqrt", x * x + y * y), 2),
    "copysign": Operation(np.copysign, _copysign, 2),
    "fmod": Operation(np.fmod, _fmod, 2, cost=20),
    "remainder": Operation(
        lambda x, y: x - np.rint(x / y) * y, _remainder, 2, bounds=UNBOUNDED
    ),
    "min": Operation(lambda a, b: np.where(b < a, b, a), _best(operator.lt), 2),
    "max": Operation(lambda a, b: np.where(b > a, b, a), _best(operator.gt), 2),
    "minimum": Operation(np.minimum, _extreme(operator.lt), 2),
    "maximum": Operation(np.maximum, _extreme(operator.gt), 2),
}  # fmt: skip
#: operations that the C library computes
LIBRARY = tuple(op for op, x in OPERATIONS.items() if x.llvm.startswith("@"))
#: what functions of ``math`` and NumPy are; a name alone has two meanings (``remainder``)
FUNCTIONS: dict[Any, str] = {
    function: op for op, x in OPERATIONS.items()
    for function in (getattr(math, op, None), x.array, *x.others) if callable(function)
}  # fmt: skip
