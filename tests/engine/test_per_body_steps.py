"""Steps of each body's own, and saves at any times."""

import numpy as np
import pytest
from each import in_tiers

import fastatt as fa
from fastatt import angle_between as angle
from fastatt.trade.measure import Problem

N = 70  # more than a tile
CHANCE = np.random.default_rng(7)
Q0, W0 = CHANCE.normal(size=(N, 4)), CHANCE.normal(size=(N, 3))
COUNTS = CHANCE.integers(20, 90, size=N)
COUNTS[33] = 45  # 0.4 s is on its grid, on no neighbour's
END = 1.5
STEPS = END / COUNTS
SCENES = {
    "free": fa.Scene(inertia=(2.0, 1.0, 1.5)),
    "torqued": fa.Scene(inertia=(2.0, 1.0, 1.5), torque=fa.torques.GravityGradient(0.3)),
    "rate": fa.Scene(rate=fa.rates.Coning(0.4, 1.3)),
    "spin": fa.Scene(rate=fa.rates.Constant((0.3, 0.2, 9.0))),
}


def run(kind, method, rows=slice(None), **options):
    scene = SCENES[kind]
    w0 = None if scene.kind == "rate" else W0[rows]
    return fa.propagate(scene, Q0[rows], w0, method=method, **options)


@pytest.mark.parametrize(
    ("kind", "method"),
    [("torqued", "rk4"), ("torqued", "kahan_li8"), ("free", "dmv10"), ("spin", "magnus4")],
)
def test_a_save_between_is_one_shorter_step(kind, method):
    """As far from the truth as whole steps are; on the grid the same bits."""
    n, at = 30, [0.05, 0.513, 1.0, END]
    between = run(kind, method, dt=END / n, n_steps=n, save_at=at)
    grid = run(kind, method, dt=END / n, n_steps=n, save_every=5)
    assert (between.t == at).all()
    assert (between.state[2] == grid.state[4]).all()
    assert (between.state[-1] == grid.state[-1]).all()
    best = "magnus6" if SCENES[kind].kind == "rate" else "rk8"
    truth = run(kind, best, dt=0.513 / 150, n_steps=150)
    whole = run(kind, method, dt=0.513 / 10, n_steps=10)  # steps of about the same size
    allowed = 4.0 * angle(whole.q[-1], truth.q[-1]).max() + 1e-13
    assert angle(between.q[1], truth.q[-1]).max() < allowed


@pytest.mark.parametrize("method", ["magnus4", "lie_midpoint"])
def test_a_shorter_step_may_turn_past_half_a_turn(method):
    """Of a constant rate one exponential is the answer, by 4 rad too."""
    rate = np.array([1.0, 2.0, -3.7])
    scene = fa.Scene(rate=fa.rates.Constant(rate))
    counts = np.array([2, 3, 4])
    options = {"dt": 3.0 / counts, "n_steps": counts, "save_at": [0.9, 2.5], "method": method}
    found = fa.propagate(scene, Q0[:3], **options)
    for k, t in enumerate(found.t):
        turned = fa.quat_multiply(Q0[:3], fa.rotation_vector_to_quat(rate * t))
        assert angle(found.q[k], turned).max() < 1e-14


def test_backwards_and_from_another_epoch():
    steps = {"n_steps": COUNTS, "method": "magnus6"}
    there = run("rate", dt=STEPS, **steps)
    back = fa.propagate(SCENES["rate"], there.q[-1], dt=-STEPS, t0=END, save_at=[0.7, 0.0], **steps)
    start = Q0 / np.linalg.norm(Q0, axis=1)[:, None]
    assert angle(back.q[-1], start).max() < 1e-12  # magnus6 undoes its own steps
    # a free body does not know when it is
    steps, at = {"dt": STEPS, "n_steps": COUNTS, "method": "rk4"}, np.array([0.4, END])
    here = run("free", **steps, save_at=at)
    for t0 in (3.0, 1.7e9):
        assert (run("free", **steps, t0=t0).q[-1] == here.q[-1]).all()
        assert (run("free", **steps, t0=t0, save_at=t0 + at[1:]).q[-1] == here.q[-1]).all()


