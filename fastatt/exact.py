"""Free motion in closed form, at any times: no steps, and no error that grows but that of |w| t."""

from __future__ import annotations

import ctypes
import functools
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from itertools import product
from typing import Any, NamedTuple

import numpy as np
from llvmlite import ir
from numpy.typing import ArrayLike, DTypeLike, NDArray

from fastatt import checks, rounding
from fastatt.flat import formulas, machine
from fastatt.flat.code import I64, REALS, Code, Int, text_of
from fastatt.flat.finished import Flat
from fastatt.flat.graph import Graph, flattened
from fastatt.flat.llvm import Emitter
from fastatt.flat.rows import (
    Table,
    address_of,
    columns,
    copy,
    kind_of,
    lanes_of,
    without_compiler,
)
from fastatt.inertia import EQUAL, Principal, is_symmetric, principal
from fastatt.threads import each_in_threads, number_of

#: what is done with numbers of a body that are not finite
INVALID = ("raise", "flag")
_TOGETHER = 64  # a few bodies go side by side at so many groups of times
_PIECE = 1 << 20  # attitudes between two looks at Ctrl-C
_STEPS = 1 << 12  # times that share one preparation of their bodies
_SMALL = 1 << 14  # attitudes that are not worth a thread

# what a body is given by, with the numbers of each; axes are those of ``Principal``, if any
_GIVEN = {"q": 4, "w": 3, "moments": 3, "axes": 4}


class _Solution(NamedTuple):
    """A motion: the formula of its constants, and (attitude, w) from them, the moments and t."""

    prepare: Callable[..., Any]
    state: Callable[[Any, Any, Any], tuple[Any, Any]]


def _free(constants: Any, moments: Any, t: Any) -> tuple[Any, Any]:
    q, m = formulas.free_body.evaluate(constants, t)
    return q, tuple(a / b for a, b in zip(m, moments, strict=True))


def _top(constants: Any, moments: Any, t: Any) -> Any:
    return formulas.free_body.symmetric_evaluate(constants, t)


_FREE_BODY = _Solution(formulas.free_body.setup_rate, _free)
_SYMMETRIC_TOP = _Solution(formulas.free_body.symmetric_setup, _top)


class _Traced(NamedTuple):
    """The constants of a body, and attitude and angular velocity at a time."""

    prepare: Flat
    state: Flat


@functools.cache
def _traced(solution: _Solution, kind: str, turned: bool, stored: Any = None) -> _Traced:
    """``turned``: the principal axes are not those of the body; ``stored`` as of ``Motion``."""
    quat = formulas.quat
    graph = Graph()
    q, w, moments, axes = (graph.inputs(kind, name, n) for name, n in _GIVEN.items())
    if turned:
        q, w = quat.mul(q, axes), quat.rotate_inverse(axes, w)
    constants = flattened(solution.prepare(quat.normalise(q), w, moments))
    prepare = Flat(graph, constants, kind)

    graph = Graph()
    moments, axes = (graph.inputs(kind, name, _GIVEN[name]) for name in ("moments", "axes"))
    given = graph.inputs(kind, "constant", len(constants))
    q, w = solution.state(given, moments, graph.input(kind, "t", 0))
    if turned:
        q, w = quat.mul(q, quat.conj(axes)), quat.rotate(axes, w)
    return _Traced(prepare, Flat(graph, [*(stored(q) if stored else q), *w], kind))


@functools.cache
def _compiled(solution: _Solution, kind: str, turned: bool, stored: Any = None) -> Any:
    code = _code(_traced(solution, kind, turned, stored), kind, lanes_of(kind))
    program = machine.compiled(text_of(code.module))
    return program.function("closed_form", ctypes.c_void_p, *[ctypes.c_int64] * 4)


