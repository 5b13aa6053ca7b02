"""Dual numbers: every operation's derivative against its definition, and kernels in chains.

The reference is the recorded formula itself at 50 digits, differentiated by differences.
"""

import math
import operator

import mpmath as mp
import numpy as np
import pytest
from each import each
from oracle import EPS, quat_exp, right_jacobian

from fastatt.tracing import graph, nodes, operations, source
from fastatt.tracing.dual import derivatives, seed, value
from fastatt.tracing.finished import Flat
from fastatt.tracing.formulas import dcm, free_body, kernels, quat, rigid, so3, trig
from fastatt.tracing.graph import Double, Graph, Single, flattened
from fastatt.tracing.nodes import TraceError
from fastatt.tracing.trace import traceable

IN_MP = {
    "+": operator.add,
    "-": operator.sub,
    "*": operator.mul,
    "/": lambda a, b: a / b if b else mp.nan,
    "fma": lambda a, b, c: a * b + c,
    "fms": lambda a, b, c: a * b - c,
    "fnma": lambda a, b, c: c - a * b,
    "neg": operator.neg,
    "abs": abs,
    "sqrt": mp.sqrt,
    "rint": mp.nint,
    "floor": mp.floor,
    "select": lambda test, a, b: a if test else b,
    "larger": max,
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
    "==": operator.eq,
    "!=": operator.ne,
    "and": lambda a, b: a and b,
    "or": lambda a, b: a or b,
    "not": operator.not_,
    **{name: getattr(mp, name) for name in operations.LIBRARY},
}


def at_50_digits(flat, given):
    """The results of a graph."""
    values = []
    for node in flat.nodes:
        if node.op == "const":
            values.append(mp.mpf(node.args[0]))
        elif node.op == "in":
            values.append(given[node.args[1]])
        else:
            values.append(IN_MP[node.op](*(values[i] for i in nodes.operands(node))))
    return [values[i] for i in flat.results]


def recorded(function, numbers, *, lanes=0, kind="double"):
    """Values and derivatives to all numbers, from duals with a lane a direction or without."""
    made, n = Graph(lanes), len(numbers)
    found = function(*seed(made.inputs(kind, "x", n), n))
    results = flattened(found)
    flat = Flat(made, [*value(results), *(s for x in results for s in derivatives(x, n))], kind)
    units = np.eye(max(n, lanes), dtype={"double": np.float64, "single": np.float32}[kind])
    given = [numbers[k] if group == "x" else units[k] for group, k in flat.inputs()]
    values = source.function(flat)(*given)
    return np.array(values[: len(results)]), np.reshape(values[len(results) :], (-1, n)), flat


def differentiated(function, numbers, step=mp.mpf(10) ** -25):
    """The same at 50 digits, by central differences."""
    made, n = Graph(), len(numbers)
    flat = Flat(made, flattened(function(*made.inputs("double", "x", n))), "double")
    exact = [mp.mpf(x) for x in numbers]
    columns = []
    for k in range(n):
        # in relation to the number, which may be tiny, or much larger
        h = step * max(abs(exact[k]), mp.mpf(10) ** -200)
        ends = [[x + s * h if i == k else x for i, x in enumerate(exact)] for s in (1, -1)]
        high, low = (at_50_digits(flat, end) for end in ends)
        columns.append([(a - b) / (2 * h) for a, b in zip(high, low, strict=True)])
    return [float(x) for x in at_50_digits(flat, exact)], np.array(columns, dtype=float).T


