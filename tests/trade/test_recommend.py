"""Advice: what is recommended meets the tolerance on all bodies, and says what is true of it."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from each import each
from scipy import stats

import fastatt as fa
from fastatt import methods
from fastatt.arrays import normalised
from fastatt.propagation.ensemble import Ensemble
from fastatt.trade import advice, search
from fastatt.trade.coverage import most_beyond
from fastatt.trade.forcing import forcing
from fastatt.trade.ladder import Ladder
from fastatt.trade.measure import Case, Problem
from fastatt.trade.reference import _error_of, reference
from fastatt.trade.search import Point, Search

RNG = np.random.default_rng(6)
N = 700
Q0 = RNG.normal(size=(N, 4))
W0 = RNG.normal(size=(N, 3))
CONING = fa.Scene(rate=fa.rates.Coning(RNG.uniform(0.2, 1.2, N), RNG.uniform(0.5, 2.0, N)))
FREE = fa.Scene(inertia=(2.0, 1.0, 2.0 / 3.0))
INERTIA = RNG.uniform(1.0, 1.4, (N, 3))
GRADIENT = fa.Scene(inertia=INERTIA, torque=fa.torques.GravityGradient(mean_motion=0.3))
T_END = 6.0
# few, as compiling is what takes the time
RATES = ["rk4", "magnus4", "magnus6"]
DOUBLE = {"dtypes": ["float64"]}
SLOW = Q0[:20], 0.1 * W0[:20]


def advised(tol, methods=RATES, **options):
    return fa.recommend(CONING, Q0, t_end=T_END, tol=tol, methods=methods, **DOUBLE, **options)


def acted_on(torque, *params, **options):
    return fa.Scene(inertia=(4.0, 3.0, 2.5), torque=torque, params=params or None, **options)


def error_at_end(scene, bodies, chosen, n, method="rk8"):
    """Of what was advised, beside a run of n steps."""
    run = fa.propagate(scene, *bodies, **chosen.arguments)
    fine = fa.propagate(scene, *bodies, dt=run.t[-1] / n, n_steps=n, method=method)
    return fa.angle_between(run.q[-1], fine.q[-1]).max()


def coning_at(t, bodies=slice(None)):
    angle, frequency = CONING.rate.angle[bodies], CONING.rate.frequency[bodies]
    c, s = np.cos(angle / 2), np.sin(angle / 2)
    phase = frequency * np.atleast_1d(t)[:, None]
    path = np.stack([c + 0 * phase, s * np.cos(phase), s * np.sin(phase), 0 * phase], axis=-1)
    first = np.stack([c, s, 0 * c, 0 * c], axis=-1) * (1, -1, -1, -1)
    return fa.quat_multiply(normalised(Q0[bodies]), fa.quat_multiply(first, path))


def found_error(scene, w0, chosen, exact=None):
    """The largest after any step, of any body; without a closed form beside a fine run by rk8."""
    run = fa.propagate(scene, Q0, w0, save_every=1, n_threads=1, **chosen.arguments)
    assert not run.status.any()
    q = finer(scene, Q0, w0, chosen, 2000) if exact is None else exact(run.t)
    return fa.angle_between(run.q, q).max()


def finer(scene, q0, w0, chosen, n):
    """Attitudes at the steps of what was advised, by n steps or more."""
    k = max(3, -(-n // chosen.n_steps))
    steps = {"dt": chosen.dt / k, "n_steps": k * chosen.n_steps, "save_every": k}
    return fa.propagate(scene, q0, w0, **steps, method="rk8").q


@pytest.mark.parametrize("tol", [1e-3, 1e-6, pytest.param(1e-9, marks=pytest.mark.slow), 1e-12])
def test_the_tolerance_is_met_by_all_bodies_and_not_by_far(tol):
    """The step may be a seventh too small."""
    chosen = advised(tol)
    true = found_error(CONING, None, chosen, coning_at)
    order = fa.METHODS[chosen.method].order
    assert true <= tol
    assert true >= tol / 1.17 ** (2 * order) / 1.1
    assert true <= chosen.expected_error <= tol
    assert (chosen.measured, chosen.n_bodies) == (N, N)
    assert chosen.dt * chosen.n_steps == pytest.approx(T_END, rel=1e-15)
    assert chosen.expected_seconds > 0.0
    assert chosen.limited_by == "truncation"


# which its controller brings to rest at a target: in the end every step is right
SETTLING = fa.Scene(inertia=(2.0, 1.5, 1.0), torque=fa.torques.QuaternionPD(0.3, 0.5))
SETTLED = {"tol": 1e-3, "methods": ["rk4"], "sample": 64}
LEANING = fa.rotation_vector_to_quat(np.random.default_rng(1).uniform(-1.0, 1.0, (40, 3)))


@pytest.mark.parametrize("t_end", [200.0, 1600.0])
def test_what_settles_is_right_on_the_way(t_end):
    """Of a long run too; its end alone would forgive any step that is stable."""
    start = LEANING, 0.02 * W0[:40]
    chosen = fa.recommend(SETTLING, *start, t_end=t_end, **SETTLED, **DOUBLE)
    run = fa.propagate(SETTLING, *start, save_every=1, **chosen.arguments)
    fine = finer(SETTLING, *start, chosen, 4000)
    assert 1e-4 < fa.angle_between(run.q, fine).max() <= 1e-3


def slow_but(rows, factor, slower):
    w0 = slower * W0
    w0[rows] *= factor
    return w0


def under_gradient(w0, **options):
    return fa.recommend(GRADIENT, Q0, w0, t_end=T_END, tol=1e-6, methods=["rk8"], **options)


def test_hard_bodies_that_are_few_are_found():
    """Three bodies among 700 spin thirty times as fast as the others."""
    w0 = slow_but([50, 333, 699], 30.0, 0.1)
    assert found_error(GRADIENT, w0, under_gradient(w0, sample=64)) <= 1e-6


def test_bodies_are_chosen_where_few_can_be_screened(monkeypatch):
    """As of long runs: no more than the sample, half of them the fastest of all."""
    monkeypatch.setattr(search, "_SCREENED", 0.0)
    w0 = slow_but(123, 20.0, 1.0)
    chosen = under_gradient(w0, sample=256)
    assert chosen.measured >= 256
    assert found_error(GRADIENT, w0, chosen) <= 1e-6


def test_a_sample_of_easy_bodies_is_corrected_by_the_others(monkeypatch):
    """What is recommended is run on the others, too."""
    w0 = W0 * np.linspace(0.1, 1.0, N)[:, None]
    rows = np.arange(64), np.arange(N - 1, 63, -1)
    monkeypatch.setattr(Search, "_choose", lambda *a: (*rows, np.arange(0), 0))
    chosen = under_gradient(w0)
    assert chosen.measured == N
    assert 1e-7 < found_error(GRADIENT, w0, chosen) <= 1e-6


def test_the_closed_form_needs_no_steps():
    options = {"methods": ["rk4", "exact"], "rng": np.random.default_rng(1), **DOUBLE}
    chosen = fa.recommend(FREE, Q0, W0, t_end=T_END, tol=1e-9, **options)
    assert (chosen.method, chosen.n_steps, chosen.limited_by) == ("exact", 1, "round-off")
    assert chosen.expected_error < 1e-12
    assert found_error(FREE, W0, chosen) < 1e-12


def test_long_runs_are_measured_on_fewer_bodies(monkeypatch):
    """Over all of their time."""
    monkeypatch.setattr(search, "_LONG", 1.5e4)
    monkeypatch.setattr(search, "_VERIFIED", 0.0)
    long = 400.0
    chosen = fa.recommend(CONING, Q0, t_end=long, tol=1e-5, methods=["magnus4"], **DOUBLE)
    assert 8 <= chosen.measured < 64
    assert chosen.expected_error <= 1e-5 / 1.5
    run = fa.propagate(CONING, Q0, **chosen.arguments)
    assert 1e-6 < fa.angle_between(run.q[-1], coning_at(long)[0]).max() <= 1e-5


def test_steps_end_at_the_samples_of_a_torque():
    """A kink within a step costs far more."""
    t = np.linspace(0.0, T_END, 25)
    torque = 0.3 * np.sin(2.0 * t)[:, None] * (1.0, 0.5, 0.2)
    table = fa.TimeSeries(t, torque, kind="linear")
    scene = fa.Scene(inertia=(2.0, 1.0, 1.5), torque=fa.torques.Constant(table))
    chosen = fa.recommend(scene, Q0[:64], W0[:64], t_end=T_END, tol=1e-3, methods=["rk4"], **DOUBLE)
    assert chosen.n_steps % 24 == 0


def test_a_method_of_ones_own_is_recommended():
    """Alone, and beside a name that it cannot beat."""
    heun = fa.runge_kutta("heun", order=2, c=(0, 1), a=((1,),), b=(0.5, 0.5))
    few = slice(0, 40)
    given = (CONING[few], Q0[few])
    alone, both = (
        fa.recommend(*given, t_end=T_END, tol=tol, methods=methods, **DOUBLE)
        for tol, methods in ((1e-4, [heun]), (1e-7, [heun, "magnus4"]))
    )
    assert alone.method == "heun"
    assert str(alone).startswith("heun (quat, float64): ")
    run = fa.propagate(*given, **alone.arguments)
    assert run.record is heun
    assert fa.angle_between(run.q[-1], coning_at(T_END, few)[0]).max() <= 1e-4
    assert both.method == both.arguments["method"] == "magnus4"


def test_text_names_what_matters():
    chosen = advised(1e-6)
    up = Point(Case("rk4"), 100, 1e-7, N, 2.0 * chosen.expected_seconds)
    text = str(replace(chosen, runner_up=up))
    near = up._replace(seconds=1.09 * chosen.expected_seconds)
    assert "runner-up  rk4 (quat, float64), 100 steps: as fast\n" in str(
        replace(chosen, runner_up=near)
    )
    for part in (
        f"{chosen.method} (quat, float64): {chosen.n_steps} steps",
        "tol 1e-06",
        f"{chosen.expected_error:.1e} rad at most over the run, measured over 700 of 700 bodies",
        "limited by truncation",
        "runner-up  rk4 (quat, float64), 100 steps: 2.00 times as long",
        "reference  gauss12 at ",
    ):
        assert part in text


@each(("tried_on", "is_tried"), [(None, True), (("free",), False), (("torqued",), True)])
def test_a_new_method_is_tried_unless_its_record_says_otherwise(tried_on, is_tried, monkeypatch):
    new = replace(fa.METHODS["rk8"], name="new", tried_on=tried_on)
    known, asked = methods._defined_in, []
    monkeypatch.setitem(methods._FILES, "new", "new")
    monkeypatch.setattr(
        methods, "_defined_in", lambda file: {"new": new} if file == "new" else known(file)
    )

    def stop(scene, names, *others):
        asked.extend(names)
        raise StopIteration

    monkeypatch.setattr(advice, "cases_of", stop)
    with pytest.raises(StopIteration):
        fa.recommend(GRADIENT, Q0, W0, t_end=T_END, tol=1e-6)
    usual = {"rk4", "rk8", "rk9", "gbs16", "strang2", "kahan_li8"}
    assert set(asked) == (usual | {"new"} if is_tried else usual)


def test_the_error_of_a_closed_form_is_estimated():
    """In double precision it is compared with itself, and in single precision measured."""
    free = fa.Scene(inertia=(2.0, 1.0, 0.7))
    options = {"t_end": 5.0, "tol": 1e-4, "methods": ["exact"]}
    for dtype, word in (("float64", "estimated"), ("float32", "measured")):
        found = fa.recommend(free, Q0[:3], W0[:3], dtypes=[dtype], **options)
        assert f"over the run, {word} over 3 of 3 bodies" in str(found)
        assert (found.expected_error == found.reference_error) == (word == "estimated")


@each("t0", [-20.0, 1.7e9])
def test_t_end_is_a_time(t0):
    scene, start = fa.Scene(inertia=(2.0, 1.0, 0.7)), (Q0[:4], W0[:4])
    options = {"tol": 1e-5, "t0": t0, "t_end": t0 + 5.0}
    chosen = fa.recommend(scene, *start, methods=["rk8"], **DOUBLE, **options)
    assert chosen.dt * chosen.n_steps == pytest.approx(5.0, rel=1e-12)
    known = fa.closed_form.free_body(*start, scene.inertia, 5.0)[0]
    run = fa.propagate(scene, *start, **chosen.arguments)
    assert run.t[-1] == pytest.approx(t0 + 5.0, rel=1e-15)
    assert fa.angle_between(run.q[-1], known).max() < 1e-5
    own = fa.per_body_steps(scene, *start, method="rk8", **options)
    assert own.dt * own.n_steps == pytest.approx(5.0, rel=1e-12)


# bodies that advice was not measured on, or that nobody can know

UNEQUAL = (2.0, 1.4, 1.0)
# three bodies rotate far faster than the others
FAST = 0.3 * W0
FAST[[5, 333, 699]] *= 30.0
either = pytest.mark.parametrize("function", [fa.recommend, fa.per_body_steps])


def by_rk8(function, *bodies, **options):
    methods = {"method": "rk8"} if function is fa.per_body_steps else {"methods": ["rk8"], **DOUBLE}
    return function(*bodies, **methods, **options)


def covered(function=fa.recommend, w0=FAST, **options):
    return by_rk8(
        function, GRADIENT, Q0, w0, **{"t_end": T_END, "tol": 1e-6, "sample": 64, **options}
    )


def test_the_bodies_most_at_risk_are_in_the_sample(monkeypatch):
    """The fastest, the nearest to the separatrix, and the stiffest, where few can be screened."""
    monkeypatch.setattr(search, "_SCREENED", 3e4)
    damping = np.full((N, 1), 1e-3)
    damping[77] = 0.5
    w0 = np.tile([0.2, 0.02, 0.01], (N, 1)) * np.random.default_rng(3).uniform(0.9, 1.0, (N, 1))
    w0[[3, 4]] = (0.0, 0.15, 1e-6), (0.9, 0.0, 0.0)
    scene = fa.Scene(inertia=UNEQUAL, torque=fa.torques.Damping(damping))
    chosen = Search(Problem(Ensemble(scene, Q0, w0), 30.0), 32, np.random.default_rng(1), 1e-3)
    assert {3, 4, 77} <= set(chosen.rows)
    assert chosen.rows.size < 50


@each(("beyond", "random"), [(0, 59), (0, 400), (3, 400), (20, 20), (1, 10_000)])
def test_the_share_is_that_of_clopper_and_pearson(beyond, random):
    known = 1.0 if beyond == random else stats.beta.ppf(0.95, beyond + 1, random - beyond)
    assert most_beyond(beyond, random, 10**6) == pytest.approx(known, rel=1e-9)
    assert most_beyond(beyond, random, random) == beyond / random


@either
def test_a_share_of_bodies_may_exceed_the_tolerance_and_is_counted(function):
    """Three of 700: steps for 0.98 of the bodies are fewer, and leave them out."""
    of_all, of_most = (
        covered(function, quantile=part, all_bodies=True, sample=400) for part in (1.0, 0.98)
    )
    assert (of_all.exceeding, of_all.exceeding_share, of_all.measured) == (0, 0.0, N)
    assert np.max(of_most.n_steps) <= np.max(of_all.n_steps)
    run = fa.propagate(GRADIENT, Q0, FAST, **of_most.arguments)
    fine = fa.propagate(GRADIENT, Q0, FAST, dt=6.0 / 4000, n_steps=4000, method="rk8")
    errors = fa.angle_between(run.q[-1], fine.q[-1])
    assert of_most.exceeding == pytest.approx((errors > 1e-6).sum(), abs=2)
    if function is fa.recommend:
        assert of_most.n_steps < 0.5 * of_all.n_steps
        assert of_most.exceeding >= 3
        assert of_most.worst_body in {5, 333, 699}
        assert f"{of_most.exceeding} of 700 bodies exceed tol, beside a run" in str(of_most)


def test_what_is_unknown_of_others_is_told(monkeypatch):
    monkeypatch.setattr(search, "_VERIFIED", 0.0)
    found = covered(w0=0.1 * FAST)
    assert found.measured < N
    assert 0.01 < found.exceeding_share < 0.1
    share = f"at most {100 * found.exceeding_share:.2g} % of the bodies exceed tol, with 95 %"
    assert share in str(found)
    assert f"most of body {found.worst_body};" in str(found)


@either
def test_chaotic_bodies_are_named_and_set_aside(function):
    """Whose end the last digits of the initial rate decide."""
    n, t_end = 8, 80.0
    rng = np.random.default_rng(3)
    q0, w0 = rng.normal(size=(40, 4))[8:16], rng.normal(0.0, 0.7, (40, 3))[8:16]
    scene = fa.Scene(inertia=UNEQUAL, torque=fa.torques.GravityGradient(1.0))
    found = by_rk8(function, scene, q0, w0, t_end=t_end, tol=1e-4)
    assert 0 < len(found.undetermined) < n
    assert found.exceeding_share == len(found.undetermined) / n
    ends = [
        fa.propagate(scene, q0, w * w0, dt=t_end / 8000, n_steps=8000, method="rk8").q[-1]
        for w in (1.0, 1.0 + 1e-14)
    ]
    moved = fa.angle_between(*ends)
    lost = np.isin(np.arange(n), found.undetermined)
    assert moved[lost].min() > max(1e-5, moved[~lost].max())
    assert f"not determined by double precision: body {found.undetermined[0]}" in str(found)


# torques that are not smooth


def jet(t, q, w, p):
    return (p[0] if p[1] < t < p[2] else 0.0), 0.0, -0.1 * w[2]


def test_a_torque_that_jumps_is_not_taken_for_smooth():
    """Of high order is what changes with the step by chance: the declared order says nothing."""
    scene = acted_on(jet, 3.0, 1.03, 1.31)
    rng = np.random.default_rng(5)
    q, w = q0, w0 = rng.normal(size=(128, 4)), rng.normal(0.0, 1.0, (128, 3))
    for push, duration in ((0.0, 1.03), (3.0, 0.28), (0.0, 3.69)):  # from jump to jump
        part = acted_on(jet, push, -1.0, 9.0)
        run = fa.propagate(part, q, w, dt=duration / 400, n_steps=400, method="rk8")
        q, w = run.q[-1], run.w[-1]
    known = reference(Problem(Ensemble(scene, q0, w0), 5.0))
    assert known.error.max() < 5e-3
    assert known.jump.startswith("the torque jumps near t = 1.")
    assert (fa.angle_between(known.end.q, q) <= 2.0 * known.error).all()


def pulse(t, q, w, p):
    return (1.0 if p[0] < t < p[1] else 0.0), 0.0, 0.0


def corner(t, q, w, p):
    return min(max(t - p[0], 0.0), 1.0), 0.0, 0.0


@pytest.mark.parametrize("end", [5.4, 5.005])
def test_a_pulse_is_refused_with_its_time(end):
    """Shorter than a step it is seen all the same, and no single step is "round-off"."""
    words = r"the torque jumps near t = 5\S* s \(body \d+\), .*fa.Scene\(..., breakpoints=times\)"
    for tol in (1e-4, 1e-2):
        with pytest.raises(ValueError, match=words):
            fa.recommend(acted_on(pulse, 5.0, end), *SLOW, t_end=10.0, tol=tol, methods=["gbs16"])


def friction(t, q, w, p):
    return (-p[0] if w[0] > 0.0 else p[0]), 0.0, 0.0


@pytest.mark.parametrize("t0", [0.0, 1e6])
def test_a_jump_with_the_state_is_told_from_one_in_time(t0):
    """Friction of constant size reverses where the rotation does, at no time known beforehand."""
    scene = acted_on(friction, 0.02)
    words = r"the torque jumps with the state near t = \d.* \(body 0\), .*smooth.*Sampled.*event"
    with pytest.raises(ValueError, match=words) as caught:
        fa.recommend(
            scene, Q0[:1], (0.3, 0.3, 1.5), t_end=t0 + 10.0, t0=t0, tol=1e-4, methods=["rk8"]
        )
    assert "breakpoints" not in str(caught.value)


@either
def test_a_pulse_of_one_body_of_many_is_refused(function):
    """The body is the only one of 4000 whose parameter is not 0, and the pulse is short."""
    params = np.full((4000, 3), (0.0, 5.0, 5.002))
    params[2501, 0] = 1.0
    scene = fa.Scene(inertia=(4.0, 3.0, 2.5), torque=jet, params=params)
    w0 = np.random.default_rng(4).normal(0.0, 0.3, (4000, 3))
    with pytest.raises(ValueError, match=r"the torque jumps near t = 5\S* s \(body 2501\)"):
        by_rk8(function, scene, (1, 0, 0, 0), w0, t_end=10.0, tol=1e-4)


@pytest.mark.parametrize("end", [5.4, 5.005])
def test_a_pulse_between_breakpoints_is_accepted(end):
    """Advice and per-body steps keep their promise; another jump is refused still."""
    scene = acted_on(pulse, 5.0, end, breakpoints=(5.0, end))
    rounding = 1e-13  # of the finer run
    for chosen in (
        fa.recommend(scene, *SLOW, t_end=10.0, tol=1e-9, methods=["rk4", "rk8"], **DOUBLE),
        fa.per_body_steps(scene, *SLOW, t_end=10.0, tol=1e-9, method="rk8"),
    ):
        error = error_at_end(scene, SLOW, chosen, 1000, "rk9")
        assert error - rounding <= chosen.expected_error <= 1e-9
    half = acted_on(pulse, 5.0, end, breakpoints=5.0)
    with pytest.raises(ValueError, match=r"the torque jumps near t = 5"):
        fa.recommend(half, *SLOW, t_end=10.0, tol=1e-4, methods=["rk8"])


CORNER = acted_on(corner, 3.1)


def test_a_corner_is_refused_below_what_the_reference_reaches():
    """An error that falls by order 2 in place of 8 is a finding; above it advice is kept."""
    options = {"t_end": 10.0, "methods": ["rk4"], **DOUBLE}
    chosen = fa.recommend(CORNER, *SLOW, tol=1e-3, **options)
    assert error_at_end(CORNER, SLOW, chosen, 10_000) <= chosen.expected_error <= 1e-3
    words = (
        r"tol: found 1e-12; accepted: at least .* halving its step size divides its error by "
        r".*, where order 8 predicts 256.* fa\.Scene\(\.\.\., breakpoints=times\)"
    )
    with pytest.raises(ValueError, match=words):
        fa.recommend(CORNER, *SLOW, tol=1e-12, **options)
    with pytest.raises(ValueError, match=words):
        fa.per_body_steps(CORNER, Q0[:4], 0.1 * W0[:4], t_end=10.0, tol=1e-12, method="rk8")


@each(
    ("unresolved", "errors", "limit"),
    [
        (1e-9, (1.5e-9, 1e-9), "reference"),
        (0.0, (1.5e-9, 1e-9), "round-off"),
        (1e-9, (4e-9, 3e-9), "truncation"),
        (0.0, (2e-14, 3e-14), "round-off"),
    ],
)
def test_the_error_of_the_reference_is_not_called_round_off(unresolved, errors, limit):
    """Of an error that half the step size does not reduce, beside a reference's own 1e-9 rad."""
    one, case = object.__new__(Search), Case("rk8")
    one.whole = Problem(Ensemble(GRADIENT, Q0, W0), T_END)
    one.known = SimpleNamespace(unresolved=np.array([unresolved]), error=np.array([1e-9]))
    one.errors = {(case, n): np.array([x]) for n, x in zip((10, 20), errors, strict=True)}
    one.quantile = 1.0
    assert one.limit(case, 10) == limit


