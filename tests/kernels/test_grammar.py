"""What holds for every kernel: its form, both precisions, use from jitted code, no integers."""

import ast
import importlib
import inspect
import pkgutil
import re

import numpy as np
import pytest
from each import each
from numba import njit, typeof, types
from numba.core.dispatcher import Dispatcher
from numba.core.errors import TypingError

import fastatt.kernels

PREFIX = "fastatt.kernels."
MODULES = [
    importlib.import_module(m.name) for m in pkgutil.iter_modules(fastatt.kernels.__path__, PREFIX)
]
KERNELS = {
    f"{module.__name__.removeprefix(PREFIX)}.{name}": f
    for module in MODULES
    for name, f in vars(module).items()
    if isinstance(f, Dispatcher) and f.py_func.__module__ == module.__name__
}

U = (0.3, -0.5, 0.7)
V = (-1.1, 0.4, 0.9)
W = (0.8, 1.2, -0.6)
X = (0.2, -0.9, 0.5)
E = (0.6, 0.0, 0.8)
Q = (0.1, -0.5, 0.7, 0.5)
P = (0.7, 0.1, -0.5, 0.5)
C = (0.36, 0.48, -0.8, -0.8, 0.6, 0.0, 0.48, 0.64, 0.6)
B = (1.1, 0.2, -0.3, 0.4, 0.9, 0.6, -0.2, 0.1, 1.2)
J = (0.8, 0.5, 1.0)
K4, K6 = (0.7, -0.4, 0.3, 0.2), (0.7, -0.4, 0.3, 0.2, -0.6, 0.5)
K8, K10 = (*K4, *K4), (*K6, *K4)
S6 = (1.4, 0.2, -0.1, 1.1, 0.3, 0.9)
P6 = (S6, B, (0.9, 0.1, 0.2, 1.2, -0.1, 0.8))
AXES = (0.0, 2.0, 1.0, -1.0, 1.0)
THETA = (
    *(0.99, -0.12, 0.01, 0.0, -0.2, 0.01, 0.0, 0.0, 0.9, 0.02, 0.0, 0.0, -0.4, 0.01, 0.0, 0.0),
    *(0.9, 3.140625, 0.0, 0.0, 0.0),
)
# arguments by their names, in any module and in one; of other kernels in full
NAMES = {
    "u": U, "phi": U, "angles": U, "v": V, "w": W, "f": V, "phidot": W, "derivative": W,
    "q": Q, "p": P, "qdot": P, "target": P, "e": E, "o": E, "inertia": J, "radial": E,
    "along": U, "torque": U, "h": 0.7, "t": 0.7, "s": 0.6,
    "angle_variance": 0.3, "bias_variance": 0.2, "mean_motion": 0.7, "coefficient": 0.7,
    "coefficients": J, "stiffness": 0.7, "damping": 0.3,
}  # fmt: skip
IN_MODULE = {
    "axis_angle": {"edot": (0.8, 0.1, -0.6), "phi": 1.2, "phidot": 0.7},
    "compensated": {
        "a": 0.7, "b": 1e-17, "x": (*Q, 1e-17, 0.0, -1e-17, 0.0), "d": P, "r": P, "c": 0.9,
        "s": 0.49, "f": -0.01,
    },
    "coning": {
        "a": U, "b": V, "c": W, "w0": U, "w1": V, "w2": W, "t1": 0.5, "t2": 1.25, "before": U,
        "now": V, "h0": 0.5, "h1": 0.75,
    },
    "dcm": {"a": B, "b": C, "c": C, "k": 0.5, "r": U, "cdot": B},
    "elliptic": {
        "x": 1.7, "wide": 1.0, "u": 1.2, "kc": 0.7, "y": 0.7, "yc": 0.3, "k": 0.6, "b": 0.4,
        "w0": 0.9, "w1": 0.2, "w2": -0.1, "w3": 0.01, "K": 1.75, "Kc": 2.0, "c": 0.8, "g": THETA,
    },
    "error_state": {"p": P6, "q": P6, "phi": (C, B), "c": C, "a": (*B, *C, *B, *C)},
    "euler313": {"c": C},
    "free_body": {
        "a": 0.3, "b": -0.7, "tiny": 1e-290, "x": 0.7, "m": W, "low": (0.0, 0.0, 0.0),
        "axes": AXES, "g": THETA, "s": 0.7, "size": 1.0, "f": 1.0,
    },
    "heavy_top": {
        "a": (0.3, -0.7), "b": (0.5, 0.2), "p": K4, "x": 1.3, "series": K8,
    },
    "moser_veselov": {
        "x": U, "y": V, "above": U, "below": V, "k": J, "s": 0.01, "d": -0.02,
        "c": (0.05, 0.02, -0.03), "u": (0.04, 0.02, -0.03), "kappa": (0.6, -0.3, 0.4),
    },
    "mrp": {"x": U},
    "quat": {"c": 0.8},
    "rigid": {"e": Q, "m": U, "c": V, "x": 0.7},
    "so3": {"a": B, "b": 0.5, "c": 0.1, "x": W, "z": 1.3},
    "sym3": {"a": B, "b": C, "s": K6, "k": 0.5},
    "trig": {
        "x": 2.5, "k": 3.0, "z": 1.3, "n": 3.0, "a": 5.0, "b": 0.3,
        "over": 4.7, "under": 5.3,
    },
    "two_rows": {"a": B[:3], "b": B[3:6]},
    "vec3": {"a": U, "b": V, "k": 0.5, "c": 0.8},
}  # fmt: skip
IN_FULL = {
    "compensated.add_vector": ((*U, 1e-17, 0.0, -1e-17), V),
    "compensated.cosine_less_one": (0.8, (0.0, 0.6, 0.0)),
    "dcm.rotate_first": (C, 0.8, 0.6),
    "dcm.rotate_third": (C, 0.8, 0.6),
    "elliptic.landen_step": (0.7, 1.0, 1.0, 0.4, 0.0),
    "elliptic.cubic": ((0.9, 0.2, -0.1, 0.01), 1.3),
    "elliptic.limited": (50.0,),
    "elliptic.select": (1.0, K8, THETA[:8]),
    "elliptic.weighted": (K8, 0.7, -1.0),
    "elliptic.theta_argument": (THETA[16:], 0.6),
    "free_body.split_multiply": ((0.3, 1e-17), (-0.7, 1e-17)),
    "free_body.exchange": (P, Q, 1.0),
    "free_body.handed": ((0.5, -0.3, 0.0, 1.0), (0.8, 0.2, 0.0, 0.0), (1.0, 0.6, 0.0, 2.0)),
    "free_body.turned": (Q, 0.5, 0.9),
    "free_body.amplitudes": ((0.5, 0.8, 1.0), (0.3, -0.2, 0.6), 0.05),
    "free_body.evaluate": ((*Q, *AXES, 0.5, 0.9, 0.2, 0.1, 1.6, 0.3, 0.4, *THETA), 0.7),
    "free_body.symmetric_setup": (Q, W, (0.5, 1.0, 0.5)),
    "free_body.symmetric_evaluate": ((*Q, *V, *W, *E, -0.4), 0.7),
    "heavy_top.roots": (1.2, 0.8, 0.5, 0.6, 0.7, (0.3, -0.4), 1.02, -0.18),
    "heavy_top.ratio": (0.3, 0.7),
    "heavy_top.series": ((0.8, 0.4, 0.3, 1.5, 1.7, 0.5, 0.2), 0.7, 0.5, -0.4),
    "heavy_top.parts": ((*THETA, 0.1), (0.3, -0.2, 0.9, 0.2, 0.6), 0.7),
    "heavy_top.matched": ((0.6, 0.0), (0.0, 0.8), (0.3, 0.4), (0.0, 0.6), (0.8, 0.0), (-0.4, 0.3)),
    "heavy_top.setup": (P, W, (1.0, 1.0, 0.5), (0.0, 0.0, 0.7)),
    "heavy_top.evaluate": (
        (*P, 0.6, 0.8, 0.0, 1.0, 0.3, -0.2, 0.9, 0.2, 0.6, 1.1, *THETA, 0.1),
        0.7,
    ),
    "moser_veselov.corrections2": (0.1, 0.2, K4),
    "moser_veselov.corrections4": (0.1, 0.2, K6),
    "moser_veselov.corrections6": (0.1, 0.2, K8),
    "moser_veselov.corrections8": (0.1, 0.2, K10),
    "moser_veselov.newton": ((0.01, 0.02, -0.03), (0.01, 0.02, -0.03), (0.2, -1.3, 1.5)),
    "rigid.kinetic_energy_symmetric": (U, W, (0.8, 1.0)),
    "rigid.saturated": (U, (0.4, 0.4, 0.9)),
    "trig.short_waves": (0.3, 0.09),
    "trig.sincos_short": (0.5, 3.0),
    "trig.half_sinc_cos_wide": (30.0,),
    "trig.octave": (3.0, 5.0, 0.5, 4.0, 16.0),
    "trig.atan2": (0.4, -0.9),
}