X, Y = 0.7, -1.3
TERMS = {
    "sums": lambda x, y: (2.0 - x + (y - 1)) * y * 3 + x / y + 1.0 / x - (x - 4.0),
    "signs": lambda x, y: -(+x) * abs(y) + abs(x) - y / 2.0,
    "powers": lambda x, y: x**3 + x**0.5 + y**-2 + y**1 + x**0 + x**1.5,
    "extremes": lambda x, y: min(x, y) * max(x, y) + max(x, 0.1) + min(2.0, y),
    "root": lambda x, y: math.sqrt(x) + np.hypot(x, y),
    "circular": lambda x, y: math.sin(y) * math.cos(x) + math.tan(y) + math.atan(y),
    "angle": lambda x, y: math.atan2(y, x) * math.atan2(x, y) + math.atan2(0.3, y),
    "exponential": lambda x, y: np.exp(y) * math.log(x),
    "hyperbolic": lambda x, y: np.tanh(x) * math.sinh(y) + math.cosh(y),
    "inverse": lambda x, y: math.asin(x) + math.acos(0.5 * y),
    "choice": lambda x, y: (x if x < 1 else y) * (y if y >= x else x * y) + (x if x != y else 0.0),
    "rests": lambda x, y: x % 0.3 * y + y % 0.4 * x + x // 0.2 * y,
    "steps": lambda x, y: x * np.rint(3 * x) + y * np.floor(y) + math.copysign(x, y),
}


@pytest.mark.newest
@each("lanes", [0, 8])
@each("name", TERMS)
def test_operations(name, lanes):
    function = traceable(TERMS[name])
    found, slopes, _ = recorded(function, (X, Y), lanes=lanes)
    values, true = differentiated(function, (X, Y))
    assert found == pytest.approx(values, rel=4 * EPS)
    assert np.abs(slopes - true).max() <= 8 * EPS * max(1.0, np.abs(true).max())


def turned_and_back(u):
    return dcm.log(dcm.exp(u))


@each("x", [0.3, -0.7])
@each("name", operations.LIBRARY)
def test_functions_of_the_c_library(name, x):
    x = abs(x) if name == "log" else x
    _, slopes, _ = recorded(lambda y: graph.apply(name, y), (x,))
    _, true = differentiated(lambda y: graph.apply(name, y), (x,))
    assert np.abs(slopes - true).max() <= 4 * EPS * max(1.0, np.abs(true).max())
    # of a known number by Python
    made = Graph()
    (known,) = seed((x,), 1, like=made.input("double", "x"))
    assert derivatives(graph.apply(name, known), 1) == pytest.approx(slopes[0], rel=4 * EPS)


def triaxial(*x):
    return free_body.evaluate(free_body.setup(quat.exp(x[:3]), x[3:6], (1.0, 1.4, 2.0)), x[6])


U = (0.7, -0.4, 1.1)
NEAR_PI = tuple(3.1415 / 1.5 * c for c in (1.0, -0.5, 1.0))
PAST = (5.0, -4.0, 3.0)
Q = (0.5, -0.1, 0.7, 0.5)
CHAINS = {
    "exp": (lambda *u: quat.exp(u), [U, NEAR_PI, PAST, (1e-160, 0.0, 0.0), (40.0, -90.0, 7.0)]),
    "exp_short": (lambda *u: quat.exp_short(u), [U, NEAR_PI, (1e-160, 2e-160, 0.0)]),
    "log": (lambda *q: quat.log(q), [Q, (-0.1, 0.3, 0.2, -0.9), (1.0, 1e-9, 2e-9, -1e-9)]),
    "dcm.log": (lambda *u: turned_and_back(u), [U, NEAR_PI, (0.01, 0.02, -0.01)]),
    "right_jacobian": (lambda *u: so3.right_jacobian(u), [U, NEAR_PI, PAST]),
    "left_jacobian_inverse": (lambda *u: so3.left_jacobian_inverse(u), [U, NEAR_PI, PAST]),
    "dexpinv": (lambda *x: so3.dexpinv(x[:3], x[3:]), [(*U, 0.3, -0.2, 0.5)]),
    "second_integral": (lambda *x: so3.turned_second_integral(x[:3], x[3:]), [(*U, *PAST)]),
    "normalise": (lambda *q: quat.normalise(q), [(3e150, -1e150, 2e150, 1e150), Q]),
    "sinhcosh": (lambda r: trig.short_waves(r, -r * r), [(0.2,), (-0.3,)]),
    "decay": (rigid.exp_decay, [(0.3,), (-2.0,), (30.0,)]),
    "triaxial": (triaxial, [(*U, 0.3, -0.2, 0.5, 2.0), (*U, 1.0, 1e-3, 1e-4, 10.0)]),
    "modified": (
        lambda *x: kernels("moser_veselov").solve(x[:3], x[3:]),
        [(0.05, -0.1, 0.08, 0.3, -0.5, 0.25)],
    ),
}
POINTS = [(name, k) for name, (_, points) in CHAINS.items() for k in range(len(points))]


