"""A scene as a value: its own copies of numbers, equality, some of its bodies, none."""

from __future__ import annotations

import copy
import pickle
from dataclasses import fields, replace

import numpy as np
import pytest
from each import each
from exact import same

import fastatt as fa
from fastatt.scene.models import Model, Sum

N = 5
rng = np.random.default_rng(3)


def given_rate(t, p):
    return p[0] + t, p[1], p[0]


def given_torque(t, q, w, p):
    return p[0] * q[1], p[1], 0.1 * t


def given_force(t, q, w, v, p):
    return p[0], 0.0, 1.0


def vectors(*shape):
    return rng.uniform(0.9, 1.1, (N, *shape))


def tensors():
    moments, turned = vectors(3), fa.quat_to_dcm(fa.rotation_vector_to_quat(vectors(3)))
    found = turned @ (moments[:, :, None] * turned.swapaxes(1, 2))
    return 0.5 * (found + found.swapaxes(1, 2))


def every_torque(w, n, table):
    t = fa.torques
    return t.Sum([
        t.Constant(w), t.ConstantInertial(w), t.Damping(n[:, None]), t.Damping(w),
        t.QuadraticDamping(n), t.GravityGradient(n), t.GravityGradientAt(w, n), t.HeavyTop(w, n),
        t.MagneticDipole(w, w), t.QuaternionPD(n[:, None, None], n[:, None, None]), t.Rotor(w),
        t.Constant(fa.TimeSeries(0.5 * np.arange(7), table, kind="linear")),
        t.Custom(given_torque, w),
    ])  # fmt: skip


OF_TUPLE = fa.torques.QuadraticDamping((0.1, 0.2, 0.3, 0.4, 0.5))
# name: the scene of some arrays, and these
SCENES = {
    "coning": (lambda a, f: fa.Scene(rate=fa.rates.Coning(a, f)), [vectors(), vectors()]),
    "polynomial": (lambda c: fa.Scene(rate=fa.rates.Polynomial(c)), [vectors(4, 3)]),
    "own rate": (lambda p: fa.Scene(rate=given_rate, params=p), [vectors(2)]),
    "shared rate": (lambda p: fa.Scene(rate=given_rate, params=p), [np.array([0.1, 0.2])]),
    "moments": (lambda i: fa.Scene(inertia=i), [vectors(3)]),
    "tensors": (lambda i: fa.Scene(inertia=i), [tensors()]),
    "a tuple for all bodies": (lambda i: fa.Scene(inertia=i, torque=OF_TUPLE), [vectors(3)]),
    "one tensor": (lambda i: fa.Scene(inertia=i), [tensors()[0]]),
    "every torque": (
        lambda i, *a: fa.Scene(inertia=i, torque=every_torque(*a)),
        [vectors(3), vectors(3), vectors(), rng.normal(size=(7, 3))],
    ),
    "shared inertia": (
        lambda c: fa.Scene(inertia=(1.0, 1.1, 0.9), torque=fa.torques.Damping(c)),
        [vectors(1)],
    ),
    "own torque": (
        lambda i, p: fa.Scene(inertia=i, torque=given_torque, params=p),
        [tensors(), vectors(2)],
    ),
    "thrust": (lambda m, f: fa.Scene(inertia=(1, 1, 1), mass=m, force=f), [vectors(), vectors(3)]),
    "drag": (
        lambda m, c, p: fa.Scene(
            rate=fa.rates.Constant((0.1, 0.2, 0.3)), mass=m,
            force=fa.forces.Sum([fa.forces.Drag(c), fa.forces.Custom(given_force, p)]),
        ),
        [np.array(2.0), vectors(), vectors(2)],
    ),
}  # fmt: skip
every_scene = pytest.mark.parametrize("name", SCENES)


def copies(arrays):
    return [a.copy() for a in arrays]


def numbers(scene):
    """All that the engine gets of it."""
    packed = scene.packed(None)
    return [packed.params, *packed.tables.values()]


def arrays_in(value):
    if isinstance(value, np.ndarray):
        yield value
    elif isinstance(value, (tuple, Model)):
        for x in getattr(value, "values", value):
            yield from arrays_in(x)


def held(scene):
    return list(arrays_in(tuple(getattr(scene, field.name) for field in fields(scene))))