def test_the_error_across_a_corner_is_of_truncation():
    """It falls by order 2 and irregularly."""
    coarse = fa.recommend(CORNER, *SLOW, t_end=10.0, tol=1e-3, methods=["rk8"], **DOUBLE)
    assert coarse.reference_error < 0.1 * coarse.expected_error
    assert coarse.limited_by == "truncation"


@each("t_end", [1e15, 1e300])
@each("scene", [FREE, CONING, fa.Scene(rate=fa.rates.Constant((0.0, 0.0, 1.0)))])
def test_a_duration_after_which_no_attitude_is_known_is_refused(scene, t_end):
    message = r"^t_end: found 1e\+.*; accepted: at most \d.* s after t0, in which .* by 1e\+12 rad"
    w0 = W0 if scene is FREE else None
    for function, options in [
        (fa.recommend, {"tol": 1e-6}),
        (fa.work_precision, {}),
        *([(fa.per_body_steps, {"tol": 1e-6})] if scene is FREE else []),
    ]:
        with pytest.raises(ValueError, match=message):
            function(scene, Q0, w0, t_end=t_end, **options)


def shot(t, q, w, p):
    return math.exp(-(((t - 5.01) / 0.004) ** 2)), 0.0, 0.0


def test_steps_of_the_reference_resolve_what_acts():
    """A smooth pulse that large steps would miss, each of them."""
    problem = Problem(Ensemble(acted_on(shot), Q0[:9], 0.1 * W0[:9]), 10.0)
    found = forcing(problem, Case("rk8"), 10)
    assert 1000 < found.steps < 20_000
    assert not found.jump
    known = reference(problem, goal=1e-6)
    fine = problem.run(Case("rk4"), 100_000)
    assert fa.angle_between(known.end.q, fine.q[-1]).max() < 1e-9


