"""Closed forms of motions: which one a scene has, its compiled formulas, and their evaluation."""

from __future__ import annotations

import functools
from array import array
from collections.abc import Callable, Mapping
from functools import partial
from itertools import accumulate, product
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fastatt import checks, rounding
from fastatt._jit import address_loop
from fastatt.attitudes import QUATERNION, Attitude
from fastatt.codegen.call import call_generated, reals, wholes
from fastatt.codegen.lanes import LaneFormula, Memory, Place, Shape, lane_function
from fastatt.codegen.memory import address_of
from fastatt.codegen.processor import processor
from fastatt.codegen.rows import kind_of, without_compiler
from fastatt.engine.run import Results
from fastatt.engine.status import Status
from fastatt.propagation.initial import Given
from fastatt.scene import torques
from fastatt.scene.inertia import Principal, about_arm
from fastatt.scene.scene import Scene
from fastatt.scene.torque_record import Torque
from fastatt.threads import each_in_threads
from fastatt.tracing import formulas
from fastatt.tracing.finished import Flat
from fastatt.tracing.graph import Graph, flattened

if TYPE_CHECKING:
    from fastatt.propagation.plan import Plan

_SIDE_BY_SIDE = 2  # vectors computed together, to hide the latency of roots and quotients
_TOGETHER = 64  # groups of times over which the lanes of a few bodies are spread
_PIECE = 1 << 20  # attitudes between two checks for Ctrl-C
_STEPS = 1 << 12  # times for which the constants of bodies are computed once
_SMALL = 1 << 14  # attitudes below which one thread is fastest

# inputs of a body, with their sizes; axes are those of ``Principal``, if there are any
_GIVEN = {"q": 4, "w": 3, "moments": 3, "axes": 4, "pull": 3}


class Solution(NamedTuple):
    """The solution of a motion in two formulas.

    ``prepare`` computes constants from (q, w, moments), and from the ``pull`` too if ``pulled``;
    ``state`` computes the attitude and w from the constants, the moments and t.
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


class BodySolution(NamedTuple):
    """The closed form of given bodies.

    ``pull`` is the moment of the weight about the fixed point, N·m, which acts on the third axes,
    (3,) or (N, 3) along inertial axes. ``gain``, rad/s, bounds the growth of ``|w|``: the square
    root of ``|w|²`` + ``gain²`` at the start is never exceeded.
    """

    solution: Solution
    body: Principal
    pull: NDArray[np.float64] | None = None
    gain: NDArray[np.float64] = np.zeros(())


#: names of the torques for which there is a closed form
LEVERS = tuple(m.__name__ for m in Torque.__subclasses__() if m.lever is not None)
_Lever = tuple[NDArray[np.float64], NDArray[np.float64]]


def heavy_top_form(body: Principal, lever: _Lever) -> BodySolution:
    """The closed form of bodies with the lever that ``torques.lever_of`` found.

    Raises ``ValueError`` for a body whose arm is not along an axis of symmetry, with its index.
    """
    arm, pull = lever
    found, reach = about_arm(body, arm)
    check_above_zero(found)
    pull = reach[..., None] * pull
    # A |w|² grows by 4 |pull| at most
    gain = 2.0 * np.sqrt(np.linalg.norm(pull, axis=-1) / found.moments[..., 0])
    return BodySolution(_HEAVY_TOP, found, pull, gain)


def form_of(scene: Scene) -> BodySolution:
    """The closed form of a scene's motion.

    Raises ``ValueError``, with the body or the torque, if there is none.
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
    assert isinstance(known, BodySolution)
    return known


def _form_of(scene: Scene) -> BodySolution:
    if scene.torque is None:
        check_above_zero(scene.principal)
        return BodySolution(FREE_BODY, scene.principal)
    lever = torques.lever_of(scene.torque)
    if lever is None:
        raise ValueError(
            f"torque: found {checks.brief(scene.torque)}; accepted by the closed form: none, or "
            f"{' or '.join(LEVERS)} of numbers"
        )
    return heavy_top_form(scene.principal, lever)


def check_above_zero(body: Principal) -> None:
    """Refuse moments of zero, for which there is no closed form."""
    if (body.moments < 0.0).any():
        raise ValueError(
            f"inertia: found the principal moment {body.moments.min():.6g}; accepted by the closed "
            "form: above 0, though allow_unphysical lets it pass elsewhere"
        )


