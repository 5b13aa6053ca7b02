"""Tables against the functions that they sample, models that read them against closed forms."""

from __future__ import annotations

import math
import pickle

import numpy as np
import pytest
from each import each
from exact import EPS

import fastatt as fa
from fastatt.attitudes import QUATERNION
from fastatt.codegen.rows import rows
from fastatt.estimation.tangent import own_numbers
from fastatt.scene import forces, models, torque_record, torques
from fastatt.scene.torque_record import CoupledStates, Pose, pack
from fastatt.tracing.user import user_function

RNG = np.random.default_rng(5)
FREQUENCY = np.array([1.0, 2.0, 3.0])
Q0, W0 = (0.5, 0.5, -0.5, 0.5), (0.3, -0.2, 0.4)
INERTIA = (2.0, 1.0, 1.5)


def wave(t):
    return np.sin(np.multiply.outer(t, FREQUENCY))


def wave_slope(t):
    return FREQUENCY * np.cos(np.multiply.outer(t, FREQUENCY))


def uniform(n):
    return np.linspace(1.0, 3.0, n)


def uneven(n):
    """Intervals from half to three halves of the mean, of one pattern for every n."""
    s = np.linspace(0.0, 1.0, n)
    return 1.0 + 2.0 * (s + np.sin(2.0 * np.pi * s) / (4.0 * np.pi))


# name: keywords, order, bound of the error for intervals h
KINDS = {
    "linear": ({"kind": "linear"}, 2, lambda h: h**2 * FREQUENCY**2 / 8.0),
    "cubic": ({}, 4, lambda h: h**4 * FREQUENCY**4 / 384.0 + h**5 * FREQUENCY**5 / 20.0),
    "slopes": ({}, 4, lambda h: h**4 * FREQUENCY**4 / 384.0),
}


def wave_table(times, kind, **more):
    slopes = {"slopes": wave_slope(times)} if kind == "slopes" else {}
    return fa.TimeSeries(times, wave(times), **KINDS[kind][0], **slopes, **more)


@pytest.mark.parametrize("spacing", [uniform, uneven])
@pytest.mark.parametrize("kind", KINDS)
def test_a_table_is_within_its_bound_and_of_its_order(kind, spacing):
    _, order, bound = KINDS[kind]
    t = np.linspace(1.0, 3.0, 4001)
    errors = []
    for n in (41, 81):
        times = spacing(n)
        gap = np.abs(wave_table(times, kind).at(t) - wave(t)).max(axis=0)
        assert (gap <= bound(np.diff(times).max()) + 4 * EPS).all()
        errors.append(gap.max())
    # the second term of the cubic's bound is of the next order: it can only raise the slope
    assert order - 0.1 < math.log2(errors[0] / errors[1]) < order + 1.1


def test_slopes_between_two_samples_each_way_are_of_order_four():
    times = uniform(81)
    h, middle = times[1] - times[0], times[2:-2]
    table = fa.TimeSeries(times, wave(times))
    found = np.array([table.slope(t) for t in middle])
    # values off by EPS, over h
    bound = h**4 * FREQUENCY**5 / 30.0 + 4 * EPS / h
    assert (np.abs(found - wave_slope(middle)).max(axis=0) <= bound).all()


@pytest.mark.parametrize("n", [2, 3, 4, 9])
@pytest.mark.parametrize("spacing", [uniform, uneven])
def test_polynomials_and_their_slopes_are_exact(n, spacing):
    """Of as many samples as determine them, up to the third degree."""
    p = np.polynomial.Polynomial([0.3, -1.0, 0.5, 0.25][: min(n, 4)])
    table = fa.TimeSeries(spacing(n), p(spacing(n)))
    for t in (1.0, 1.3, 2.0, 2.9, 3.0):
        assert abs(table(t) - p(t)) < 32 * EPS
        # differences of values, over the shortest interval
        assert abs(table.slope(t) - p.deriv()(t)) < 32 * EPS * 2.0 * n
    for times in ([1.5], np.array([1.5], np.float16)):
        assert np.array_equal(table.at(times), [[table(1.5)]])


@pytest.mark.parametrize("times", [np.arange(10_001) / 7.0, np.arange(-10_000, 1) / 7.0])
def test_times_that_are_even_to_the_rounding_of_the_largest_need_no_search(times):
    assert fa.TimeSeries(times, times).layout.uniform
    times[5] += 1e-9
    assert not fa.TimeSeries(times, times).layout.uniform


@pytest.mark.parametrize("at", [1, 2, 25, 48, 49, slice(3, 50, 7)])
@pytest.mark.parametrize("short", [3e-6, 2e-4])
def test_samples_that_nearly_coincide_do_not_magnify_noise(at, short):
    times = np.arange(50) / 40.0
    times[at] = times[np.arange(50)[at] - 1] + short
    noise = np.random.default_rng(7).uniform(-1e-3, 1e-3, (50, 2))
    table = fa.TimeSeries(times, 2.0 + noise)
    assert np.abs(table.at(np.linspace(0.0, times[-1], 9999)) - 2.0).max() < 4e-3