class Falling(Ladder):
    """Changes that were found by halving, rad, and a floor of rounding."""

    floor = 1e-12

    def __init__(self, *changes):
        self.changes = [np.array([change]) for change in changes]


@each(
    ("changes", "own", "settled", "doubted"),
    [
        ((1e-3, 1e-5, 5e-8, 2e-10), 2e-10, True, False),  # order 8, to the goal
        ((1e-3, 4e-6, 1e-8), 1e-8, False, False),
        ((1e-5, 3e-8, 1e-13), 1e-13, True, False),  # order 8, to rounding
        ((1e-13, 2e-13), 2e-13, True, False),
        ((8e-8, 5e-9, 3e-9, 3e-14), 3e-9, False, True),  # by chance, of a corner
        ((1e-5, 1e-13), 1e-5, False, True),
        ((4e-11, 2e-11, 1e-11), 4e-11, True, True),  # of order 1, far enough below
        ((3e-8, 4e-8, 2e-8, 3e-8), 1.6e-7, True, True),  # rounding that grows
        ((1e-3, 5e-4, 2.5e-4, 1e-4), 4e-4, False, True),
        ((3.14, 0.36, 7.5e-4), 7.5e-4, False, False),  # order 8, all angles alike before
    ],
)
def test_a_reference_is_trusted_where_its_error_falls_as_it_should(changes, own, settled, doubted):
    found, enough, doubt = _error_of(Falling(*changes), 8, 1e-9)
    assert found == pytest.approx([own])
    assert (enough, bool(doubt)) == (settled, doubted)


@pytest.mark.parametrize(
    ("size", "power", "share"), [(1e-5, 2, 2e-3), (1e-4, 1, 0.02), (1e-8, 0, 6e-3)]
)
def test_a_doubted_error_is_seldom_larger_than_estimated(size, power, share):
    """At corners, at jumps, and of rounding: errors of random size that fall by a power at most."""
    rng = np.random.default_rng(3)
    random = rng.normal(size=(5, 4000)) if power == 0 else rng.uniform(-1.0, 1.0, (5, 4000))
    errors = size * random * 0.5 ** (power * np.arange(5.0))[:, None]
    ladder = Falling()
    ladder.changes = list(np.abs(np.diff(errors, axis=0)))
    estimate, _, doubt = _error_of(ladder, 8, 0.0)
    assert doubt
    assert (np.abs(errors[-1]) > estimate).mean() < share
    assert np.median(estimate / np.abs(errors[-1])) < 30.0