@functools.cache
def _traced(
    solution: Solution, kind: str, turned: bool, stored: Any = None, *, native: bool = False
) -> tuple[Flat, Flat]:
    """The graphs of a body's constants, and of attitude and angular velocity at a time.

    ``turned`` says that the principal axes are not the body axes; ``stored`` as in ``Evaluation``.
    """
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
    return prepare, Flat(graph, [*(stored(q) if stored else q), *w], kind)


#: the formulas; the first of the rows of their inputs, of the time, of what is not zero where a
#: result was not finite, and of the results; constants follow
PREPARE, STATE = range(2)
_FIRST = dict(zip(_GIVEN, accumulate(_GIVEN.values(), initial=0), strict=False))
TIME = sum(_GIVEN.values())
FINITE, RESULTS = TIME + 1, TIME + 2
#: the table of a loop: address of the function, of the times, of attitudes and w; the numbers from
#: row to row of both; bodies, times, the times of a lane, and lanes in all. Address and stride of
#: each input follow
ENTRY, T, Q_OUT, W_OUT, Q_STRIDE, W_STRIDE, BODIES, TIMES, SPAN, TOTAL, INPUTS = range(11)


def _run_closed_form(kind: str, lanes: int, stored: int) -> Callable[..., int]:
    finite, time, first = (x * lanes for x in (FINITE, TIME, RESULTS))
    row_of = (*_FIRST.values(), TIME)

    def run_closed_form(
        numbers: int, memory: int, places: int,
        first_block: int, last_block: int, first_step: int, last_step: int,
    ) -> int:  # fmt: skip
        """Evaluate blocks of lanes at the times of each, given the address of the table.

        Lane l is body l mod N at the times from number (l div N) span on, so that a few bodies at
        many times fill vectors as well as many bodies do. A last block is filled with copies of the
        last lane, and times beyond the last one repeat it. ``memory`` is the address of the rows,
        and ``places`` that of 2 blocks of indices. Returns 1 if a result is not finite.
        """
        table = wholes(numbers)
        entry, bodies, times = table[ENTRY], table[BODIES], table[TIMES]
        span, total = table[SPAN], table[TOTAL]
        rows, place, t = reals(memory, kind), wholes(places), reals(table[T], kind)
        q_out, w_out = reals(table[Q_OUT], kind), reals(table[W_OUT], kind)
        q_stride, w_stride = table[Q_STRIDE], table[W_STRIDE]
        for j in range(lanes):
            rows[finite + j] = 0.0
        for block in range(first_block, last_block):
            base = block * lanes
            body, group = base % bodies, base // bodies
            for j in range(lanes):
                place[j], place[lanes + j] = body, group * span
                if base + j + 1 < total:
                    body += 1
                    if body == bodies:
                        body, group = 0, group + 1
            for i in range(5):
                source, stride = reals(table[INPUTS + 2 * i], kind), table[INPUTS + 2 * i + 1]
                # inputs that all bodies share are not loaded again
                if stride > 0 or block == first_block:
                    to = row_of[i] * lanes
                    for j in range(lanes):
                        at = place[j] * stride
                        for k in range(3):
                            rows[to + k * lanes + j] = source[at + k]
                    if row_of[i + 1] - row_of[i] == 4:
                        for j in range(lanes):
                            rows[to + 3 * lanes + j] = source[place[j] * stride + 3]
            call_generated(entry, PREPARE, (rows, place), (lanes,))
            for j in range(lanes):
                rows[time + j] = t[min(place[lanes + j] + first_step, times - 1)]
            for step in range(first_step, last_step):
                call_generated(entry, STATE, (rows, place), (lanes,))
                # the next times; they are stored well before they are loaded as vectors
                for j in range(lanes):
                    rows[time + j] = t[min(place[lanes + j] + step + 1, times - 1)]
                for j in range(lanes):
                    row = min(place[lanes + j] + step, times - 1) * bodies + place[j]
                    for k in range(stored):
                        q_out[row * q_stride + k] = rows[first + k * lanes + j]
                    for k in range(3):
                        w_out[row * w_stride + k] = rows[first + (stored + k) * lanes + j]
        for j in range(lanes):
            if rows[finite + j] != 0.0:
                return 1
        return 0

    return run_closed_form


