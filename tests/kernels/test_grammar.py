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
# arguments for every kernel: a new one needs a line here
ARGUMENTS = {
    "axis_angle.rate": (E, (0.8, 0.1, -0.6), 1.2, 0.7),
    "axis_angle.derivative": (E, 1.2, W),
    "compensated.two_sum": (0.7, 1e-17),
    "compensated.add_vector": ((*U, 1e-17, 0.0, -1e-17), V),
    "compensated.add_quat": ((*Q, 1e-17, 0.0, -1e-17, 0.0), P),
    "compensated.cosine_less_one": (0.8, (0.0, 0.6, 0.0)),
    "compensated.compose": ((*Q, 1e-17, 0.0, -1e-17, 0.0), P),
    "compensated.rotate": ((*Q, 1e-17, 0.0, -1e-17, 0.0), U),
    "compensated.rotate_short": ((*Q, 1e-17, 0.0, -1e-17, 0.0), U),
    "compensated.rotate_parts": ((*Q, 1e-17, 0.0, -1e-17, 0.0), U, 0.49, 0.9, -0.01),
    "coning.rotation_vector": (U, V, W, X, 0.7),
    "coning.rotation_vector_linear": (U, V, 0.7),
    "coning.rotation_vector_quadratic": (U, V, W, 0.7),
    "coning.rates_quadratic": (U, V, W, 0.5, 1.25),
    "coning.rates_cubic": (U, V, W, X, 0.5, 1.25, 2.0),
    "coning.increments_linear": (U, V, 0.5, 0.75),
    "coning.increments_quadratic": (U, V, W, 0.5, 0.75, 1.0),
    "coning.miller": (U, V, W),
    "dcm.mul": (B, C),
    "dcm.add": (B, C),
    "dcm.scale": (0.5, B),
    "dcm.transpose": (B,),
    "dcm.rotate": (C, U),
    "dcm.rotate_inverse": (C, U),
    "dcm.from_quat": (Q,),
    "dcm.to_quat": (C,),
    "dcm.rotate_first": (C, 0.8, 0.6),
    "dcm.rotate_third": (C, 0.8, 0.6),
    "dcm.exp_short": (U,),
    "dcm.exp": (U,),
    "dcm.log": (C,),
    "dcm.derivative_row": (U, W),
    "dcm.derivative": (C, W),
    "dcm.rate": (C, B),
    "two_rows.close_rows": (C[:3], C[3:6]),
    "two_rows.orthonormalise_rows": (B[:3], B[3:6]),
    "dcm.gram": (B,),
    "dcm.norm_error": (B,),
    "dcm.orthonormalise": (B,),
    "elliptic.exp_minus": (1.7,),
    "elliptic.waves": (1.7, 1.0),
    "elliptic.landen_step": (0.7, 1.0, 1.0, 0.4, 0.0),
    "elliptic.ascending_step": (0.7, 0.4),
    "elliptic.first_kind_pair": (0.7, 0.8, 0.3, 0.6),
    "elliptic.cosine_sum": (0.9, 0.2, -0.1, 0.01),
    "elliptic.sine_sum": (0.9, 0.2, -0.1, 0.01),
    "elliptic.cubic": ((0.9, 0.2, -0.1, 0.01), 1.3),
    "elliptic.limited": (50.0,),
    "elliptic.theta_terms": (1.75, 1.1, 0.8),
    "elliptic.select": (1.0, K8, THETA[:8]),
    "elliptic.weighted": (K8, 0.7, -1.0),
    "elliptic.theta_argument": (THETA[16:], 0.6),
    "elliptic.theta_pair": (1.75, 2.0, 0.8),
    "elliptic.theta_pair_at": (THETA, 0.6),
    "elliptic.jacobi": (1.2, 0.7),
    "error_state.transition": (U, 0.7),
    "error_state.noise_at_rest": (0.7, 0.3, 0.2),
    "error_state.noise": (U, 0.7, 0.3, 0.2),
    "error_state.predict": (P6, (C, B), P6),
    "error_state.to_inertial": (C, P6),
    "error_state.to_body": (C, P6),
    "error_state.transition_matrix": ((C, B),),
    "error_state.matrix": (P6,),
    "error_state.blocks": ((*B, *C, *B, *C),),
    "euler313.to_quat": (U,),
    "euler313.from_quat": (Q,),
    "euler313.to_dcm": (U,),
    "euler313.from_dcm": (C,),
    "euler313.rate": (U, W),
    "euler313.derivative": (U, W),
    "free_body.split_product": (0.3, -0.7),
    "free_body.split_difference": (0.3, 0.7),
    "free_body.split_multiply": ((0.3, 1e-17), (-0.7, 1e-17)),
    "free_body.least_scaled": (1e-290,),
    "free_body.scale": (0.7,),
    "free_body.scaled": (V,),
    "free_body.exchange": (P, Q, 1.0),
    "free_body.order": (W, (0.0, 0.0, 0.0), (0.8, 0.5, 1.0)),
    "free_body.handed": ((0.5, -0.3, 0.0, 1.0), (0.8, 0.2, 0.0, 0.0), (1.0, 0.6, 0.0, 2.0)),
    "free_body.to_body": (V, AXES),
    "free_body.pair": (THETA, 0.7),
    "free_body.turned": (Q, 0.5, 0.9),
    "free_body.amplitudes": ((0.5, 0.8, 1.0), (0.3, -0.2, 0.6), 0.05),
    "free_body.begin": (Q, W, (0.0, 0.0, 0.0), (0.8, 0.5, 1.0), 1.0, 1.0),
    "free_body.setup": (Q, W, (0.8, 0.5, 1.0)),
    "free_body.setup_rate": (Q, W, (0.8, 0.5, 1.0)),
    "free_body.evaluate": ((*Q, *AXES, 0.5, 0.9, 0.2, 0.1, 1.6, 0.3, 0.4, *THETA), 0.7),
    "free_body.symmetric_setup": (Q, W, (0.5, 1.0, 0.5)),
    "free_body.symmetric_evaluate": ((*Q, *V, *W, *E, -0.4), 0.7),
    "heavy_top.times": ((0.3, -0.7), (0.5, 0.2)),
    "heavy_top.times_conj": ((0.3, -0.7), (0.5, 0.2)),
    "heavy_top.direction": ((0.3, -0.7),),
    "heavy_top.seen": ((0.3, -0.7),),
    "heavy_top.slope": (K4, 1.3),
    "heavy_top.upright": (V,),
    "heavy_top.roots": (1.2, 0.8, 0.5, 0.6, 0.7, (0.3, -0.4), 1.02, -0.18),
    "heavy_top.ratio": (0.3, 0.7),
    "heavy_top.middle": (K8,),
    "heavy_top.series": ((0.8, 0.4, 0.3, 1.5, 1.7, 0.5, 0.2), 0.7, 0.5, -0.4),
    "heavy_top.parts": ((*THETA, 0.1), (0.3, -0.2, 0.9, 0.2, 0.6), 0.7),
    "heavy_top.matched": ((0.6, 0.0), (0.0, 0.8), (0.3, 0.4), (0.0, 0.6), (0.8, 0.0), (-0.4, 0.3)),
    "heavy_top.setup": (P, W, (1.0, 1.0, 0.5), (0.0, 0.0, 0.7)),
    "heavy_top.evaluate": (
        (*P, 0.6, 0.8, 0.0, 1.0, 0.3, -0.2, 0.9, 0.2, 0.6, 1.1, *THETA, 0.1),
        0.7,
    ),
    "moser_veselov.newton": ((0.01, 0.02, -0.03), (0.01, 0.02, -0.03), (0.2, -1.3, 1.5)),
    "moser_veselov.power_sum": (U,),
    "moser_veselov.squared": (U,),
    "moser_veselov.product": (U, V),
    "moser_veselov.mixed_sum": (U, V),
    "moser_veselov.coefficients2": (J,),
    "moser_veselov.coefficients4": (J,),
    "moser_veselov.coefficients6": (J,),
    "moser_veselov.coefficients8": (J,),
    "moser_veselov.corrections2": (0.1, 0.2, K4),
    "moser_veselov.corrections4": (0.1, 0.2, K6),
    "moser_veselov.corrections6": (0.1, 0.2, K8),
    "moser_veselov.corrections8": (0.1, 0.2, K10),
    "moser_veselov.modified_inverse": (J, 0.01, -0.02),
    "moser_veselov.asymmetry": (J,),
    "moser_veselov.sweep": ((0.05, 0.02, -0.03), (0.04, 0.02, -0.03), (0.6, -0.3, 0.4)),
    "moser_veselov.solve": ((0.04, 0.02, -0.03), (0.6, -0.3, 0.4)),
    "moser_veselov.rotation": (U,),
    "mrp.to_quat": (U,),
    "mrp.from_quat": (Q,),
    "mrp.inner": (U,),
    "mrp.derivative": (U, W),
    "mrp.half_derivative": (U, W),
    "quat.mul": (P, Q),
    "quat.conj": (Q,),
    "quat.dot": (P, Q),
    "quat.rotate": (Q, U),
    "quat.rotate_inverse": (Q, U),
    "quat.rotate_first": (Q, 0.8, 0.6),
    "quat.rotate_third": (Q, 0.8, 0.6),
    "quat.exp_short": (U,),
    "quat.exp": (V,),
    "quat.log": (Q,),
    "quat.normalise": ((*V, 2.0),),
    "quat.renormalise": (Q,),
    "quat.mul_vector": (Q, W),
    "quat.derivative": (Q, W),
    "quat.derivative_inertial": (Q, W),
    "quat.rate": (Q, P),
    "quat.rate_inertial": (Q, P),
    "quat.slerp": (P, Q, 0.3),
    "quat.angle": (P, Q),
    "rigid.saturated": (U, (0.4, 0.4, 0.9)),
    "rigid.sign_of_scalar": (Q,),
    "rigid.momentum": (W, J),
    "rigid.gyroscopic_coefficients": (J,),
    "rigid.gyroscopic": (U, V),
    "rigid.acceleration": (W, J, U),
    "rigid.kinetic_energy": (W, J),
    "rigid.kinetic_energy_symmetric": (U, W, (0.8, 1.0)),
    "rigid.damping": (W, J),
    "rigid.quadratic_damping": (W, 0.7),
    "rigid.gravity_gradient": (E, J, 0.7),
    "rigid.orbit_direction": (1.7, 0.7, E, U),
    "rigid.kepler_correction": (0.2, 0.3, 0.6, 0.8),
    "rigid.kepler_direction": (1.7, 0.3, E, U),
    "rigid.quaternion_feedback": (Q, W, 0.7, 0.3),
    "rigid.target_error": (P, Q),
    "rigid.exp_decay": (0.7,),
    "so3.hat": (U,),
    "so3.vee": (B,),
    "so3.second_order": (0.4, -0.2, U),
    "so3.jacobian_coefficients": (1.3,),
    "so3.second_integral_coefficient": (0.7,),
    "so3.square_integral_coefficient": (1.3,),
    "so3.inverse_coefficient": (1.3,),
    "so3.right_jacobian": (U,),
    "so3.left_jacobian": (U,),
    "so3.right_jacobian_inverse": (U,),
    "so3.left_jacobian_inverse": (U,),
    "so3.dexpinv": (U, W),
    "so3.dexpinv_short": (U, W),
    "so3.second_order_apply": (0.5, 0.1, U, W),
    "so3.dexp": (U, W),
    "so3.turned_integral": (U, V),
    "so3.turned_second_integral": (U, V),
    "sym3.full": (K6,),
    "sym3.upper": (B,),
    "sym3.add": (K6, S6),
    "sym3.scale": (0.5, K6),
    "sym3.product": (B, C),
    "sym3.mul": (B, K6),
    "sym3.congruence": (B, K6),
    "trig.power_of_two": (5.0,),
    "trig.powers_of_two": (-5.0,),
    "trig.octave": (3.0, 5.0, 0.5, 4.0, 16.0),
    "trig.octaves": (5.0, 0.3),
    "trig.log_ratio": (5.0, 0.3, 4.7, 5.3),
    "trig.quarter_turns": (7.0,),
    "trig.within_a_turn": (-1.0,),
    "trig.reduce_powers": (3.7,),
    "trig.short_waves": (0.3, 0.09),
    "trig.reduce_quarters": (8.0,),
    "trig.reduce_turns": (8.0,),
    "trig.is_odd": (3.0,),
    "trig.sincos": (2.5,),
    "trig.sincos_bounded": (2.5,),
    "trig.sincos_short": (0.5, 3.0),
    "trig.half_sinc_cos": (1.3,),
    "trig.half_sinc_cos_wide": (30.0,),
    "trig.sin_remainder": (1.3,),
    "trig.sin_second_remainder": (1.3,),
    "trig.cot_remainder": (1.3,),
    "trig.atan2": (0.4, -0.9),
    "vec3.dot": (U, V),
    "vec3.cross": (U, V),
    "vec3.add": (U, V),
    "vec3.sub": (U, V),
    "vec3.scale": (0.5, U),
    "vec3.axpy": (0.5, U, V),
    "vec3.neg": (U,),
    "vec3.rotate_axes_first": (U, 0.8, 0.6),
    "vec3.rotate_axes_third": (U, 0.8, 0.6),
    "vec3.largest": (V,),
}


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


def test_the_list_of_arguments_is_complete():
    assert sorted(ARGUMENTS) == sorted(KERNELS)


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