def test_times_to_rounding_are_those_of_steps():
    """What a sum of steps, or the time since 1970, is off by takes no further step."""
    counts = np.arange(60, 200)
    assert (counts * (1.0 / counts) != 1.0).any()
    spins = np.tile([30.0, 20.0, 10.0], (counts.size, 1))

    def of(counts, w0, **options):
        steps = {"dt": 1.0 / counts, "n_steps": counts, "method": "rk4"}
        return fa.propagate(SCENES["free"], Q0[0], w0, **steps, **options).state

    assert (of(counts, spins, save_at=[1.0]) == of(counts, spins)).all()
    for n in (49, 98, 103):  # whose end is an ulp before 1
        assert n * (1.0 / n) < 1.0
        assert (of(n, spins[0], save_at=[1.0]) == of(n, spins[0])).all()
    steps = {"dt": 0.01, "n_steps": 60, "method": "rk4"}
    grid = fa.propagate(SCENES["free"], Q0[0], spins[0], save_every=1, **steps)
    for t0 in (0.0, 0.7, 1.7e9):
        at = t0 + 0.01 * np.arange(61)
        late = fa.propagate(SCENES["free"], Q0[0], spins[0], save_at=at, t0=t0, **steps)
        after = late.t - t0 >= grid.t  # to rounding; what comes before takes nearly a step more
        assert after.sum() > 10
        assert (late.state[after] == grid.state[after]).all()
        assert angle(late.q, grid.q).max() < 40.0 * 2.0**-52 * max(1.0, t0)


def test_steps_past_the_limit_are_the_bodys_own():
    counts = np.where(np.arange(N) == 4, 2, 400)
    w0 = np.tile([0.0, 0.0, 4.0], (N, 1))
    with pytest.warns(fa.StepWarning, match=r"a step of body 4 is .*1 of 70 bodies"):
        found = fa.propagate(SCENES["free"], Q0, w0, dt=2.0 / counts, n_steps=counts, method="rk4")
    assert np.flatnonzero(found.status).tolist() == [4]


def test_a_warning_after_the_run_names_the_body_with_the_largest_step():
    """Of rates that are given nothing is said before it: angles are those of the bodies' order."""
    rates = np.tile([0.0, 0.0, 1.0], (N, 1))
    rates[60] *= 150.0
    scene = fa.Scene(rate=lambda t, p: (p[0], p[1], p[2] * np.cos(t)), params=rates)
    counts = 30 + np.arange(N)
    told = (
        r"a step of body 60 is 2\.5 rad, rk4's limit is 1\.7 \(1 of 70 bodies .*\|dt\| <= 0\.0113"
    )
    with pytest.warns(fa.StepWarning, match=told):
        found = fa.propagate(scene, Q0, dt=END / counts, n_steps=counts, method="rk4")
    assert np.flatnonzero(found.status).tolist() == [60]


@pytest.mark.parametrize("breakpoints", [(), (0.45 * END,)])
@pytest.mark.parametrize("kind", ["rate", "torque"])
def test_a_body_that_waits_is_not_judged(kind, breakpoints):
    """While it waits its lane goes on, to times when this rate is beyond any method."""
    acting = {
        "rate": {"rate": fa.rates.Polynomial([[0.1, 0.0, 0.0], [0.0, 0.0, 1.0]])},
        "torque": {"inertia": (1.0, 1.0, 1.0), "torque": late, "params": (4.0,)},
    }
    scene = fa.Scene(**acting[kind], breakpoints=breakpoints)
    counts = np.where(np.arange(N) == 4, 15, 400)
    w0 = None if kind == "rate" else 0.1 * W0
    found = fa.propagate(scene, Q0, w0, dt=END / counts, n_steps=counts, method="rk4")
    assert not found.status.any()


@pytest.mark.parametrize(("method", "tol"), [("rk4", 1e-4), ("rk8", 1e-8)])
def test_per_body_steps_meet_the_tolerance_with_fewer_steps(method, tol):
    """Spins over two decades; the closed form says the error."""
    spins = np.geomspace(0.05, 5.0, 300)[CHANCE.permutation(300)]
    w0 = CHANCE.normal(size=(300, 3))
    w0 *= (spins / np.linalg.norm(w0, axis=1))[:, None]
    q0 = CHANCE.normal(size=(300, 4))
    own = fa.per_body_steps(SCENES["free"], q0, w0, t_end=10.0, tol=tol, method=method)
    found = fa.propagate(SCENES["free"], q0, w0, **own.arguments)
    exact = fa.propagate(SCENES["free"], q0, w0, dt=10.0, n_steps=1, method="exact")
    assert angle(found.q[-1], exact.q[-1]).max() < tol
    assert own.share < 0.35
    assert not found.status.any()
    assert np.unique(own.n_steps).size <= 16
    assert np.array_equal(own.dt, 10.0 / own.n_steps)