class _Compiled(NamedTuple):
    """The compiled formulas, with the layout of their rows and the loop that calls them."""

    shape: Shape
    memory: Memory
    function: Any
    loop: Callable[..., int]


@functools.cache
def _compiled(solution: Solution, kind: str, turned: bool, stored: Any = None) -> _Compiled:
    prepare, state = _traced(solution, kind, turned, stored, native=processor().fuses)
    lanes = _SIDE_BY_SIDE * processor().lanes(kind)
    shape, results = Shape(kind, lanes, lanes), len(state.results)
    constants = RESULTS + results
    n = constants + len(prepare.results)
    inputs = {(name, i): Place(_FIRST[name] + i) for name, k in _GIVEN.items() for i in range(k)}
    kept = [Place(row) for row in range(constants, n)]
    inputs |= {("t", 0): Place(TIME)} | {("constant", k): x for k, x in enumerate(kept)}
    found = [Place(row) for row in range(RESULTS, constants)]
    both = LaneFormula(prepare, inputs, kept), LaneFormula(state, inputs, found, Place(FINITE))
    loop = address_loop(_run_closed_form(kind, lanes, results - 3))
    return _Compiled(shape, Memory(shape, n, 2), lane_function(shape, both), loop)


class Evaluation:
    """Evaluates the closed form of the same bodies at equally many times; prepared once.

    ``stored`` converts a quaternion to the numbers that are stored; None stores the quaternion.
    """

    def __init__(
        self,
        form: BodySolution,
        kind: np.dtype[Any],
        shape: tuple[int, int],
        stored: Callable[[Any], Any] | None = None,
    ) -> None:
        size, n = shape
        moments, axes = form.body
        #: rad/s, of any body
        self.largest_gain = float(form.gain.max())
        self._formulas = (form.solution, kind_of(kind), axes is not None, stored)
        given = {"moments": moments, "axes": axes, "pull": form.pull}
        self._bodies = {name: rows(x, kind) for name, x in given.items() if x is not None}
        span = -(-size // max(1, min(size, _TOGETHER // n)))
        self._lengths = (n, size, span, n * -(-size // span))
        if not without_compiler():
            self._compiled = _compiled(*self._formulas)
            ordered = [self._bodies.get(name, self._bodies["moments"]) for name in given]
            self._last = [number for x in ordered for number in (address_of(x), _stride(x))]

    def fill(
        self,
        start: tuple[NDArray[Any], NDArray[Any]],
        t: NDArray[Any],
        out: tuple[NDArray[Any], NDArray[Any]],
        threads: int,
    ) -> bool:
        """Write attitudes (T, N, k) and w (T, N, 3) at times (T,); the rows of both may have gaps.

        All arrays have the same precision. The initial q and w are (N, k), (1, k) for all bodies,
        or (k,). Returns whether a result is not finite.
        """
        if without_compiler():
            self._in_python(start, t, out)
            return not all(np.isfinite(x).all() for x in out)
        (q, w), (q_out, w_out), made = start, out, self._compiled
        n, size, span, lanes = self._lengths
        numbers = [
            made.function.address, address_of(t), _address(q_out), _address(w_out),
            *(x.strides[1] // x.itemsize for x in out), *self._lengths,
            address_of(q), _stride(q), address_of(w), _stride(w), *self._last,
        ]  # fmt: skip
        table, found = array("q", numbers), []

        def run(*bounds: int) -> None:
            _held, *at = made.memory.made()
            found.append(made.loop(table.buffer_info()[0], *at, *bounds))

        blocks = -(-lanes // made.shape.block)
        threads = 1 if size * n <= _SMALL else threads
        together = max(1, _PIECE // (made.shape.block * min(span, _STEPS)))
        together = max(1, min(together, blocks // threads))
        if together >= blocks and span <= _STEPS:
            run(0, blocks, 0, span)
            return any(found)
        pieces = product(range(0, blocks, together), range(0, span, _STEPS))
        calls = [
            partial(run, i, min(i + together, blocks), k, min(k + _STEPS, span)) for i, k in pieces
        ]
        each_in_threads(calls, threads)
        return any(found)

    def _in_python(
        self,
        start: tuple[NDArray[Any], NDArray[Any]],
        t: NDArray[Any],
        out: tuple[NDArray[Any], NDArray[Any]],
    ) -> None:
        """Evaluate without a compiler, with an array for each number of the formulas."""
        prepare, state = _traced(*self._formulas)
        bodies = {**self._bodies, **dict(zip("qw", map(np.atleast_2d, start), strict=True))}
        given = {(name, i): x[:, i] for name, x in bodies.items() for i in range(x.shape[1])}
        constants = _plain(prepare, given)
        given |= {("constant", i): x for i, x in enumerate(constants)}
        given["t", 0] = t[:, None]
        columns = [x[..., k] for x in out for k in range(x.shape[-1])]
        for column, x in zip(columns, _plain(state, given), strict=True):
            column[...] = x


def _address(x: NDArray[Any]) -> int:
    """Address of an array whose rows may have gaps between them."""
    return int(x.__array_interface__["data"][0])


def _stride(x: NDArray[Any]) -> int:
    """Distance between the rows of two bodies, in numbers; 0 if all bodies share one row."""
    return x.shape[-1] if x.ndim == 2 and len(x) > 1 else 0


def rows(x: NDArray[Any], kind: np.dtype[Any]) -> NDArray[Any]:
    """Numbers of bodies in the form that ``Evaluation`` takes."""
    if x.dtype is not kind or not x.flags.carray:
        x = np.require(x, kind, ["C", "A"])
    return x if x.ndim == 2 else np.atleast_2d(x)


@functools.cache
def _stored_of(attitude: Attitude) -> Callable[[Any], Any] | None:
    """The conversion from a quaternion to the numbers that a trajectory holds."""
    return None if attitude is QUATERNION else lambda q: attitude.raw(attitude.start(q))


def results_at(plan: Plan, given: Given, saves: slice, threads: int) -> Results:
    """A plan's states at some of its saves; warns if rounding leaves few digits of the angles."""
    kind, stored, form = plan.kind, plan.attitude.stored, form_of(plan.scene)
    since = plan.clock.since[saves]
    results = plan.results(len(since))
    results.norm_error[...] = results.status[...] = 0
    out = results.out
    evaluation = plan.evaluations.get(len(since))
    if evaluation is None:
        evaluation = Evaluation(form, kind, out.shape[:2], _stored_of(plan.attitude))
        plan.evaluations[len(since)] = evaluation
    split = (out[..., :stored], out[..., stored:])
    with np.errstate(over="ignore", invalid="ignore"):
        times = since.astype(kind)
        has_bad = evaluation.fill((given.q, given.y), times, split, threads)
        # |w| and what it gains are below twice their largest component
        largest = max(given.y.max(), -given.y.min()) + evaluation.largest_gain
        most = 2.0 * largest * max(abs(since[0]), abs(since[-1]))
    if not most <= rounding.most_turned(kind) ** 0.5:
        angles = turned(given.y, since, form.gain)
        if text := rounding.of_angles(angles, kind):
            rounding.warn(f"t: found turns of {text}")
        far = angles > rounding.most_turned(kind)
        results.status[...] = far * np.uint8(Status.STEP_TOO_LARGE)
    if has_bad:
        bad = ~np.isfinite(out).all(axis=(0, 2))
        results.status[...] |= bad * np.uint8(Status.NON_FINITE)
    return results


def turned(w: NDArray[Any], t: NDArray[Any], gain: NDArray[np.float64]) -> NDArray[np.float64]:
    """The largest ``|w| t`` of each body, rad, with the ``gain`` of a ``BodySolution``."""
    with np.errstate(over="ignore", invalid="ignore"):
        rates = np.asarray(w, dtype=np.float64)
        squares = (rates * rates) @ np.ones(3) + gain * gain
        return np.asarray(np.sqrt(squares) * np.abs(t).max(initial=0.0))


def _plain(flat: Flat, columns: Mapping[tuple[Any, ...], NDArray[Any]]) -> tuple[Any, ...]:
    from fastatt.tracing.source import function

    return function(flat)(*(columns[name] for name in flat.inputs()))
