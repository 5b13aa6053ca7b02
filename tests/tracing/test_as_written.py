"""Functions as people write them: the table of the page on custom functions, and other cases."""

from __future__ import annotations

import functools
import importlib.util
import re
from pathlib import Path

import numpy as np
import pytest
from each import each
from numpy.testing import assert_allclose

import fastatt as fa
from fastatt.tracing.user import user_function

PAGE = Path(fa.__file__).parent / "docs" / "guides" / "functions.md"
ROW = re.compile(r"^\| (`(?:return|out|v|gain|mode|x|M).*`|`print.*`) \| (\w+) \|$", re.MULTILINE)
ROWS = [m.groups() for m in ROW.finditer(PAGE.read_text(encoding="utf-8"))]
HEAD = """import math
import numpy as np
M = np.array([[1.0, 0.2, 0.0], [0.1, 2.0, 0.3], [0.0, 0.4, 3.0]])
sides = (0.1, 0.2)
def torque(t, q, w, p):
"""
POINT = 1.3, (0.8, 0.0, -0.6, 0.0), (0.3, -0.7, 0.2), ()


def written(code, path):
    """The function of a row of the table, in a file of its own."""
    lines = [x for part in code.strip("`").split("`<br>`") for x in part.split("; ")]
    path.write_text(HEAD + "".join(f"    {line}\n" for line in lines), encoding="utf-8")
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.torque


def test_the_table_is_found():
    assert len(ROWS) == 20
    assert {says for _, says in ROWS} == {"followed", "called", "refused"}


@each("number", range(len(ROWS)))
def test_the_table_says_what_happens(number, tmp_path):
    code, says = ROWS[number]
    function = written(code, tmp_path / f"row{number}.py")
    if says == "refused":
        with pytest.raises(TypeError, match=r"^torque: .*accepted") as error:
            user_function(function, "torque", 0)
        assert "\n" not in str(error.value)
        return
    made = user_function(function, "torque", 0)
    if says == "called" or np.lib.NumpyVersion(np.__version__) >= "2.0.0":
        assert made.followed == (says == "followed")
    assert_allclose(made.call(*POINT), function(*POINT), rtol=1e-14, atol=1e-15)
    assert "Double" not in repr(made.call(*POINT))


class Controller:
    """As people write one."""

    def __init__(self, gain):
        self.gain = np.diag(gain)
        self.calls = 0

    def own(self, w):
        return self.gain @ np.array(w)

    def torque(self, t, q, w, p):
        return -self.own(w)

    def counting(self, t, q, w, p):
        self.calls += 1
        return -w[0], -w[1], -w[2]

    __call__ = torque


def drag(k, t, q, w, p, *, power=1.0):
    return [-k * power * x for x in w]


def stepped(k, t, q, w, p):
    """No straight line."""
    x = 0.0
    while x * x < abs(w[0]):
        x += k
    return np.array([-x, 0.0, 0.0])


GAIN = (0.3, 0.2, 0.1)
HELD = {
    "bound method": Controller(GAIN).torque,
    "object": Controller(GAIN),
    "partial": functools.partial(drag, 0.2),
    "partial by name": functools.partial(drag, 0.2, power=2.0),
    "partial of a method": functools.partial(Controller.torque, Controller(GAIN)),
    "lambda": lambda t, q, w, p: [-x for x in w],
    "array": lambda t, q, w, p: -np.diag(GAIN) @ np.sin(np.array(w) * t),
}


@each("name", HELD)
def test_what_holds_a_function_is_followed(name):
    made = user_function(HELD[name], "torque", 0)
    assert made.followed
    assert_allclose(made.call(*POINT), HELD[name](*POINT), rtol=1e-15)


def test_a_partial_that_is_no_straight_line_is_refused():
    with pytest.raises(TypeError, match=r"is not followed: a loop whose end .* and not compiled: "):
        user_function(functools.partial(stepped, 0.1), "torque", 0)


def halved(x):
    while x > 1e-3:
        x *= 0.5
    return x


#: functions of one number, which may be in a tuple, a list or an array
ONE = {
    "tuple": lambda t, q, w, p: (w[0] - t,),
    "list": lambda t, q, w, p: [w[0] - t],
    "array": lambda t, q, w, p: np.array([w[0] - t]),
    "tuple, compiled": lambda t, q, w, p: (w[0] - t + 0.0 * halved(abs(w[1])),),
    "list, compiled": lambda t, q, w, p: [w[0] - t + 0.0 * halved(abs(w[1]))],
}


@each("name", ONE)
def test_one_number_may_be_in_a_row(name):
    made = user_function(ONE[name], "event", 0)
    assert made.followed == ("compiled" not in name)
    assert_allclose(made.call(*POINT), 0.3 - 1.3, rtol=1e-15)


def number_and_slope(t, q, w, s, p):
    return 0.01 - s[0], [-s[1]]


def test_the_command_of_one_wheel_may_be_a_tuple():
    for command in (lambda t, q, w, s, p: 0.01 - s[0], lambda t, q, w, s, p: (0.01 - s[0],)):
        wheel = fa.torques.ReactionWheels([[0.0, 0.0, 1.0]], 0.02, command)
        (made,) = fa.Scene(inertia=(2.0, 1.5, 1.0), torque=wheel).functions
        assert made.followed
        assert made.call(*POINT[:3], (0.3,), ()) == 0.01 - 0.3
    of_states = fa.torques.ReactionWheels([[0.0, 0.0, 1.0]], 0.02, number_and_slope, states=1)
    assert fa.Scene(inertia=(2.0, 1.5, 1.0), torque=of_states).functions[0].followed
    two = fa.torques.ReactionWheels([[0.0, 0.0, 1.0]], 0.02, lambda t, q, w, s, p: (t, t))
    with pytest.raises(TypeError, match=r"^command: .* that is tuple of 2; accepted: 1 numbers"):
        fa.Scene(inertia=(2.0, 1.5, 1.0), torque=two)


def test_a_method_that_counts_is_refused():
    with pytest.raises(TypeError, match="the attribute calls, which changes") as error:
        user_function(Controller(GAIN).counting, "torque", 0)
    assert "\n" not in str(error.value)


def test_a_new_scene_sees_a_changed_attribute():
    controller = Controller(GAIN)
    first = user_function(controller.torque, "torque", 0).call(*POINT)
    controller.gain = 2.0 * controller.gain
    again = user_function(controller.torque, "torque", 0).call(*POINT)
    assert_allclose(again, 2.0 * np.array(first), rtol=1e-15)