def _code(traced: _Traced, kind: str, lanes: int) -> Code:
    """``closed_form(table, first, last, step_first, step_last)``: blocks of lanes, times of each.

    Lane l is body l mod N at the times from number (l div N) span on: a few bodies at many times
    fill vectors as well as many bodies do. A last block is filled up with the last lane. The table
    holds N, T, span, the number of lanes; address and stride of what a body is given by; address
    of t; address and stride of attitudes and of w.
    """
    code = Code(ir.Module("closed_form"), "closed_form", [I64.as_pointer(), *[I64] * 4])
    argument, first, last, step_first, step_last = code.function.args
    real = REALS[kind]
    entries = Table(code, argument)
    bodies, times, span, total = (entries.number() for _ in range(4))
    given = {name: (entries.pointer(real), entries.number()) for name in _GIVEN}
    t = entries.pointer(real)
    out = [(entries.pointer(real), entries.number()) for _ in range(2)]
    stored = len(traced.state.results) - 3
    used = {name for flat in traced for name, _ in flat.inputs()}

    # columns: what the bodies are given by, their constants, the time; and the results
    names = [(name, i) for name, n in _GIVEN.items() for i in range(n)]
    names += [("constant", i) for i in range(len(traced.prepare.results))] + [("t", 0)]
    at = {name: k * lanes for k, name in enumerate(names)}
    taken = code.room(real, lanes * len(names))
    made = code.room(real, lanes * (stored + 3))
    body, start = code.room(I64, lanes), code.room(I64, lanes)
    emit = Emitter(code, lanes, machine.processor().fuses)

    with code.loop(Int(code, first), Int(code, last)) as block:
        base = block * lanes
        with code.loop(0, lanes) as j:
            lane = (base + j).at_most(total - 1)
            b = lane % bodies
            code.store(body, j, b.value)
            code.store(start, j, (lane // bodies * span).value)
            for name in (name for name in given if name in used):
                pointer, stride = given[name]
                row = code.place(pointer, b * stride)
                copy(code, _GIVEN[name], row, 0, 1, taken, j + at[name, 0], lanes)
        for k, value in enumerate(emit.wide(traced.prepare, columns(code, taken, at, lanes))):
            code.store_vector(taken, at["constant", k], value)
        valid = (total - base).at_most(lanes)
        with code.loop(Int(code, step_first), Int(code, step_last)) as step:
            with code.loop(0, lanes) as j:
                number = (Int(code, code.load(start, j)) + step).at_most(times - 1)
                code.store(taken, j + at["t", 0], code.load(t, number))
            for k, value in enumerate(emit.wide(traced.state, columns(code, taken, at, lanes))):
                code.store_vector(made, k * lanes, value)
            with code.loop(0, valid) as j:
                number = Int(code, code.load(start, j)) + step
                with code.when(number < times):
                    row = number * bodies + Int(code, code.load(body, j))
                    (x, x_stride), (w, w_stride) = out
                    copy(code, stored, made, j, lanes, code.place(x, row * x_stride), 0, 1)
                    first = j + stored * lanes
                    copy(code, 3, made, first, lanes, code.place(w, row * w_stride), 0, 1)
    code.give(0)
    return code


def free_body(
    q0: ArrayLike,
    w0: ArrayLike,
    inertia: ArrayLike,
    t: ArrayLike,
    *,
    allow_unphysical: bool = False,
    dtype: DTypeLike | None = None,
    n_threads: int | None = None,
    invalid: str = "raise",
) -> tuple[NDArray[Any], NDArray[Any]]:
    """Attitude and angular velocity of bodies without torque, at any times, in closed form.

    Errors are at most 1e-15 (1 + |w| t) rad and as much in relation to |w| for principal moments;
    near the separatrix too, where the given numbers are taken as exact.

    Parameters
    ----------
    q0 : (4,) or (N, 4), attitudes at t = 0, body to inertial, scalar first, of any length but zero.
    w0 : (3,) or (N, 3), angular velocities at t = 0, body axes, rad/s.
    inertia : principal moments (3,) or (N, 3) in any order, or tensors (3, 3) or (N, 3, 3), kg·m².
    t : time or times (T,), s, in any order and of either sign.
    allow_unphysical : admit inertia that no body has, of moments above 0.
    dtype : float64 or float32 (errors 1e9 times as large, half the time); None takes float32 when
        ``q0`` and ``w0`` are float32 arrays, else float64.
    n_threads : None takes every processor that this process may use; results do not depend on it.
    invalid : "raise" refuses ``q0`` and ``w0`` that are not finite, and a zero quaternion; "flag"
        gives NaN for such bodies alone.

    Warns
    -----
    StepWarning : where |w| t is so large that half the digits of the precision are lost.

    Returns
    -------
    q, w : (4,), (3,) of one body at one time, (N, 4), (N, 3) of an ensemble; times come first:
        (T, 4), (T, 3) and (T, N, 4), (T, N, 3).

    Raises
    ------
    ValueError, TypeError : an argument that does not fit, by name, with what is accepted.
    """
    given = (q0, w0, inertia, t)
    return _at_times(_FREE_BODY, given, allow_unphysical, dtype, n_threads, invalid)


def symmetric_top(
    q0: ArrayLike,
    w0: ArrayLike,
    inertia: ArrayLike,
    t: ArrayLike,
    *,
    allow_unphysical: bool = False,
    dtype: DTypeLike | None = None,
    n_threads: int | None = None,
    invalid: str = "raise",
) -> tuple[NDArray[Any], NDArray[Any]]:
    """Regular precession of bodies with two equal moments: ``free_body`` with two exponentials.

    q(t) = exp(L t/A)∘q0∘exp(e (1/C − 1/A) m·e t) with L in inertial axes, e the axis of symmetry,
    C the moment about it and A the other two, equal to 1e-12 of the largest (their mean counts).
    Arguments and results are those of :func:`free_body`.

    Raises ``ValueError`` where no two moments are equal, and as ``free_body`` does.
    """
    given = (q0, w0, inertia, t)
    return _at_times(_SYMMETRIC_TOP, given, allow_unphysical, dtype, n_threads, invalid)


def _at_times(
    solution: _Solution,
    given: tuple[ArrayLike, ArrayLike, ArrayLike, ArrayLike],
    allow_unphysical: bool,
    dtype: DTypeLike | None,
    n_threads: int | None,
    invalid: str,
) -> tuple[NDArray[Any], NDArray[Any]]:
    q0, w0, inertia, t = given
    precision = checks.precision(dtype, q0, w0)
    flag = checks.choice("invalid", invalid, INVALID) == "flag"
    start = checks.attitudes("q0", q0, flag=flag)
    rates = (checks.array_any if flag else checks.array)("w0", w0, "(3,) or (N, 3)")
    times = checks.array("t", t, "a number or (T,)")
    threads = number_of(n_threads)
    if start.ndim == rates.ndim == 2 and len(start) != len(rates):
        raise ValueError(f"w0: has {len(rates)} rows; accepted: one, or {len(start)} as of q0")
    one_body = start.ndim == rates.ndim == 1
    n = 1 if one_body else max(len(x) for x in (start, rates) if x.ndim == 2)
    body = principal(inertia, None if one_body else n, allow_unphysical=allow_unphysical)
    if one_body and body.moments.ndim == 2:
        one_body, n = False, len(body.moments)
    check_above_zero(body)
    if solution is _SYMMETRIC_TOP:
        _check_symmetric(body.moments)

    if text := rounding.of_angles(turned(rates, times), precision):
        rounding.warn(f"t: found turns of {text}")
    flat = np.require(times.reshape(-1), precision, ["C", "A"])
    q, w = np.empty((flat.size, n, 4), precision), np.empty((flat.size, n, 3), precision)
    motion = Motion(body, precision, (flat.size, n), solution)
    motion.fill((_rows(start, precision), _rows(rates, precision)), flat, (q, w), threads)
    shape = times.shape if one_body else (*times.shape, n)
    return q.reshape((*shape, 4)), w.reshape((*shape, 3))


def check_above_zero(body: Principal) -> None:
    """Refuse moments of no body for which there is no closed form."""
    if (body.moments < 0.0).any():
        raise ValueError(
            f"inertia: found the principal moment {body.moments.min():.6g}; accepted by the closed "
            "form: above 0, though allow_unphysical lets it pass elsewhere"
        )


class Motion:
    """Free motion of the same bodies from any start, at as many times: laid out once.

    ``stored`` makes what is handed out of quaternions, these themselves unless it is given.
    """

    def __init__(
        self,
        body: Principal,
        kind: np.dtype[Any],
        shape: tuple[int, int],
        solution: _Solution = _FREE_BODY,
        stored: Callable[[Any], Any] | None = None,
    ) -> None:
        size, n = shape
        self._formulas = (solution, kind_of(kind), body.axes is not None, stored)
        self._bodies = {
            name: _rows(x, kind)
            for name, x in (("moments", body.moments), ("axes", body.axes))
            if x is not None
        }
        self._span = -(-size // max(1, min(size, _TOGETHER // n)))
        lanes = n * -(-size // self._span)
        self._blocks, self._small = -(-lanes // lanes_of(self._formulas[1])), size * n <= _SMALL
        self._head = [n, size, self._span, lanes]
        moments, axes = self._bodies["moments"], self._bodies.get("axes", self._bodies["moments"])
        self._last = [number for x in (moments, axes) for number in (address_of(x), _stride(x))]
        self._run: Any = None if without_compiler() else _compiled(*self._formulas)
        #: whether there is no machine code
        self.is_plain = self._run is None

    def fill(
        self,
        start: tuple[NDArray[Any], NDArray[Any]],
        t: NDArray[Any],
        out: tuple[NDArray[Any], NDArray[Any]],
        threads: int,
    ) -> None:
        """Attitudes (T, N, k) and w (T, N, 3), rows with gaps or not, at times (T,).

        All are in the same precision; q and w that bodies start with are (N, k), one row for all,
        or (k,).
        """
        if self.is_plain:
            self._in_python(start, t, out)
            return
        places = [(x.__array_interface__["data"][0], x.strides[1] // x.itemsize) for x in out]
        self.write(start, t, places, threads)

    def write(
        self,
        start: tuple[NDArray[Any], NDArray[Any]],
        t: NDArray[Any],
        places: Sequence[tuple[int, int]],
        threads: int,
    ) -> None:
        """The same in machine code: where rows lie, and how many numbers apart."""
        q, w = start
        entries = [
            *self._head, address_of(q), _stride(q), address_of(w), _stride(w), *self._last,
            address_of(t), *places[0], *places[1],
        ]  # fmt: skip
        table = (ctypes.c_int64 * len(entries))(*entries)
        span, blocks = self._span, self._blocks
        if self._small:
            self._run(table, 0, blocks, 0, span)
            return
        together = max(1, _PIECE // (lanes_of(self._formulas[1]) * min(span, _STEPS)))
        together = max(1, min(together, blocks // threads))
        pieces = product(range(0, blocks, together), range(0, span, _STEPS))
        each_in_threads(
            (
                partial(self._run, table, i, min(i + together, blocks), k, min(k + _STEPS, span))
                for i, k in pieces
            ),
            threads,
        )

    def _in_python(
        self,
        start: tuple[NDArray[Any], NDArray[Any]],
        t: NDArray[Any],
        out: tuple[NDArray[Any], NDArray[Any]],
    ) -> None:
        """Without a compiler, on one thread: a column a number of the formulas."""
        traced = _traced(*self._formulas)
        bodies = {**self._bodies, **dict(zip("qw", map(np.atleast_2d, start), strict=True))}
        given = {(name, i): x[:, i] for name, x in bodies.items() for i in range(x.shape[1])}
        constants = _plain(traced.prepare, given)
        given |= {("constant", i): x for i, x in enumerate(constants)}
        given["t", 0] = t[:, None]
        columns = [x[..., k] for x in out for k in range(x.shape[-1])]
        for column, x in zip(columns, _plain(traced.state, given), strict=True):
            column[...] = x


def _stride(x: NDArray[Any]) -> int:
    """From a body's row to the next, in numbers: none where all share one."""
    return x.shape[-1] if x.ndim == 2 and len(x) > 1 else 0


def _rows(x: NDArray[Any], kind: np.dtype[Any]) -> NDArray[Any]:
    if x.dtype is not kind or not x.flags.carray:
        x = np.require(x, kind, ["C", "A"])
    return x if x.ndim == 2 else np.atleast_2d(x)


def turned(w: NDArray[Any], t: NDArray[Any]) -> NDArray[np.float64]:
    """Largest |w| t of each body, rad."""
    with np.errstate(over="ignore", invalid="ignore"):
        rates = np.asarray(w, dtype=np.float64)
        return np.asarray(np.sqrt((rates * rates) @ np.ones(3)) * np.abs(t).max(initial=0.0))


def _plain(flat: Flat, columns: Mapping[tuple[Any, ...], NDArray[Any]]) -> tuple[Any, ...]:
    from fastatt.flat.source import function

    return function(flat)(*(columns[name] for name in flat.inputs()))


def _check_symmetric(moments: NDArray[np.float64]) -> None:
    symmetric = is_symmetric(moments)
    if not symmetric.all():
        b = int(np.argmin(symmetric))
        where = f"[{b}]" if moments.ndim == 2 else ""
        found = ", ".join(f"{x:.6g}" for x in np.atleast_2d(moments)[b])
        raise ValueError(
            f"inertia{where} is ({found}): no two moments are equal to {EQUAL:g} of the largest; "
            "accepted: a symmetric body, or free_body for any other"
        )
