"""Closed forms of motions: which one bodies have, traced, compiled and run at many times."""

from __future__ import annotations

import ctypes
import functools
import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from itertools import product
from typing import Any, NamedTuple

import numpy as np
from llvmlite import ir
from numpy.typing import NDArray

from fastatt import checks, torques
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
from fastatt.inertia import Principal, about_arm
from fastatt.scene import Scene
from fastatt.threads import each_in_threads

_SIDE_BY_SIDE = 2  # vectors: while one waits for a root or a quotient the other goes on
_TOGETHER = 64  # a few bodies go side by side at so many groups of times
_PIECE = 1 << 20  # attitudes between two looks at Ctrl-C
_STEPS = 1 << 12  # times that share one preparation of their bodies
_SMALL = 1 << 14  # attitudes that are not worth a thread

# what a body is given by, with the numbers of each; axes are those of ``Principal``, if any
_GIVEN = {"q": 4, "w": 3, "moments": 3, "axes": 4, "pull": 3}


class Solution(NamedTuple):
    """A motion: the formula of its constants, and (attitude, w) from them, the moments and t.

    Constants are of (q, w, moments), or with the ``pull`` last.
    """

    prepare: Callable[..., Any]
    state: Callable[[Any, Any, Any], tuple[Any, Any]]
    pulled: bool = False


def _free(constants: Any, moments: Any, t: Any) -> tuple[Any, Any]:
    q, m = formulas.free_body.evaluate(constants, t)
    return q, tuple(a / b for a, b in zip(m, moments, strict=True))


def _symmetric(constants: Any, moments: Any, t: Any) -> Any:
    return formulas.free_body.symmetric_evaluate(constants, t)


def _top(constants: Any, moments: Any, t: Any) -> Any:
    return formulas.heavy_top.evaluate(constants, t)


FREE_BODY = Solution(formulas.free_body.setup_rate, _free)
SYMMETRIC_TOP = Solution(formulas.free_body.symmetric_setup, _symmetric)
_HEAVY_TOP = Solution(formulas.heavy_top.setup, _top, pulled=True)


class Form(NamedTuple):
    """The closed form of bodies: which, of what bodies, and what pulls at their third axes, N·m.

    ``pull`` is (3,) or (N, 3), along inertial axes; ``gain``, rad/s, of each body or of all, is
    what the square root of the sum of squares of |w| and it never exceeds in |w|.
    """

    solution: Solution
    body: Principal
    pull: NDArray[np.float64] | None = None
    gain: NDArray[np.float64] = np.zeros(())


#: torques that have a closed form, by name
LEVERS = tuple(m.__name__ for m, record in torques.RECORDS.items() if record.lever is not None)
_Lever = tuple[NDArray[np.float64], NDArray[np.float64]]


def heavy_top_form(body: Principal, lever: _Lever) -> Form:
    """The closed form of bodies with a lever, as of ``torques.lever_of``.

    Raises ``ValueError`` for a body whose arm is not along an axis of symmetry, by its number.
    """
    arm, pull = lever
    found, reach = about_arm(body, arm)
    check_above_zero(found)
    pull = reach[..., None] * pull
    # A |w|² is at most what it was and 4 |pull|
    gain = 2.0 * np.sqrt(np.linalg.norm(pull, axis=-1) / found.moments[..., 0])
    return Form(_HEAVY_TOP, found, pull, gain)


def form_of(scene: Scene) -> Form:
    """The closed form of a scene's motion.

    Raises ``ValueError`` where there is none, with the body or the torque that has none.
    """
    known = scene.memo.get("closed form")
    if known is None:
        try:
            known = _form_of(scene)
        except ValueError as reason:
            known = str(reason)
        scene.memo["closed form"] = known
    if isinstance(known, str):
        raise ValueError(known)  # noqa: TRY004
    assert isinstance(known, Form)
    return known


def _form_of(scene: Scene) -> Form:
    if scene.torque is None:
        check_above_zero(scene.principal)
        return Form(FREE_BODY, scene.principal)
    lever = torques.lever_of(scene.torque)
    if lever is None:
        raise ValueError(
            f"torque: found {checks.brief(scene.torque)}; accepted by the closed form: none, or "
            f"{' or '.join(LEVERS)} of numbers"
        )
    return heavy_top_form(scene.principal, lever)


def check_above_zero(body: Principal) -> None:
    """Refuse moments of no body for which there is no closed form."""
    if (body.moments < 0.0).any():
        raise ValueError(
            f"inertia: found the principal moment {body.moments.min():.6g}; accepted by the closed "
            "form: above 0, though allow_unphysical lets it pass elsewhere"
        )


class _Traced(NamedTuple):
    """The constants of a body, and attitude and angular velocity at a time."""

    prepare: Flat
    state: Flat


