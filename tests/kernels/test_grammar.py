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
EVERY = {
    f"{module.__name__.removeprefix(PREFIX)}.{name}": f
    for module in MODULES
    for name, f in vars(module).items()
    if isinstance(f, Dispatcher) and f.py_func.__module__ == module.__name__
}
#: modules that users call; the others are building blocks, which the methods' own tests compile
PUBLIC = ("dcm", "euler313", "quat", "rigid", "so3", "vec3")
KERNELS = {name: f for name, f in EVERY.items() if name.split(".")[0] in PUBLIC}

U = (0.3, -0.5, 0.7)
V = (-1.1, 0.4, 0.9)
W = (0.8, 1.2, -0.6)
E = (0.6, 0.0, 0.8)
Q = (0.1, -0.5, 0.7, 0.5)
P = (0.7, 0.1, -0.5, 0.5)
C = (0.36, 0.48, -0.8, -0.8, 0.6, 0.0, 0.48, 0.64, 0.6)
B = (1.1, 0.2, -0.3, 0.4, 0.9, 0.6, -0.2, 0.1, 1.2)
J = (0.8, 0.5, 1.0)
# arguments by their names, in any module and in one; of other kernels in full
NAMES = {
    "u": U, "phi": U, "angles": U, "v": V, "w": W, "f": V, "phidot": W, "derivative": W,
    "q": Q, "p": P, "qdot": P, "target": P, "e": E, "o": E, "inertia": J, "radial": E,
    "along": U, "torque": U, "h": 0.7, "t": 0.7, "s": 0.6,
    "angle_variance": 0.3, "bias_variance": 0.2, "mean_motion": 0.7, "coefficient": 0.7,
    "coefficients": J, "stiffness": 0.7, "damping": 0.3,
}  # fmt: skip
IN_MODULE = {
    "dcm": {"a": B, "b": C, "c": C, "k": 0.5, "r": U, "cdot": B},
    "euler313": {"c": C},
    "quat": {"c": 0.8},
    "rigid": {"e": Q, "m": U, "c": V, "x": 0.7},
    "so3": {"a": B, "b": 0.5, "c": 0.1, "x": W, "z": 1.3},
    "vec3": {"a": U, "b": V, "k": 0.5, "c": 0.8},
}
IN_FULL = {
    "so3.axis_angle_rate": (E, (0.8, 0.1, -0.6), 1.2, 0.7),
    "so3.axis_angle_derivative": (E, 1.2, W),
    "dcm.rotate_first": (C, 0.8, 0.6),
    "dcm.rotate_third": (C, 0.8, 0.6),
    "rigid.kinetic_energy_symmetric": (U, W, (0.8, 1.0)),
    "rigid.saturated": (U, (0.4, 0.4, 0.9)),
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


@each("name", ARGUMENTS)
def test_compiled(name):
    """As for jitted code, where kernels call kernels."""
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
    found = {n: refusal(KERNELS[n], one_integer(x, place)) for n, x in ARGUMENTS.items()}
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
    assert {name for name, _ in functions()} == set(EVERY)


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