@pytest.mark.parametrize(
    "times",
    [0.1 * np.arange(41), uneven(9), 1e9 + 0.25 * np.arange(9), np.linspace(-3.7, 17.9, 99)],
)
def test_a_sample_holds_from_its_time_to_the_next(times):
    """To the last bit of the times, whatever the rounding of their intervals."""
    values = np.arange(1.0, len(times) + 1.0)
    table = fa.TimeSeries(times, values, kind="previous")
    assert np.array_equal(table.t, times)
    assert np.array_equal(table.at(times)[:, 0], values)
    assert np.array_equal(table.at(np.nextafter(times[1:], -np.inf))[:, 0], values[:-1])
    assert table.slope(times[3]) == 0.0
    assert np.isnan(table(times[-1] + 1.0))


@pytest.mark.parametrize("outside", ["nan", "hold"])
@pytest.mark.parametrize("spacing", [uniform, uneven])
@pytest.mark.parametrize("kind", ["linear", "cubic", "previous"])
def test_recorded_numbers_give_what_python_gives(kind, spacing, outside):
    """Outside, at the samples and between, of rows that are there and rows that are not."""
    times = spacing(7)
    table = fa.TimeSeries(times, RNG.normal(size=(3, 7, 2)), kind=kind, outside=outside)
    t = np.concatenate([times, RNG.uniform(0.5, 3.5, 40), [-1e300, 1e300, 0.0, 9.0]])
    row = np.resize([0.0, 1.0, 2.0], t.size)

    def formula(t, p):
        return *table(t, p[0]), *table.slope(t, p[0])

    def traced(t, p):
        return table.traced_at(t, p[0])

    compiled = rows(traced, {"t": None, "p": 1}, (4,))

    def found(t, row):
        return compiled(np.array(t), np.array(row)[:, None], tables={table: table.data})[0]

    known = np.array([formula(*x) for x in zip(t, row[:, None], strict=True)])
    # products fused or not: of some ten terms, of slopes over the shortest interval
    size = np.abs(np.nan_to_num(known)).max()
    assert np.allclose(found(t, row), known, rtol=0, atol=200 * EPS * size, equal_nan=True)
    inside = (t >= 1.0) & (t <= 3.0)
    assert np.isfinite(known[inside]).all()
    if outside == "nan":
        assert np.isnan(known[~inside]).all()
    else:
        ends = np.where(t < 1.0, 1.0, 3.0)[~inside]
        held = [table(*x) for x in zip(ends, row[~inside], strict=True)]
        assert np.array_equal(known[~inside], np.pad(held, ((0, 0), (0, 2))))
    # what is no time and no row
    assert np.isnan(found([2.0, 2.0, 2.0, 2.0], [-1.0, 3.0, 0.5, np.nan])).all()
    assert np.isnan(found([np.nan], [1.0])[:, :2]).all()


# in a scene


def of_table(table):
    def rate(t, p):
        return table(t)

    return rate


def of_rows(table):
    def rate(t, p):
        return table(t, p[0])

    return rate


RUN = {"dt": 0.05, "n_steps": 40, "t0": 1.0, "save_every": 8, "method": "magnus4"}


def test_each_body_reads_its_row():
    times = uniform(21)
    table = fa.TimeSeries(times, RNG.normal(size=(3, 21, 3)))
    rate, row = of_rows(table), np.arange(150.0)[:, None] % 3
    together = fa.propagate(fa.Scene(rate=rate, params=row), [Q0] * 150, **RUN)
    for k in range(3):
        shared = fa.Scene(rate=of_table(fa.TimeSeries(times, table.samples[k])))
        alone = fa.propagate(shared, Q0, **RUN).q[:, None]
        assert fa.angle_between(together.q[:, k::3], alone).max() < 100 * EPS
        assert np.ptp(together.q[:, k::3], axis=1).max() == 0.0