@functools.cache
def _traced(
    solution: Solution, kind: str, turned: bool, stored: Any = None, *, native: bool = False
) -> _Traced:
    """``turned``: the principal axes are not those of the body; ``stored`` as of ``Motion``."""
    quat = formulas.quat
    graph = Graph(native=native)
    q, w, moments, axes, pull = (graph.inputs(kind, name, n) for name, n in _GIVEN.items())
    if turned:
        q, w = quat.mul(q, axes), quat.rotate_inverse(axes, w)
    pulls = (pull,) if solution.pulled else ()
    constants = flattened(solution.prepare(quat.normalise(q), w, moments, *pulls))
    prepare = Flat(graph, constants, kind)

    graph = Graph(native=native)
    moments, axes = (graph.inputs(kind, name, _GIVEN[name]) for name in ("moments", "axes"))
    given = graph.inputs(kind, "constant", len(constants))
    q, w = solution.state(given, moments, graph.input(kind, "t", 0))
    if turned:
        q, w = quat.mul(q, quat.conj(axes)), quat.rotate(axes, w)
    return _Traced(prepare, Flat(graph, [*(stored(q) if stored else q), *w], kind))


@functools.cache
def _compiled(solution: Solution, kind: str, turned: bool, stored: Any = None) -> Any:
    traced = _traced(solution, kind, turned, stored, native=machine.processor().fuses)
    code = _code(traced, kind, _SIDE_BY_SIDE * lanes_of(kind))
    program = machine.compiled(text_of(code.module))
    return program.function("closed_form", ctypes.c_void_p, *[ctypes.c_int64] * 4)


def _code(traced: _Traced, kind: str, lanes: int) -> Code:
    """``closed_form(table, first, last, step_first, step_last)``: blocks of lanes, times of each.

    Lane l is body l mod N at the times from number (l div N) span on: a few bodies at many times
    fill vectors as well as many bodies do. A last block is filled up with the last lane. The table
    holds N, T, span, the number of lanes; address and stride of what a body is given by; address
    of t; address and stride of attitudes and of w; a |w|² (double); and what becomes 1 where a body
    starts with more, or what is made of it is not finite.
    """
    code = Code(ir.Module("closed_form"), "closed_form", [I64.as_pointer(), *[I64] * 4])
    argument, first, last, step_first, step_last = code.function.args
    real = REALS[kind]
    entries = Table(code, argument)
    bodies, times, span, total = (entries.number() for _ in range(4))
    given = {name: (entries.pointer(real), entries.number()) for name in _GIVEN}
    t = entries.pointer(real)
    out = [(entries.pointer(real), entries.number()) for _ in range(2)]
    noted = _Noted(code, kind, lanes, entries.number())
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
        _number_lanes(base, lanes, (bodies, span, total), (body, start))
        for name in (name for name in given if name in used):
            pointer, stride = given[name]
            # what all have in common stays
            anew = code.b.or_(stride > 0, block.equals(Int(code, first)))
            with code.when(anew), code.loop(0, lanes) as j:
                row = code.place(pointer, Int(code, code.load(body, j)) * stride)
                copy(code, _GIVEN[name], row, 0, 1, taken, j + at[name, 0], lanes)
        noted.start([code.vector(taken, at["w", i], lanes) for i in range(3)])
        for k, value in enumerate(emit.wide(traced.prepare, columns(code, taken, at, lanes))):
            code.store_vector(taken, at["constant", k], value)
        valid = (total - base).at_most(lanes)
        with code.loop(Int(code, step_first), Int(code, step_last)) as step:
            with code.loop(0, lanes) as j:
                number = (Int(code, code.load(start, j)) + step).at_most(times - 1)
                code.store(taken, j + at["t", 0], code.load(t, number))
            values = emit.wide(traced.state, columns(code, taken, at, lanes))
            noted.results(values)
            for k, value in enumerate(values):
                code.store_vector(made, k * lanes, value)
            with code.loop(0, valid) as j:
                number = Int(code, code.load(start, j)) + step
                with code.when(number < times):
                    row = number * bodies + Int(code, code.load(body, j))
                    (x, x_stride), (w, w_stride) = out
                    copy(code, stored, made, j, lanes, code.place(x, row * x_stride), 0, 1)
                    first = j + stored * lanes
                    copy(code, 3, made, first, lanes, code.place(w, row * w_stride), 0, 1)
    noted.told(argument, entries.taken)
    code.give(0)
    return code