def arguments_of(name):
    """By the names of a kernel's parameters; a new one with a name of its own needs an entry."""
    if name in IN_FULL:
        return IN_FULL[name]
    known = NAMES | IN_MODULE.get(name.split(".")[0], {})
    return tuple(known[x] for x in inspect.signature(KERNELS[name].py_func).parameters)


ARGUMENTS = {name: arguments_of(name) for name in KERNELS}


def cast(x, to):
    """A nested tuple of floats with every leaf of type ``to``."""
    return tuple(cast(c, to) for c in x) if isinstance(x, tuple) else to(x)


def leaves(x):
    """The numbers, or number types, of a nested tuple."""
    if isinstance(x, types.Type):
        return [t for part in x for t in leaves(part)] if isinstance(x, types.BaseTuple) else [x]
    return [c for part in x for c in leaves(part)] if isinstance(x, tuple) else [x]


def one_integer(x, place):
    """The arguments with the number at ``place`` (0 first, −1 last) an integer."""
    if not isinstance(x, tuple):
        return 1
    x = list(x)
    x[place] = one_integer(x[place], place)
    return tuple(x)


def user_function(kernel):
    """What a user writes."""

    @njit
    def user(arguments):
        return kernel(*arguments)

    return user


@pytest.mark.parametrize("module", sorted({name.split(".")[0] for name in KERNELS}))
def test_compiled(module):
    """As for jitted code, where kernels call kernels."""
    each("name", [x for x in sorted(KERNELS) if x.split(".")[0] == module])(compiled)()