def test_a_time_outside_ends_as_a_status_of_that_body():
    times = uniform(21)
    wheels = fa.TimeSeries(times, wave(times))
    scene = fa.Scene(inertia=INERTIA, torque=torques.Rotor(wheels))
    options = {"dt": 0.05, "method": "rk4"}
    assert not fa.propagate(scene, Q0, W0, t0=1.0, n_steps=40, **options).status.any()
    late = fa.propagate(scene, Q0, W0, t0=1.0, n_steps=41, **options)
    early = fa.propagate(scene, Q0, W0, t0=0.9, n_steps=40, **options)
    for run in (late, early):
        assert run.status[0] == fa.Status.NON_FINITE
        assert np.isnan(run.q[-1]).all()
    # 3 times 0.1 is more than 0.3
    brief = fa.Scene(rate=of_table(fa.TimeSeries([0.0, 0.3], np.ones((2, 3)))))
    assert not fa.propagate(brief, Q0, dt=0.1, n_steps=3, method="rk4").status.any()
    assert fa.propagate(brief, Q0, dt=0.1, n_steps=4, method="rk4").status.any()
    rows_ = np.array([[0.0], [7.0], [1.0]])
    table = fa.TimeSeries(times, RNG.normal(size=(2, 21, 3)))
    none = fa.propagate(fa.Scene(rate=of_rows(table), params=rows_), [Q0] * 3, **RUN)
    assert (none.status != 0).tolist() == [False, True, False]


# models that take tables

FIELDS = [
    (getattr(module, model), name)
    for module in (torques, forces)
    for model in module.__all__
    for name, field in getattr(module, model).fields.items()
    if field.table
]
NUMBERS = {3: (0.4, -0.3, 0.2), 4: Q0, 0: 0.7}


@each(("model", "name"), FIELDS)
@pytest.mark.parametrize("own", [False, True], ids=["shared", "own"])
def test_a_table_that_does_not_change_is_its_number(model, name, own):
    base = {"torque": torque_record.Torque, "force": forces.Force}[model.kind]
    given = {n: NUMBERS[(*field.shape, 0)[0]] for n, field in model.fields.items()}
    if model is torques.QuaternionPD:
        given |= {"stiffness": 0.7, "damping": (0.4, 0.3, 0.2), "limit": None}
    samples = np.tile(np.array(given[name]), (2, 1))
    if own:
        samples = np.stack([2.0 * samples, samples])
    table = fa.TimeSeries([0.0, 4.0], samples)
    with_table = models.pack(model(**{**given, name: table}), base, None)
    plain = models.pack(model(**given), base, None)

    def acting(law):
        def formula(t, q, w, p):
            if base is forces.Force:
                coupled = CoupledStates((0.1, 0.2, 0.3))
                return law.formula(t, Pose(QUATERNION, q, w, coupled=coupled), p)
            return law.formula(t, Pose(QUATERNION, q, w, INERTIA), p)

        return rows(formula, {"t": None, "q": 4, "w": 3, "p": law.count}, (3,))

    at = 1.3, np.array([0.1, 0.7, 0.5, 0.5]), np.array(W0)
    (expected,) = acting(plain.structure)(*at, plain.params)
    params = with_table.params[1] if own else with_table.params
    (found,) = acting(with_table.structure)(*at, params, tables=with_table.tables)
    assert np.abs(found - expected).max() <= 8 * EPS * np.abs(expected).max()


def test_tables_of_several_terms_and_of_a_force_are_apart():
    """A ball turns by the sum of two torques; none of it comes from the force's table."""
    terms = (torques.Constant(steady((0.1, 0.0, 0.0))), torques.Constant(steady((0.2, 0.0, 0.0))))
    scene = fa.Scene(
        inertia=(2.0, 2.0, 2.0), torque=torques.Sum(terms), mass=4.0,
        force=forces.Constant(steady((0.8, 0.0, 0.0))),
    )  # fmt: skip
    run = fa.propagate(
        scene, Q0, (0.0, 0.0, 0.0), v0=(0.0, 0.0, 0.0), dt=0.25, n_steps=8, method="rk4"
    )
    assert np.allclose(run.w[-1], (0.3, 0.0, 0.0), rtol=0, atol=8 * EPS)
    assert np.allclose(run.v[-1], (0.4, 0.0, 0.0), rtol=0, atol=8 * EPS)


def steady(vector):
    return fa.TimeSeries([0.0, 4.0], [vector, vector])


def test_which_row_is_a_bodys_is_no_parameter_of_its_model():
    target = fa.TimeSeries([0.0, 4.0], [[Q0, Q0]] * 3)
    law = pack(torques.QuaternionPD(0.4, 0.3, target), None).structure
    assert list(own_numbers(law)) == [True, True, False]


def test_a_function_is_looked_into_where_its_tables_are():
    table = fa.TimeSeries([100.0, 101.0], [0.1, 0.2])

    def brake(t, q, w, p):
        return -table(t) * w[0], 0.0, 0.0

    found = user_function(brake, "torque", 0)
    assert found.followed
    assert ((found.usual[:, 0] >= 100.0) & (found.usual[:, 0] <= 101.0)).all()