@every_scene
def test_a_change_in_place_does_not_reach_a_scene(name):
    """Looked at before the change or not: no half of it is seen."""
    make, arrays = SCENES[name]
    given = copies(arrays)
    scene, asked = make(*given), make(*given)
    numbers(asked)
    expected = numbers(make(*copies(arrays)))
    for a in given:
        a[...] = 7.0
    for one in (scene, asked):
        assert all(map(same, numbers(one), expected))


def test_a_change_in_place_of_a_list_does_not_reach_a_scene():
    moments, terms = [1.0, 1.1, 0.9], [fa.torques.Damping(0.1)]
    scene = fa.Scene(inertia=moments, torque=fa.torques.Sum(terms))
    moments[:] = [2.0, 2.0, 2.0]
    terms.append(fa.torques.Damping(0.2))
    expected = fa.Scene(inertia=(1.0, 1.1, 0.9), torque=Sum((fa.torques.Damping(0.1),)))
    assert scene == expected
    assert all(map(same, numbers(scene), numbers(expected)))


@every_scene
def test_what_a_scene_holds_can_not_be_changed(name):
    """Nor after it was pickled, copied or made anew."""
    make, arrays = SCENES[name]
    scene = make(*arrays)
    for one in (scene, pickle.loads(pickle.dumps(scene)), copy.deepcopy(scene), replace(scene)):
        found = [*held(one), *(arrays_in(one.principal) if one.inertia is not None else ())]
        assert found
        for a in found:
            with pytest.raises(ValueError, match="read-only"):
                a[...] = 7.0
        assert one == scene
        assert all(map(same, numbers(one), numbers(scene)))


# equality


@every_scene
def test_scenes_of_equal_numbers_are_equal(name):
    make, arrays = SCENES[name]
    scene = make(*arrays)
    again = make(*copies(arrays))
    assert scene == again
    assert hash(scene) == hash(again)
    assert {scene: 1}[again] == 1
    for k in range(len(arrays)):
        other = copies(arrays)
        other[k][(-1,) * other[k].ndim] *= 1.0 + 2.0**-40
        if other[k].shape[-2:] == (3, 3):  # another tensor, symmetric as this one
            other[k][..., 2, 2] *= 1.0 + 2.0**-40
        assert make(*other) != scene
    assert scene != "a scene"
    assert (scene == 1.0) is False


def test_numbers_are_equal_whatever_holds_them():
    torque = fa.torques.Damping((0.0, 1, 2))
    one = fa.Scene(inertia=(1, 2, 2), torque=torque)
    for kind in (list, np.array, np.float32):
        other = replace(one, inertia=kind([1.0, 2.0, 2.0]), torque=replace(
            torque, coefficient=kind([-0.0, 1.0, 2.0])
        ))  # fmt: skip
        assert other == one
        assert hash(other) == hash(one)
    assert replace(one, torque=fa.torques.Constant((0.0, 1, 2))) != one
    assert replace(one, inertia=[(1, 2, 2)]) != one
    assert replace(one, allow_unphysical=True) != one


# some of the bodies


@each(*every_scene.args)
@each("bodies", [slice(3), [3, 1], slice(None, None, -2), 2, -1, np.arange(N) > 2])
def test_some_bodies_of_a_scene(name, bodies):
    """Their rows and no others; of moments of three bodies no tensor is made."""
    make, arrays = SCENES[name]
    scene = make(*arrays)
    some = scene[bodies]
    whole = scene.packed(None)
    if whole.params.ndim == 1:
        assert some == scene
        return
    packed = some.packed(None)
    assert packed.structure == whole.structure
    assert same(packed.params, np.ascontiguousarray(whole.params[bodies]))
    assert all(map(same, packed.tables.values(), whole.tables.values()))
    if name == "shared inertia":
        assert some.inertia is not None
        assert np.shape(some.inertia) == (3,)


def test_a_scene_of_many_bodies_is_printed_in_a_line():
    moments = np.random.default_rng(0).uniform(1.0, 1.3, (500, 3))
    scene = fa.Scene(inertia=moments, torque=fa.torques.GravityGradient(np.full(500, 1e-3)))
    text = str(scene)
    assert "\n" not in text
    assert len(text) < 200
    assert text.startswith("Scene(inertia=array([[")