def compiled(name):
    kernel, arguments = KERNELS[name], ARGUMENTS[name]
    found = kernel(*arguments)
    results = {s.args: s.return_type for s in kernel.nopython_signatures}
    assert set(leaves(results[tuple(map(typeof, arguments))])) == {types.float64}
    size = max(1.0, *(abs(c) for c in leaves(found)))
    # compiled or not, the same sums: a fused product or two of difference
    gap = np.subtract(leaves(kernel.py_func(*arguments)), leaves(found))
    assert np.abs(gap).max() <= 4 * np.finfo(np.float64).eps * size


@pytest.mark.parametrize("name", ["quat.rotate", "so3.dexpinv", "rigid.gravity_gradient"])
def test_from_jitted_code(name):
    """In both precisions: that all kernels keep them is in their form."""
    kernel, wide = KERNELS[name], ARGUMENTS[name]
    user = user_function(kernel)
    for arguments, kind in ((wide, types.float64), (cast(wide, np.float32), types.float32)):
        assert user(arguments) == kernel(*arguments)
        assert set(leaves(user.nopython_signatures[-1].return_type)) == {kind}


def refusal(kernel, arguments):
    try:
        kernel(*arguments)
    except TypingError as error:
        return str(error)
    return ""


@pytest.mark.parametrize("place", [0, -1])
def test_integers_are_refused(place):
    found = {n: refusal(k, one_integer(ARGUMENTS[n], place)) for n, k in KERNELS.items()}
    asked = "{}: found an integer .* write 1.0 instead of 1"
    others = {n: x for n, x in found.items() if not re.search(asked.format(n.split(".")[1]), x)}
    assert others == {}