def test_wheels_and_body_keep_their_momentum():
    """h(t) is a cubic, which its table has exactly; the momentum in space is I w + h's."""
    p = [np.polynomial.Polynomial(RNG.normal(size=4) * 0.1) for _ in range(6)]

    def h(t):
        return np.array([f(t) for f in p]).reshape(2, 3, -1).swapaxes(1, 2)

    wheels = fa.TimeSeries(uniform(9), h(uniform(9)))
    scene = fa.Scene(inertia=INERTIA, torque=torques.Rotor(wheels))
    assert not scene.has_potential
    options = {"t0": 1.0, "dt": 0.025, "n_steps": 80, "method": "rk8"}
    run = fa.propagate(scene, [Q0] * 2, [W0] * 2, save_every=16, **options)
    of_body, of_wheels = run.w * INERTIA, h(run.t).swapaxes(0, 1)
    inside = of_body + of_wheels
    total = fa.quat_rotate(run.q, inside)
    assert np.abs(total - total[0]).max() < 1e-12
    assert np.abs(run.w - run.w[0]).max() > 0.1
    parts = [np.linalg.norm(x, axis=-1).max(axis=0) for x in (of_body, of_wheels)]
    change = np.linalg.norm(total - total[0], axis=-1) / np.maximum(*parts)
    assert np.allclose(fa.drift(run, scene).momentum, change, atol=8 * EPS)
    second = fa.propagate(scene[1:], [Q0], [W0], **options)
    assert np.array_equal(second.q[-1], run.q[-1, 1:])


@pytest.mark.parametrize("bodies", [1, 2, 3, 5])
def test_wheels_that_all_bodies_share_keep_momentum(bodies):
    """One table for them, of as many saves as there are bodies too."""
    t = uniform(9)
    wheels = fa.TimeSeries(t, 0.3 * np.stack([np.sin(t), t, 1 + 0 * t], 1))
    scene = fa.Scene(inertia=INERTIA, torque=torques.Rotor(wheels))
    chance = np.random.default_rng(bodies)
    q0, w0 = chance.normal(size=(bodies, 4)), chance.normal(size=(bodies, 3))
    options = {"t0": 1.0, "dt": 0.02, "n_steps": 80, "save_every": 40, "method": "rk8"}
    found = fa.drift(fa.propagate(scene, q0, w0, **options), scene).momentum
    assert found.shape == (3, bodies)
    assert found.max() < 1e-9
    for k in range(bodies):
        one = fa.drift(fa.propagate(scene, q0[k], w0[k], **options), scene).momentum
        assert np.abs(one - found[:, k]).max() < 1e-14


def test_a_controller_takes_the_rate_of_its_target_off():
    """On the target, at the target's rate, it asks for nothing; beside it for what Wie has."""
    axis, speed = np.array([0.6, 0.0, 0.8]), 0.7
    times = np.linspace(0.0, 2.0, 81)
    target = fa.rotation_vector_to_quat(np.multiply.outer(speed * times, axis))
    h = times[1] * speed / 2.0  # of a sample's half turns, all derivatives of which are at most 1
    model = torques.QuaternionPD(0.4, 0.3, fa.TimeSeries(times, 1.7 * target))
    packed = pack(model, None)

    def formula(t, q, w, p):
        return packed.structure.formula(t, Pose(QUATERNION, q, w, INERTIA), p)

    acting = rows(formula, {"t": None, "q": 4, "w": 3, "p": packed.structure.count}, (3,))
    on = fa.rotation_vector_to_quat(1.23 * speed * axis)
    off = fa.rotation_vector_to_quat([0.1, -0.2, 0.3])
    q = np.stack([on, fa.quat_multiply(on, off)])
    w = np.stack([speed * axis, W0])
    (found,) = acting(1.23, q, w, packed.params, tables=packed.tables)
    relative = w[1] - speed * fa.quat_rotate_inverse(off, axis)
    expected = [np.zeros(3), -0.4 * off[1:] - 0.3 * relative]
    # derivatives of a cubic err by h³/24 and by the slopes' h⁴/5 of the derivatives' scale
    assert np.abs(found - expected).max() < 4.0 * (h**3 / 24.0 + h**4 / 5.0)


def test_tables_are_values():
    times, samples = uniform(9), RNG.normal(size=(3, 9, 2))
    table, same = (fa.TimeSeries(times, samples.copy()) for _ in range(2))
    assert table == same == pickle.loads(pickle.dumps(table))
    assert hash(table) == hash(same)
    held = fa.TimeSeries(times, samples, outside="hold")
    assert table != held != fa.TimeSeries(times, samples + 1e-9)
    assert table[[2, 0]](1.1, 1) == table(1.1, 0)
    assert table[1:2](1.1, 0) == table(1.1, 1)
    kept = table(1.1, 0)
    samples[:] = 7.0
    assert table(1.1, 0) == kept
    one, two = (fa.Scene(inertia=INERTIA, torque=torques.Rotor(steady(W0))) for _ in "12")
    assert one == two
    assert one[:1] is one
