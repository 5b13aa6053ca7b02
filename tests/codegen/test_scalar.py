"""A formula as one function of numbers, for ``@njit`` code and for Python."""

import gc
import math
import os
import re
import subprocess
import sys
import weakref
from functools import reduce
from typing import NamedTuple

import numpy as np
import pytest
from numba import cfunc, njit, types
from numba.core.errors import TypingError
from oracle import EPS

from fastatt.codegen.scalar import scalar_function
from fastatt.kernels import quat as kernels
from fastatt.tracing import dual, graph, operations
from fastatt.tracing.finished import Flat
from fastatt.tracing.formulas import axpy, quat, rigid, scale, so3
from fastatt.tracing.graph import Graph
from fastatt.tracing.nodes import TraceError

SINGLE = np.float32
P = (0.25, 0.5, 0.75, -0.5, 0.75, -0.4)
START = (1.0, 0.0, 0.0, 0.0, 0.1, 0.2, 0.3)


def field(x, p):
    q, m = x[:4], x[4:]
    v = tuple(a * b for a, b in zip(p[:3], m, strict=True))
    return (*quat.mul_vector(q, v), *rigid.gyroscopic(m, p[3:]))


def rk4(x, p, h):
    k1 = field(x, p)
    k2 = field(axpy(0.5 * h, k1, x), p)
    k3 = field(axpy(0.5 * h, k2, x), p)
    k4 = field(axpy(h, k3, x), p)
    total = [a + 2.0 * (b + c) + d for a, b, c, d in zip(k1, k2, k3, k4, strict=True)]
    return axpy(1.0 / 6.0 * h, total, x)


step = scalar_function(rk4)


@njit
def run(x, p, h, n):
    for _ in range(n):
        x = step(x, p, h)
    return x


class State(NamedTuple):
    q: tuple
    w: tuple
    t: float


class Pair(NamedTuple):
    state: State
    past: bool


def nested(s, h, unused):
    (a, b), c = unused
    u = scale(h, s.w)
    return Pair(State(quat.mul(s.q, quat.exp(u)), s.w, s.t + h), c > 3.0), (a, b, 2.0), ()


GIVEN = State((0.5, -0.5, 0.5, 0.5), (0.1, -0.2, 0.3), 1.0), 0.5, ((1.0, 2.0), 4.0)


@pytest.mark.parametrize("options", [{"fastmath": True}, {"debug": True}])
def test_a_callers_options_change_no_rounding(options):
    made = scalar_function(lambda x: (x + 1e16) - 1e16)

    @njit(**options)
    def user(x):
        return made(x), made(3.0 * x)

    assert user(1.0) == (0.0, 4.0)


@pytest.mark.parametrize("kind", [float, SINGLE])
def test_forms_of_tuples(kind):
    made = scalar_function(nested)

    @njit
    def user(s, h, unused):
        return made(s, h, unused)

    given = State(tuple(map(kind, GIVEN[0].q)), tuple(map(kind, GIVEN[0].w)), kind(1.0))
    given = given, kind(0.5), ((kind(1.0), kind(2.0)), kind(4.0))
    compiled, plain = user(*given), made(*given)
    assert compiled == plain
    for found in (compiled, plain):
        assert isinstance(found[0], Pair)
        assert isinstance(found[0].state, State)
        assert found[0].past is True
        assert found[1:] == ((1.0, 2.0, 2.0), ())
    true = kernels.mul(GIVEN[0].q, kernels.exp((0.05, -0.1, 0.15)))
    eps = np.finfo(kind).eps
    assert np.abs(np.subtract(plain[0].state.q, true)).max() <= 4 * eps
    (signature,) = user.nopython_signatures
    number = {float: types.float64, SINGLE: types.float32}[kind]
    assert leaves(signature.return_type) == {number, types.boolean}
    assert type(plain[0].state.t) is kind


def leaves(ty):
    if isinstance(ty, types.BaseTuple):
        return set().union(*map(leaves, ty.types))
    return {ty}