@pytest.mark.parametrize("bad", [1, np.int32(1), True])
def test_integers_are_refused_inside_jitted_code(bad):
    user = user_function(fastatt.kernels.quat.rotate)
    with pytest.raises(TypingError, match="rotate: found an integer"):
        user((Q, (0.5, bad, 0.5)))


# form

CALLS = {"abs", "type", "F"}
NUMPY = {"elliptic": {"rint"}, "trig": {"rint", "floor"}}
MATH = {"sqrt", "pi"}


def functions():
    for module in MODULES:
        short = module.__name__.removeprefix(PREFIX)
        for node in ast.parse(inspect.getsource(module)).body:
            if isinstance(node, ast.FunctionDef):
                yield f"{short}.{node.name}", node


class Unrounded(ast.NodeVisitor):
    """Numbers that do not take the arguments' precision: outside ``type(x)(…)`` and ``F(…)``."""

    def __init__(self, function):
        names = [n for n in ast.walk(function) if isinstance(n, ast.Name)]
        self.known = {n.id for n in names if isinstance(n.ctx, ast.Store)}
        self.known |= {a.arg for a in function.args.args}
        self.found = []

    def visit_Call(self, node):
        if ast.unparse(node.func) != "F" and not isinstance(node.func, ast.Call):
            for argument in node.args:
                self.visit(argument)

    def visit_Subscript(self, node):
        self.visit(node.value)

    def visit_Name(self, node):
        if node.id not in self.known:
            self.found.append(node.id)

    def visit_Constant(self, node):
        self.found.append(node.value)

    def visit_Attribute(self, node):
        self.found.append(ast.unparse(node))


def test_every_function_is_a_kernel():
    assert {name for name, _ in functions()} == set(KERNELS)


def faults(module, function):
    """What is not a docstring, assignments of expressions and one return: what vectorises."""
    if not ast.get_docstring(function):
        yield "no docstring"
    _, *steps, last = function.body
    for statement, kind in (*((s, ast.Assign) for s in steps), (last, ast.Return)):
        if not isinstance(statement, kind):
            yield ast.unparse(statement)
            return
    allowed = (
        *(ast.Name, ast.Constant, ast.Attribute, ast.Slice, ast.Subscript, ast.Tuple, ast.Call),
        *(ast.BinOp, ast.UnaryOp, ast.Compare, ast.IfExp, ast.Assign, ast.Return),
        *(ast.expr_context, ast.operator, ast.unaryop, ast.cmpop),
    )
    for node in (n for s in (*steps, last) for n in ast.walk(s)):
        is_allowed = isinstance(node, allowed)
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
            allowed_of = {"np": NUMPY.get(module, ()), "math": MATH}
            is_allowed &= node.attr in allowed_of.get(node.value.id, (node.attr,))
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
            called = getattr(fastatt.kernels, module).__dict__.get(node.func.id)
            is_allowed &= node.func.id in CALLS or isinstance(called, Dispatcher)
        if not is_allowed:
            yield ast.unparse(node)
    unrounded = Unrounded(function)
    for step in (*steps, last):
        unrounded.visit(step.value)
    yield from unrounded.found


def test_form():
    found = {name: list(faults(name.split(".")[0], node)) for name, node in functions()}
    assert {name: each for name, each in found.items() if each} == {}