@pytest.mark.newest
@pytest.mark.parametrize("lanes", [0, 8])
@pytest.mark.parametrize(("name", "k"), POINTS)
def test_kernels(name, k, lanes):
    function, points = CHAINS[name]
    found, slopes, _ = recorded(function, points[k], lanes=lanes)
    values, true = differentiated(function, points[k])
    size = max(1.0, np.abs(points[k]).max())
    assert found == pytest.approx(values, rel=1e-13, abs=16 * EPS * size)
    # each column beside its own largest number
    scale = np.maximum(np.abs(true).max(axis=0), 1e-300)
    assert (np.abs(slopes - true) / scale).max() <= 1e-14 * size


@pytest.mark.parametrize("x", np.linspace(-7.0, 7.0, 41))
def test_sines_and_angles_have_the_derivatives_of_sines_and_angles(x):
    """Not of the polynomials that stand for them, which would be ten times further off."""
    _, slopes, _ = recorded(lambda x: trig.sincos(x), (x,))
    assert abs(mp.cos(x) - slopes[0, 0]) <= 1.4e-16
    assert abs(mp.sin(x) + slopes[1, 0]) <= 1.4e-16
    y, c = math.sin(x), math.cos(x)
    _, slopes, _ = recorded(trig.atan2, (y, c))
    square = mp.mpf(y) ** 2 + mp.mpf(c) ** 2
    true = np.array([c / square, -y / square], dtype=float)
    assert np.abs(slopes[0] - true).max() <= 4 * EPS


@pytest.mark.parametrize("theta", [0.0, 1e-160, 1e-8, 0.5, 3.0, 3.3, 6.28, 6.3, 40.0])
def test_of_an_exponential_it_is_the_right_jacobian(theta):
    u = tuple(theta * c for c in (2 / 3, -1 / 3, 2 / 3))
    q, slopes, _ = recorded(lambda *u: quat.exp(u), u)
    assert np.abs(q - np.array(quat_exp(u), dtype=float).ravel()).max() <= 2 * EPS * (1 + theta)
    p = np.array([[q[0], q[1], q[2], q[3]], [-q[1], q[0], q[3], -q[2]],
                  [-q[2], -q[3], q[0], q[1]], [-q[3], q[2], -q[1], q[0]]])  # fmt: skip
    true = np.array(right_jacobian(u).tolist(), dtype=float)
    assert np.abs(2.0 * (p @ slopes)[1:] - true).max() <= 4 * EPS * (1 + theta)


@pytest.mark.parametrize("x", [1e-12, -1e-6, 1e-3, 0.2])
def test_of_a_quotient_whose_ends_meet_it_loses_what_the_quotient_of_differences_does(x):
    """sinh(y)/y: an ulp in relation to y."""
    _, slopes, _ = recorded(rigid.exp_decay, (x,))
    _, true = differentiated(rigid.exp_decay, (x,))
    assert np.abs(slopes - true).max() <= 4 * EPS + EPS / abs(x)


def test_what_is_selected_away_does_not_spoil():
    """The root's slope at 0 is infinite."""
    function = traceable(lambda x: x * x if x < 1.0 else math.sqrt(x - 1.0))
    _, slopes, _ = recorded(function, (0.5,))
    assert slopes[0, 0] == 1.0
    theta = traceable(lambda x: math.sqrt(x) / x if x > 0.0 else 2.0 * x)
    assert recorded(theta, (0.0,))[1][0, 0] == 2.0