def main_function(dispatcher):
    """LLVM's text of a compiled function itself, without its entries from Python."""
    (text,) = dispatcher.inspect_llvm().values()
    found = re.finditer(r"^define [^@]*@\"?([^(\"]+).*?^}", text, flags=re.DOTALL | re.MULTILINE)
    return next(m[0] for m in found if m[1].startswith("_ZN"))


@pytest.mark.newest
def test_a_loop_allocates_nothing_and_holds_the_operations_alone():
    run(START, P, 0.1, 1)
    body = main_function(run)
    called = {m[1] for m in re.finditer(r"call [^@]*@([\w.]+)", body)}
    assert {name.rsplit(".", 1)[0] for name in called} <= {"llvm.fma"}, called
    assert "NRT_" not in body
    made = Graph()
    x, p = made.inputs("double", "x", 7), made.inputs("double", "p", 6)
    wanted = Flat(made, rk4(x, p, made.input("double", "h")), "double").nodes
    wanted = sum(n.op in ("+", "-", "*", "/", "fma", "fms", "fnma") for n in wanted)
    found = len(re.findall(r" = f(?:add|sub|mul|div) |call double @llvm.fma", body))
    # what does not change in the loop is done before it, once
    assert found <= wanted


def test_a_formula_that_is_dropped_is_released():
    """Numba keeps its type."""

    def made():
        formula = scalar_function(lambda x: x * x)

        @njit
        def user(x):
            return formula(x)

        assert user(3.0) == formula(3.0) == 9.0
        return weakref.ref(formula)

    dropped = made()
    gc.collect()
    assert dropped() is None


def test_functions_of_the_c_library():
    def formula(x):
        e = graph.apply("exp", x)
        return reduce(lambda s, name: s + graph.apply(name, 0.1 * x), operations.LIBRARY[1:], e)

    made = scalar_function(formula)

    @njit
    def user(x):
        return made(x)

    true = math.exp(0.7) + sum(getattr(math, name)(0.07) for name in operations.LIBRARY[1:])
    for found in (user(0.7), made(0.7)):
        assert abs(found - true) <= 8 * EPS
    assert abs(user(SINGLE(0.7)) - true) <= 8 * np.finfo(SINGLE).eps


def test_derivatives_side_by_side():
    def jacobian(u):
        q = quat.exp(dual.seed(u, 3))
        r = quat.mul(quat.conj(dual.value(q)), q)
        return tuple(2.0 * x for c in r[1:] for x in dual.derivatives(c, 3))

    made = scalar_function(jacobian)

    @njit
    def user(u):
        return made(u)

    u = (0.3, -1.0, 2.0)
    assert user(u) == made(u)
    true = scalar_function(so3.right_jacobian)(u)
    assert np.abs(np.subtract(user(u), true)).max() <= 4 * EPS
    (traced,) = made._traced.values()
    assert traced.lanes == 4
    # in another's recording they are apart
    outer = Graph()
    flat = Flat(outer, made(outer.inputs("double", "x", 3)), "double")
    assert not any(node.op == "lane" for node in flat.nodes)
    single = user(tuple(map(SINGLE, u)))
    assert 0 < np.abs(np.subtract(single, true)).max() <= 4 * np.finfo(SINGLE).eps


TABLE = np.array([3.0, 5.0, 7.0])


def looked_up(x):
    k = graph.apply("floor", x)
    return graph.row(0, k, 1)[0] * x


def test_tables_stay_where_machine_code_reads_them():
    """Numba keeps the machine code of functions that are gone."""

    def made():
        formula = scalar_function(looked_up, {0: TABLE.copy()})

        @njit
        def user(x):
            return formula(x)

        assert user(2.0) == 14.0
        return weakref.ref(formula), weakref.ref(formula.tables[0])

    formula, table = made()
    gc.collect()
    assert formula() is None
    assert table() is not None


class Machine:
    """An opaque function: f(a, b) -> (a² b, b)."""

    name = "machine"

    def __init__(self):
        self.calls = 0

        @cfunc(types.void(types.CPointer(types.float64), types.CPointer(types.float64)))
        def entry(given, made):
            made[0] = given[0] * given[0] * given[1]
            made[1] = given[1]

        self._entry = entry

    @property
    def address(self):
        return self._entry.address

    def __call__(self, a, b):
        self.calls += 1
        return a * a * b, b