def _number_lanes(base: Int, lanes: int, of: tuple[Int, Int, Int], into: tuple[Any, Any]) -> None:
    """The body of each lane from number ``base`` on, and the number of its first time."""
    code, (bodies, span, total), (body, start) = base.code, of, into
    inner, group = base % bodies, base // bodies * span
    inside = inner + lanes <= bodies
    with code.when(inside), code.loop(0, lanes) as j:
        code.store(body, j, (inner + j).value)
        code.store(start, j, group.value)
    with code.when(code.b.not_(inside)), code.loop(0, lanes) as j:
        lane = (base + j).at_most(total - 1)
        code.store(body, j, (lane % bodies).value)
        code.store(start, j, (lane // bodies * span).value)


class _Noted:
    """Whether a body starts with |w|² above a double of these bits, or its results are no numbers.

    What is added up of lanes is 0 as long as there is nothing of this.
    """

    def __init__(self, code: Code, kind: str, lanes: int, bits: Int) -> None:
        self._code, self._lanes, real = code, lanes, REALS[kind]
        most = code.b.bitcast(bits.value, REALS["double"])
        self._most = code.splat(most if kind == "double" else code.b.fptrunc(most, real), lanes)
        self._zero, self._infinite = (
            code.splat(code.real(kind, x), lanes) for x in (0.0, math.inf)
        )
        self._sum = code.room(real, lanes)
        code.store_vector(self._sum, 0, self._zero)

    def start(self, w: Sequence[Any]) -> None:
        """Note angular velocities."""
        code = self._code
        x, y, z = (code.of("fmul", c, c) for c in w)
        square = code.of("fadd", code.of("fadd", x, y), z)
        past = code.b.fcmp_ordered(">", square, self._most)
        self.results([code.b.select(past, self._infinite, self._zero)])

    def results(self, values: Sequence[Any]) -> None:
        """Note numbers that should be finite."""
        code = self._code
        found = code.vector(self._sum, 0, self._lanes)
        for value in values:
            found = code.of("fadd", found, code.of("fmul", value, self._zero))
        code.store_vector(self._sum, 0, found)

    def told(self, pointer: Any, index: int) -> None:
        """Make a whole number in memory 1 if there was anything."""
        code = self._code
        with code.loop(0, self._lanes) as j:
            one = code.load(self._sum, j)
            with code.when(code.b.fcmp_unordered("uno", one, one)):
                code.store(pointer, index, code.raw(1))


class Motion:
    """Motion of the same bodies from any start, at as many times: laid out once.

    ``stored`` makes what is handed out of quaternions, these themselves unless it is given.
    """

    def __init__(
        self,
        form: Form,
        kind: np.dtype[Any],
        shape: tuple[int, int],
        stored: Callable[[Any], Any] | None = None,
    ) -> None:
        size, n = shape
        moments, axes = form.body
        self._formulas = (form.solution, kind_of(kind), axes is not None, stored)
        given = {"moments": moments, "axes": axes, "pull": form.pull}
        self._bodies = {name: rows(x, kind) for name, x in given.items() if x is not None}
        self._span = -(-size // max(1, min(size, _TOGETHER // n)))
        lanes = n * -(-size // self._span)
        self._lanes = _SIDE_BY_SIDE * lanes_of(self._formulas[1])
        self._blocks, self._small = -(-lanes // self._lanes), size * n <= _SMALL
        self._head = [n, size, self._span, lanes]
        ordered = [self._bodies.get(name, self._bodies["moments"]) for name in given]
        self._last = [number for x in ordered for number in (address_of(x), _stride(x))]
        # the numbers of q and w, of t, of the results and of what is noted come with each call
        self._table = ctypes.c_int64 * (len(self._head) + len(self._last) + 4 + 1 + 4 + 2)
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
        most: int = 0,
    ) -> bool:
        """The same in machine code: where rows lie, and how many numbers apart.

        Gives whether results are not finite, or a body begins with |w|² above the double of whose
        bits ``most`` is the number.
        """
        q, w = start
        table = self._table()
        table[:] = [
            *self._head, address_of(q), _stride(q), address_of(w), _stride(w), *self._last,
            address_of(t), *places[0], *places[1], most, 0,
        ]  # fmt: skip
        span, blocks = self._span, self._blocks
        if self._small:
            self._run(table, 0, blocks, 0, span)
            return bool(table[-1])
        together = max(1, _PIECE // (self._lanes * min(span, _STEPS)))
        together = max(1, min(together, blocks // threads))
        pieces = product(range(0, blocks, together), range(0, span, _STEPS))
        each_in_threads(
            (
                partial(self._run, table, i, min(i + together, blocks), k, min(k + _STEPS, span))
                for i, k in pieces
            ),
            threads,
        )
        return bool(table[-1])

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


def rows(x: NDArray[Any], kind: np.dtype[Any]) -> NDArray[Any]:
    """Numbers of bodies as ``Motion`` takes them."""
    if x.dtype is not kind or not x.flags.carray:
        x = np.require(x, kind, ["C", "A"])
    return x if x.ndim == 2 else np.atleast_2d(x)


def turned(w: NDArray[Any], t: NDArray[Any], gain: NDArray[np.float64]) -> NDArray[np.float64]:
    """Largest |w| t of each body, rad; ``gain`` as of a ``Form``."""
    with np.errstate(over="ignore", invalid="ignore"):
        rates = np.asarray(w, dtype=np.float64)
        squares = (rates * rates) @ np.ones(3) + gain * gain
        return np.asarray(np.sqrt(squares) * np.abs(t).max(initial=0.0))


def _plain(flat: Flat, columns: Mapping[tuple[Any, ...], NDArray[Any]]) -> tuple[Any, ...]:
    from fastatt.flat.source import function

    return function(flat)(*(columns[name] for name in flat.inputs()))