@pytest.mark.parametrize("sample", [1, 100])
def test_bodies_outside_of_the_sample_meet_the_tolerance_too(sample):
    """Of equal spins some axes are harder: the steps are run on the others as well."""
    w0 = np.vstack([(0.0, 0.0, 5.0 + 1e-9), CHANCE.normal(size=(99, 3))])
    w0[1:] *= 5.0 / np.linalg.norm(w0[1:], axis=1)[:, None]
    exact = fa.propagate(SCENES["free"], Q0[:1], w0, dt=10.0, n_steps=1, method="exact")
    options = {"t_end": 10.0, "tol": 1e-5, "method": "rk4", "sample": sample}
    own = fa.per_body_steps(SCENES["free"], Q0[:1], w0, **options)
    text = f"error {own.expected_error:.1e} rad at most, measured over 100 of 100 bodies"
    assert text in str(own)
    run = fa.propagate(SCENES["free"], Q0[:1], w0, **own.arguments)
    assert angle(run.q[-1], exact.q[-1]).max() <= own.expected_error <= 1e-5


@pytest.mark.parametrize("method", in_tiers(["rk8"], ["gbs16", "rk8"]))
def test_what_is_recommended_was_run(method):
    """Large steps of high order, whose error falls by no power yet: it is measured at each."""
    damping = fa.torques.QuadraticDamping(0.2)
    torque = fa.torques.Sum((damping, fa.torques.Constant((0.3, -0.5, 0.4))))
    scene = fa.Scene(inertia=(2.0, 1.0, 1.5), torque=torque)
    fine = fa.propagate(scene, Q0, W0, dt=0.005, n_steps=2000, method="rk8")
    own = fa.per_body_steps(scene, Q0, W0, t_end=10.0, tol=1e-8, method=method)
    run = fa.propagate(scene, Q0, W0, **own.arguments)
    assert angle(run.q[-1], fine.q[-1]).max() <= own.expected_error <= 1e-8
    assert not run.status.any()


def late(t, q, w, p):
    return p[0] * t, 0.0, 0.0


def test_steps_of_a_later_start_are_for_that_start():
    """A torque that grows with time; without t0 the run would be the one from 0."""
    scene = fa.Scene(inertia=(2.0, 1.0, 1.5), torque=late, params=(0.1,))
    rng = np.random.default_rng(1)
    own = fa.per_body_steps(scene, Q0, W0, t_end=7.0, tol=1e-7, method="rk8", t0=4.0, rng=rng)
    assert own.arguments["t0"] == 4.0
    run = fa.propagate(scene, Q0, W0, **own.arguments)
    fine = fa.propagate(scene, Q0, W0, dt=0.003, n_steps=1000, method="rk8", t0=4.0)
    assert angle(run.q[-1], fine.q[-1]).max() <= own.expected_error <= 1e-7


def test_a_torque_that_jumps_has_no_steps():
    scene = fa.Scene(
        inertia=(2.0, 1.0, 1.5), torque=lambda t, q, w, p: (1.0 if t > 1.1 else 0.0, 0.0, 0.0)
    )
    with pytest.raises(ValueError, match=r"scene: the torque jumps near t = 1\.1 s .*breakpoints"):
        fa.per_body_steps(scene, Q0, W0, t_end=3.0, tol=1e-3, method="rk8")


def test_a_body_with_the_largest_number_is_looked_at():
    """Of equal spins one body has 400 times the torque."""
    motion = np.full(N, 0.1)
    motion[50] = 2.0
    scene = fa.Scene(inertia=(2.0, 1.0, 1.5), torque=fa.torques.GravityGradient(motion))
    own = fa.per_body_steps(scene, Q0, (0, 0, 1), t_end=3.0, tol=1e-5, method="rk4", sample=1)
    run = fa.propagate(scene, Q0, (0, 0, 1), **own.arguments)
    known = fa.propagate(scene, Q0, (0, 0, 1), dt=0.002, n_steps=1500, method="rk4")
    assert angle(run.q[-1, 50], known.q[-1, 50]) < 1e-5


def test_no_steps_are_tried_that_rounding_makes_worse(monkeypatch):
    """A method of order 2 meets 1e-14 at 1e5 steps or more, which round more than that."""
    tried, run = [], Problem.run

    def counted(problem, case, steps, *given, **options):
        tried.append(np.max(steps))
        return run(problem, case, steps, *given, **options)

    monkeypatch.setattr(Problem, "run", counted)
    with pytest.raises(ValueError, match=r"accepted: what can be reached, \S+ rad by strang2"):
        fa.per_body_steps(SCENES["free"], Q0[:1], W0[:1], t_end=1.0, tol=1e-14, method="strang2")
    assert 1e5 < sum(tried) < 1e7