MACHINE = Machine()


def opaque(x, y):
    a, b = dual.seed((x, y), 2)
    u, v = graph.opaque(MACHINE, 2, (a, b), x)
    return dual.value(u), dual.derivatives(u, 2), dual.derivatives(v * a, 2)


def test_tables_and_opaque_functions():
    table, called = scalar_function(looked_up, {0: TABLE}), scalar_function(opaque)

    @njit
    def user(x, y):
        return table(x), called(x, y)

    found = user(1.5, 2.5)
    assert found == (table(1.5), called(1.5, 2.5))
    assert found[0] == 7.5
    value, slopes, others = found[1]
    assert value == 1.5**2 * 2.5
    assert slopes == pytest.approx((7.5, 2.25), abs=1e-9)
    assert others == pytest.approx((2.5, 1.5), abs=1e-9)


KEPT = """
import edited
import fastatt as fa
import numpy as np
from numba import njit, prange
from fastatt.codegen.scalar import scalar_function

share = scalar_function(edited.formula)
body = fa.Scene(inertia=(2.0, 1.0, 0.7))
stepper = fa.single_step(body, method=edited.method)
step = stepper.step

@njit
def between(x):
    return share(x)

@njit(cache=True)
def user(x):
    return between(x)

@njit(cache=True, parallel=True)
def ensemble(x, p):
    for k in prange(len(x)):
        y = step(0.0, 0.1, (x[k, 0], x[k, 1], x[k, 2], x[k, 3], x[k, 4], x[k, 5], x[k, 6]), p)
        for i in range(7):
            x[k, i] = y[i]

state = stepper.state([1, 0, 0, 0], [1.0, 2.0, 3.0])
x = np.array([state, state])
ensemble(x, stepper.params)
print(user(2.0), x[1, 0].hex(), *(len(f.stats.cache_hits) for f in (user, ensemble)))
"""


def test_code_that_holds_a_formula_is_not_kept(tmp_path):
    """Numba would not see that a formula in another file than its caller is another one."""
    (tmp_path / "kept.py").write_text(KEPT)
    paths = os.pathsep.join(p for p in sys.path if p)
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cache"), "PYTHONPATH": paths}
    found = []
    for method, factor in (("strang2", 3.0), ("kahan_li8", 15.0)):
        text = f"method = {method!r}\nformula = lambda x: {factor} * x\n"
        (tmp_path / "edited.py").write_text(text)
        done = subprocess.run(
            [sys.executable, "kept.py"],
            cwd=tmp_path, env=environment, capture_output=True, text=True, check=True,
        )  # fmt: skip
        found.append(done.stdout.split())
        for name in ("user", "ensemble"):
            assert f'Cannot cache compiled function "{name}"' in done.stderr
    (a, x, *hits), (b, y, *others) = found
    assert (a, b) == ("6.0", "30.0")
    assert x != y
    assert hits == others == ["0", "0"]


REFUSED = "found {} among the arguments; accepted are float64 or float32 and tuples of them"


def test_refusals():
    two = njit(lambda x: step(x, x))
    for called, given, error, message in (
        (step, (START, P, 1), TypeError, "rk4: " + REFUSED.format("int")),
        (step, (np.array(START), P, 0.1), TypeError, "rk4: " + REFUSED.format("ndarray")),
        (run, (START, P, 1, 1), TypingError, "rk4: " + REFUSED.format("int64")),
        (two, (START,), TypingError, "rk4: missing a required argument: 'h'"),
    ):
        with pytest.raises(error, match=message):
            called(*given)
    with pytest.raises(TypeError, match="missing a required argument: 'h'"):
        step(START, P, q=0.1)


def test_what_is_no_straight_line_is_refused():
    branching = scalar_function(lambda x: x if x > 0.0 else -x)
    for called, error in ((branching, TraceError), (njit(lambda x: branching(x)), TypingError)):
        with pytest.raises(error, match="a branch on a condition"):
            called(1.0)
    with pytest.raises(TraceError, match="a result of str"):
        scalar_function(lambda x: "x")(1.0)