@pytest.mark.parametrize("lanes", [0, 2])
def test_single_precision_stays(lanes):
    made = Graph(lanes)
    a, _ = seed(made.inputs("single", "x", 2), 2)
    F = a.own_type()
    assert F is Single
    assert F(0.5) == 0.5
    assert a.precision == "single"
    b = F(3.0) * a * a if lanes else a * F(3.0) * a
    assert {s.precision for s in derivatives(b, 2) if isinstance(s, graph.Number)} == {"single"}
    wide = Double(b)
    assert wide.precision == "double"
    assert {s.precision for s in derivatives(wide, 2) if isinstance(s, graph.Number)} == {"double"}
    _, slopes, _ = recorded(lambda x, y: quat.exp((x, y, x)), (0.5, 0.25), kind="single")
    _, true, _ = recorded(lambda x, y: quat.exp((x, y, x)), (0.5, 0.25))
    assert 0.0 < np.abs(slopes - true).max() <= 4 * np.finfo(np.float32).eps


class Opaque:
    """A function that can't be traced."""

    name = "pull"

    def __call__(self, a, b, c):
        return math.exp(a) * c, math.sin(1e3 * b)


@pytest.mark.parametrize("lanes", [0, 4])
def test_of_what_is_opaque_differences(lanes):
    function = Opaque()

    def outer(x, y, z):
        u, v = graph.opaque(function, 2, (x * y, y, 2.0), z.value)
        return u * z, v

    made = Graph(lanes)
    x = (0.3, -0.7, 1.5)
    found = outer(*seed(made.inputs("double", "x", 3), 3))
    slopes = [s for y in found for s in derivatives(y, 3)]
    flat = Flat(made, slopes, "double")
    units = np.eye(max(3, lanes))
    given = [x[k] if group == "x" else units[k] for group, k in flat.inputs()]
    values = np.reshape(source.function(flat)(*given), (2, 3))
    e = 2.0 * math.exp(x[0] * x[1])
    assert np.abs(values[0] - [x[1] * e * x[2], x[0] * e * x[2], e]).max() <= 1e-9
    # (1000 h)²/6 of 1000, with h = 2⁻¹⁷
    true = 1e3 * math.cos(1e3 * x[1])
    assert abs(values[1, 1] - true) <= 1.01 * abs(true) * (1e3 / 2**17) ** 2 / 6
    assert values[1, 0] == values[1, 2] == 0.0


def test_tables_are_asked_by_values():
    made = Graph()
    (x,) = seed((made.input("double", "x"),), 1)
    k = graph.apply("floor", x)
    slope = derivatives((x - k) * graph.row(0, k, 1)[0], 1)
    found = source.function(Flat(made, slope, "double"), tables={0: np.array([3.0, 5.0, 7.0])})
    assert found(1.25) == (5.0,)


def test_seeds():
    made = Graph()
    x = made.inputs("double", "x", 2)
    a, b = seed(x, 4, 1)
    assert (derivatives(a, 4), derivatives(b, 4)) == ((0, 1, 0, 0), (0, 0, 1, 0))
    (known,) = seed((2.0,), 2, like=x[0])
    assert (value(known), derivatives(3.0 * known, 2)) == (2.0, (3.0, 0.0))
    with pytest.raises(TraceError, match="a seed of known numbers alone"):
        seed((1.0, 2.0), 2)


def test_refusals():
    made = Graph()
    x = made.inputs("double", "x", 2)
    (a,) = seed(x[:1], 1)
    with pytest.raises(TraceError, match="a power that is not known"):
        2.0**a
    with pytest.raises(TraceError, match="a branch on a condition"):
        bool(a)
    with pytest.raises(TraceError, match="a Dual where a number of a graph is wanted"):
        Flat(made, [a], "double")
    with pytest.raises(TraceError, match="the derivative of a truth value"):
        derivatives(a > 0.0, 1)
