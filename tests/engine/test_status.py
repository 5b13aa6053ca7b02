"""What a run says of each body: flags, counts, a summary, warnings; neighbours never feel it."""

import math
import re
import warnings

import numpy as np
import pytest
import scipy
from each import each, in_tiers
from extremes.cases import OF_BODIES
from numba import njit
from numpy.testing import assert_array_equal

import fastatt as fa
from fastatt.engine.status import DIAGNOSTICS, Status
from fastatt.propagation import end
from fastatt.scene.torque_record import fastest_decay

FREE = fa.Scene(inertia=(2.0, 1.0, 2.0 / 3.0))
N = 300
GENERATOR = np.random.default_rng(5)
Q0, W0 = GENERATOR.normal(size=(N, 4)), GENERATOR.normal(size=(N, 3))


def test_codes_are_those_that_are_documented():
    """They are stored beside results: numbers that stay."""
    assert {flag.name: int(flag) for flag in fa.Status if flag} == {
        "NON_FINITE": 1, "STEP_TOO_LARGE": 2, "INVARIANT": 4, "SINGULAR": 8, "NOT_CONVERGED": 16,
        "NORM_LOST": 32, "UNFINISHED": 64, "JUMP": 128, "SLIDING": 256,
    }  # fmt: skip


def test_the_class_lists_the_flags():
    listed = re.findall(r"^ +([A-Z_]+) : Status\n +(\d+):", fa.Status.__doc__, re.MULTILINE)
    flags = [("OK", "0"), *((flag.name, str(int(flag))) for flag in fa.Status if flag)]
    assert listed == flags


def spun(rate=3.0, method="rk4", torque=None):
    """A body about an axis near the third, by steps of 1 s."""
    scene = fa.Scene(inertia=(3.0, 2.0, 1.0), torque=torque)
    w0 = [0.01 * rate, 0.0, rate]
    return fa.propagate(scene, [1, 0, 0, 0], w0, dt=1.0, n_steps=10, method=method)


PD = fa.torques.QuaternionPD(1e-3, 1e-3)
#: for each diagnostic a run that has its flag, and one that has not, on the two sides of its bound
EXAMPLES = {
    "angle": (lambda: spun(1.75), lambda: spun(1.65)),
    "norm": (lambda: spun(1.05), lambda: spun(0.95)),
    "drift": (lambda: spun(3e14, "kahan_li8"), lambda: spun(1.0, "kahan_li8")),
    "jump": (lambda: spun(0.32, torque=PD), lambda: spun(0.31, torque=PD)),
}


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("of", DIAGNOSTICS, ids=lambda of: of.name)
def test_each_diagnostic_sets_its_flag(of):
    """Also of a closed form, unless its record says that this can't be."""
    beyond, within = (int(run().status[0]) for run in EXAMPLES[of.name])
    assert beyond & of.flag
    assert not within & of.flag
    assert of.closed is None or int(spun(1e20, "exact").status[0]) & of.flag


def test_each_flag_has_one_diagnostic():
    """All but those of the state, the end and a switch; the file of an end says which there are."""
    flags = [x for of in DIAGNOSTICS for x in (of.flag, of.infinite, of.at_poles) if x]
    others = [Status.NON_FINITE, Status.UNFINISHED, Status.SLIDING]
    assert sorted([*flags, *others]) == [x for x in Status if x]
    assert end._FORMAT.split()[1:] == [of.name for of in DIAGNOSTICS]


def test_the_angle_is_the_last_diagnostic_of_steps():
    """By its row the machine knows which blocks need the formulas for any angle."""
    assert [of.name for of in DIAGNOSTICS if of.of_steps][-1] == "angle"


@njit
def burst(t, p):
    """p[2] rad/s from p[0] to p[1] of every p[4] s, once around the clock in a second; else 0.1."""
    since = t % p[4]
    speed = p[2] * np.cos(2.0 * np.pi * (t - p[3])) if p[0] <= since < p[1] else 0.1
    return speed, 0.0, 0.0


def bursts(method, first, last, n_steps, *, period=1e9, **options):
    """Bursts of whole steps of 1 s: from node to node the rate changes its sign."""
    phase = 0.0 if method in ("lie_euler", "lie_midpoint", "rk4", "rkmk4") else 0.25
    scene = fa.Scene(rate=burst, params=[first, last, 5.0, phase, period])
    return fa.propagate(scene, Q0[:1], dt=1.0, n_steps=n_steps, method=method, **options)


@each("method", ["lie_euler", "rk4", "magnus4"])
def test_bursts_of_seven_steps_do_not_pass_unseen(method):
    for first in (0, 5, 61, 92, 250, 256, 293):
        run = bursts(method, first, first + 7, 300)
        assert run.status[0] & fa.Status.STEP_TOO_LARGE, first


@each("period", [2, 7, 8, 10, 16, 32, 64])
def test_a_pulse_of_one_step_in_many_is_seen_before_long(period):
    for phase in range(0, period, max(1, period // 8)):
        run = bursts("magnus4", phase, phase + 1, 4000, period=period)
        assert run.status[0] & fa.Status.STEP_TOO_LARGE, phase


def test_the_last_step_before_a_save_is_looked_at():
    """And all steps of runs of up to six between saves."""
    often = {"save_every": 11}
    for first, n_steps, options in (
        (10, 11, {}), (10, 100, often), (43, 100, often),
        *((k, 12, {"save_every": 6}) for k in range(12)),
    ):  # fmt: skip
        assert bursts("magnus4", first, first + 1, n_steps, **options).status[0]


def test_shorter_steps_are_looked_at():
    """The last one of a run, and one to a save, though the whole step around it is slow."""
    scene = fa.Scene(rate=lambda t, p: (5.0 if 2.2 < t < 2.3 else 0.1, 0.0, 0.0))
    options = {"dt": 1.0, "method": "lie_midpoint"}  # evaluated at 2.25, or at 2.5
    for more in ({"t_end": 2.5}, {"n_steps": 4, "save_at": [2.5, 4.0]}):
        assert fa.propagate(scene, Q0[:1], **options, **more).status[0]
    for more in ({"n_steps": 3}, {"n_steps": 4, "save_at": [2.0, 4.0]}):
        assert not fa.propagate(scene, Q0[:1], **options, **more).status[0]


@njit
def slew(t, p):
    """p rad/s in the third step, 0.1 else."""
    speed = p[0] if 2.0 <= t < 3.0 else 0.1
    return 0.6 * speed, 0.0, -0.8 * speed


@each(
    ("representation", "compensated", "dtype", "allowed"),
    [
        ("quat", False, np.float64, 2e-12), ("dcm", False, np.float64, 2e-12),
        ("quat", False, np.float32, 1e-3), ("quat", True, np.float32, 1e-3),
    ],
)  # fmt: skip
def test_what_a_short_exponential_spoilt_is_run_again(representation, compensated, dtype, allowed):
    """One step of up to 1000 rad, at which nobody looks, in a hundred of 0.1.

    A float32 quaternion is spoilt by 1e-3 before its length says so; 1000 rad have an ulp of 6e-5.
    """
    angles = np.concatenate([np.linspace(3.0, 30.0, 2000), np.geomspace(30.0, 1000.0, 200)])
    run = fa.propagate(
        fa.Scene(rate=slew, params=angles[:, None]), np.tile(np.eye(4)[0], (angles.size, 1)),
        dt=1.0, n_steps=100, method="lie_midpoint", representation=representation, dtype=dtype,
        compensated=compensated,
    )  # fmt: skip
    half = 0.5 * (angles.astype(dtype).astype(np.float64) + 0.1 * 99)
    expected = [np.cos(half), 0.6 * np.sin(half), 0.0 * half, -0.8 * np.sin(half)]
    off = fa.angle_between(run.q[-1].astype(np.float64), np.stack(expected, axis=-1))
    assert off.max() < allowed


def shrunk(turn):
    """1 − |R(iφ)| of RK4 for a constant rate: how much shorter a step of an angle φ makes x."""
    return 1.0 - abs(1.0 + 1j * turn - turn**2 / 2.0 - 1j * turn**3 / 6.0 + turn**4 / 24.0)


@each(
    ("dtype", "bound", "normalise"),
    [("float64", 1e-3, "output"), ("float64", 1e-3, 1), ("float32", 1e-2, "never")],
)
def test_the_norm_is_judged_before_it_is_mended(normalise, dtype, bound):
    """Steps whose loss is a tenth below the bound and above it; a mend leaves 3/2 of its square."""
    steps = 4 if normalise == 1 else 1
    for share, flag in ((0.9, 0), (1.1, fa.Status.NORM_LOST)):
        turn = 2.0 * scipy.optimize.brentq(lambda x, loss=share * bound: shrunk(x) - loss, 0.1, 1.5)
        scene = fa.Scene(rate=fa.rates.Polynomial([[0.0, 0.6 * turn, 0.8 * turn]]))
        run = fa.propagate(
            scene, Q0[:1], dt=1.0, n_steps=steps, method="rk4", normalise=normalise, dtype=dtype
        )
        assert run.status[0] & fa.Status.NORM_LOST == flag


def test_rates_that_single_precision_does_not_hold_are_flagged_without_a_step():
    scene = fa.Scene(rate=fa.rates.Constant([(1e300, 0.0, 0.0), (1.0, 0.0, 0.0)]))
    run = fa.propagate(scene, np.eye(4)[:2], dt=0.1, n_steps=0, dtype=np.float32)
    assert run.status.tolist() == [fa.Status.NON_FINITE, 0]


def test_summary_names_what_went_wrong():
    w = W0.copy()
    w[[3, 64, 65, 130, 131, 299]] = 1e200
    with pytest.warns(fa.StepWarning):
        run = fa.propagate(FREE, Q0, w, dt=0.01, n_steps=10, method="rk4")
    lines = run.summary().splitlines()
    assert lines[0].startswith("rk4 on quat, float64: 300 bodies to t = 0.1 s by 0.01 s, 1 saves")
    assert lines[1] == "NON_FINITE (1): 6 of 300, body 3, 64, 65, 130, 131, …"
    fine = fa.propagate(FREE, Q0[0], W0[0], dt=0.01, n_steps=10, method="rk4")
    assert fine.summary().count("\n") == 0
    assert "1 body" in fine.summary()
    with pytest.warns(fa.StepWarning):
        lost = fa.propagate(FREE, Q0[3], w[3], dt=0.01, n_steps=10, method="rk4")
    assert "largest norm error nan" in lost.summary()


def relative(x):
    """Largest change from the first save, relative, of (S, N)."""
    return np.abs(x / x[0] - 1.0).max(axis=0)


@pytest.mark.parametrize("normalise", ["output", 16])
def test_norms_that_projections_of_a_compensated_state_remove_add_up(normalise):
    """Between two projections none is beyond its bound."""
    options = {"dt": 1.2, "method": "rk8", "compensated": True, "normalise": normalise}
    start = fa.Scene(inertia=(3.0, 2.0, 1.0)), Q0[0], (0.9, 1.1, 0.2)
    few, many = (fa.propagate(*start, n_steps=n, **options) for n in (64, 10_000))
    assert few.status.tolist() == [0]
    assert np.abs(few.norm_error).max() < 1e-3
    assert int(many.status[0]) & fa.Status.NORM_LOST
    for dtype in ("float64", "float32"):  # whose rounding is not removed
        slow = fa.propagate(*start, n_steps=10_000, dtype=dtype, **{**options, "dt": 1e-3})
        assert slow.status.tolist() == [0]


@pytest.mark.parametrize("dt", [37.0, 100.0, 1e6])
@pytest.mark.parametrize("torque", [None, fa.torques.Damping(0.1)])
def test_steps_that_leave_no_number_are_warned_of(dt, torque):
    scene = fa.Scene(inertia=(3.0, 2.0, 1.0), torque=torque)
    with pytest.warns(fa.StepWarning, match="dt: a step of body 0 is"):
        run = fa.propagate(scene, Q0[0], (0.6, 0.8, 0.0), dt=dt, n_steps=20, method="rk8")
    assert int(run.status[0]) & fa.Status.NON_FINITE


@pytest.mark.parametrize("dtype", ["float64", "float32"])
def test_energy_and_momentum_that_leave_their_bound_are_flagged(dtype):
    """Each by itself: strang2 keeps |m| and not the energy, RK4 a needle's energy and not |m|."""
    needle, w0 = (1000.0, 1000.0, 1.0), np.array([[1e-3, 0.0, 1.0], [1e-5, 0.0, 0.7]])
    triaxial, (a, b, c) = FREE.inertia, 1.0 / np.sort(FREE.inertia)
    measure = np.linalg.norm(triaxial * W0, axis=1, keepdims=True) * math.sqrt((a - b) * (b - c))
    for inertia, w, method, h, n, energy_lost in (
        (triaxial, 0.49 * W0 / measure, "strang2", 1.0, 100, True),
        (needle, w0, "rk4", 1.0, 10, False),
    ):
        run = fa.propagate(
            fa.Scene(inertia=inertia), Q0[: len(w)], w, dt=h, n_steps=n, method=method,
            save_every=1, dtype=dtype,
        )  # fmt: skip
        w = run.w.astype(float)
        energy = relative(fa.kinetic_energy(w, inertia))
        momentum = relative(np.square(fa.angular_momentum(w, inertia)).sum(axis=-1))
        lost, kept = (energy, momentum) if energy_lost else (momentum, energy)
        assert kept.max() < 5e-3
        assert 0 < (lost > 1e-2).sum() < len(lost)
        assert (
            np.abs(lost / 1e-2 - 1.0).min() > 1e-4
        )  # no body at the bound, where rounding decides
        assert_array_equal((run.status & fa.Status.INVARIANT) != 0, lost > 1e-2)
        assert not (run.status & fa.Status.STEP_TOO_LARGE).any()


@pytest.mark.parametrize(
    ("dtype", "left", "good"), [("float64", 1e-12, 0.65), ("float32", 1e-7, 0.85)]
)
@pytest.mark.parametrize("method", ["dmv2", "dmv10"])
def test_not_converged_is_said_of_what_did_not_converge(method, dtype, left, good):
    """The discrete step keeps |m| and the energy; where Newton's steps stop they are off by a rest.

    ``left`` is the square of the last change: what another step would still change. All bodies
    converge up to |m|h/I_min of ``good``.
    """
    generator = np.random.default_rng(8)
    n, eps = 400, float(np.finfo(dtype).eps)
    masses = generator.uniform(0.02, 2.0, (n, 3))
    inertia = masses.sum(axis=1, keepdims=True) - masses
    inertia = (inertia / inertia.min(axis=1, keepdims=True)).astype(dtype).astype(float)
    m = generator.normal(size=(n, 3))
    scene, q0 = fa.Scene(inertia=inertia), np.tile([1.0, 0.0, 0.0, 0.0], (n, 1))
    limit = fa.METHODS[method].limit("quat", body=True)
    unfinished = []
    for size in (0.5, 0.65, 0.85, 0.95, 1.1, 1.5):
        w0 = (size * m / np.linalg.norm(m, axis=1, keepdims=True) / inertia).astype(dtype)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", fa.StepWarning)
            run = fa.propagate(scene, q0, w0, dt=1.0, n_steps=1, method=method, dtype=dtype)
        w = np.nan_to_num(np.stack([w0, run.w[-1]]).astype(float))
        off = np.maximum(
            relative(fa.kinetic_energy(w, inertia)),
            relative(np.linalg.norm(fa.angular_momentum(w, inertia), axis=-1)),
        )
        flagged = (run.status & fa.Status.NOT_CONVERGED) != 0
        assert off[~flagged].max() < left + 4.0 * eps
        assert size > good or not flagged.any()
        unfinished.append(off[flagged].max(initial=0.0))
        # and so it is the root that the closed form is near
        fine = run.status == 0
        assert fine.any() == (size < limit)
        q, _ = fa.closed_form.free_body(q0, w0, inertia, 1.0)
        turned = np.linalg.norm(w0[fine], axis=1)
        allowed = turned * np.minimum(OF_BODIES[method] * size ** fa.METHODS[method].order, 0.1)
        error = fa.angle_between(run.q[-1], q)[fine]
        assert (error <= allowed + 16.0 * eps).all()
    assert max(unfinished) > 100.0 * left


# warnings, with a number and a remedy


def remedy(text):
    return float(text.split("<= ")[1].split(",")[0])


@pytest.mark.parametrize("method", ["rk4", "strang2", "dmv10"])
def test_steps_past_the_limit_are_warned_of_with_a_step_that_is_not(method):
    w0 = np.array([[0.1, 0.0, 0.0], [8.0, 5.0, -7.0]])
    with pytest.warns(fa.StepWarning, match=r"a step of body 1 is .*\(1 of 2 bodies") as found:
        run = fa.propagate(FREE, [1, 0, 0, 0], w0, dt=1.0, n_steps=2, method=method)
    assert run.status[0] == 0
    assert run.status[1] & ~fa.Status.INVARIANT
    assert found[0].filename == __file__
    enough = 0.95 * remedy(str(found[0].message))
    with warnings.catch_warnings():
        warnings.simplefilter("error", fa.StepWarning)
        run = fa.propagate(FREE, [1, 0, 0, 0], w0, dt=enough, n_steps=2, method=method)
    assert not (run.status & (fa.Status.STEP_TOO_LARGE | fa.Status.NOT_CONVERGED)).any()


def test_the_remedy_is_the_limit_itself():
    """To the three digits that are shown, of turns, of damping, and of steps below rounding."""
    start, rk4 = {"q0": [1, 0, 0, 0], "n_steps": 1, "method": "rk4"}, fa.METHODS["rk4"]
    damping = fa.Scene(inertia=(2.0, 1.0, 1.5), torque=fa.torques.Damping(20.0))
    w0, limit = [[0.0, 0.0, 1.0], [0.0, 0.0, 8.0]], rk4.limit("quat")
    shown = rf"a step of body 1 is 8 rad, rk4's limit is {limit:.3g} \(1 of 2 bodies"
    own = {"w0": w0, "dt": [1.0, 0.5], "n_steps": [1, 2]}  # of the body that is named
    for scene, options, message, most in (
        (FREE, {"w0": w0, "dt": 1.0}, shown, limit / 8.0),
        (FREE, own, "a step of body 1 is 4 rad", limit / 8.0),
        (damping, {"w0": [0.01, 0.0, 0.0], "dt": 1.0}, "takes 20 of", rk4.damping_limit / 20.0),
    ):
        with pytest.warns(fa.StepWarning, match=message) as found:
            fa.propagate(scene, **start | options)
        assert remedy(str(found[0].message)) == pytest.approx(most, rel=5e-3)
    with pytest.warns(fa.StepWarning, match=r"no step is more than 1e-17 rad") as found:
        fa.propagate(FREE, w0=w0[0], dt=1e-17, **start)
    least = float(re.search(r"\|dt\| >= ([\d.e-]+),", str(found[0].message))[1])
    assert least == pytest.approx(1e3 * 2.0**-52, rel=5e-3)
    with warnings.catch_warnings():
        warnings.simplefilter("error", fa.StepWarning)
        fa.propagate(FREE, w0=w0[0], dt=least, **start)


@pytest.mark.parametrize("method", ["strang2", "kahan_li8"])
def test_the_angle_of_a_splitting_is_that_of_its_rotors(method):
    """|m| h √((1/I1 − 1/I2)(1/I2 − 1/I3)) of a free body; in units of a torque's own limit else."""
    moments, w, record = np.array([0.5, 0.8, 1.0]), np.array([8.0, 5.0, -7.0]), fa.METHODS[method]
    free = np.linalg.norm(moments * w) * math.sqrt(0.75 * 0.25)
    torqued = max(np.linalg.norm(w), free * record.limits["torqued"] / record.limit("quat"))
    for torque, angle in ((None, free), (fa.torques.Constant([0.0, 0.0, 1e-9]), torqued)):
        scene = fa.Scene(inertia=moments, torque=torque)
        told = f"a step of body 0 is {angle:.3g} rad by the measure 'asymmetry', {method}"
        with pytest.warns(fa.StepWarning, match=told):
            fa.propagate(scene, [1, 0, 0, 0], w, dt=1.0, n_steps=1, method=method)


def test_strong_damping_is_warned_of():
    inertia = (2.0, 1.0, 2.0 / 3.0)
    scene = fa.Scene(inertia=inertia, torque=fa.torques.Damping(2.0))
    call = {"n_steps": 10, "q0": [1, 0, 0, 0], "w0": [0.01, 0.01, 0.01]}
    with pytest.warns(fa.StepWarning, match=r"damping takes 3 of the rate a step; rk4") as found:
        run = fa.propagate(scene, dt=1.0, method="rk4", **call)
    assert int(run.status[0]) & fa.Status.STEP_TOO_LARGE
    fine = fa.propagate(scene, dt=0.99 * remedy(str(found[0].message)), method="rk4", **call)
    assert fine.status[0] == 0
    damped = fa.propagate(scene, dt=1.0, method="strang2", **call)
    assert damped.status[0] == 0
    # c/I exactly, whatever the step; little turns, so that axes hardly mix
    assert damped.w[-1] == pytest.approx(0.01 * np.exp(-10.0 * 2.0 / np.array(inertia)), rel=0.03)


# those of splittings, which are in stages, are below
DAMPED = [m.name for m in fa.METHODS.values() if m.steps and "torqued" in m.scenes and not m.stages]


@pytest.mark.parametrize("method", in_tiers(["rk4", "gbs16"], DAMPED))
def test_the_limit_of_damping_is_where_its_factor_is_wrong_by_a_tenth(method):
    damped = fa.METHODS[method].damping_limit + np.array([0.0, 0.2])
    scene = fa.Scene(inertia=(1.0, 1.0, 1.0), torque=fa.torques.Damping(damped[:, None]))
    with pytest.warns(fa.StepWarning):
        run = fa.propagate(
            scene, [1, 0, 0, 0], [[0.01, 0, 0]] * 2, dt=1.0, n_steps=1, method=method
        )
    within, beyond = np.abs(run.w[-1, :, 0] / 0.01 - np.exp(-damped))
    assert within <= 0.1 < beyond


@pytest.mark.parametrize("dtype", ["float64", "float32"])
@pytest.mark.parametrize("options", [{}, {"compensated": True}, {"rate": True}], ids=str)
def test_the_usual_angles_are_those_without_advice(options, dtype):
    """Of them no step is warned of, and of all others each is."""
    given = dict(options)
    scene = fa.Scene(rate=fa.rates.Constant((0, 0, 1))) if given.pop("rate", 0) else FREE
    method = "rk4" if scene is FREE else "lie_euler"
    plan = fa.plan(scene, 1, dt=0.1, n_steps=1, method=method, dtype=dtype, **given)
    least, most = plan.limits.usual
    for angle in (*np.geomspace(1e-20, 1e20, 81), 1.01 * most, 0.99 * most):
        assert (plan.limits._advice(np.array([angle])) == "") == (least <= angle <= most)


@pytest.mark.parametrize("method", ["strang2", "kahan_li8"])
def test_splittings_under_strong_damping(method):
    """What a stage backwards makes of damping is flagged before it is wrong."""
    rng = np.random.default_rng(6)
    a, b, share = rng.uniform(0.1, 1.0, (3, 500))
    inertia = np.stack([a, b, np.abs(a - b) + 2.0 * share * np.minimum(a, b)], axis=1)
    w0 = rng.normal(size=(500, 3))
    w0 /= np.linalg.norm(w0, axis=1)[:, None] / 0.5
    least = inertia.min(axis=1)
    limit = fa.METHODS[method].damping_limit
    call = {"q0": [1, 0, 0, 0], "w0": w0, "n_steps": 1}
    for share, flagged in ((1.01, True), (0.99, False)):
        torque = fa.torques.Damping(share * limit * least[:, None])
        scene = fa.Scene(inertia=inertia, torque=torque)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore" if flagged else "error", fa.StepWarning)
            run = fa.propagate(scene, **call, dt=1.0, method=method)
        assert (run.status == fa.Status.STEP_TOO_LARGE * flagged).all()
    true = fa.propagate(scene, **call | {"n_steps": 200}, dt=1.0 / 200, method="rk8")
    assert (fa.angle_between(run.q[-1], true.q[-1]) <= 0.1 * 0.5).all()


def test_fastest_decay_of_every_damping():
    moments = np.array([[2.0, 1.0, 0.5], [1.0, 1.0, 4.0]])
    t = fa.torques
    for model, expected in (
        (None, 0.0),
        (t.Damping(3.0), [6.0, 3.0]),
        (t.Damping([[3.0], [1.0]]), [6.0, 1.0]),
        (t.Damping((0.1, 0.2, 0.3)), [0.6, 0.3]),
        (t.QuaternionPD(1.0, 2.0), [4.0, 2.0]),
        (t.QuaternionPD(1.0, (1.0, 2.0, 0.5)), [4.0, 2.0]),
        (t.QuaternionPD(1.0, [[[2.0]], [[1.0]]]), [4.0, 1.0]),
        (t.Sum((t.Damping(1.0), t.Damping((1.0, 0.0, 0.0)))), [4.0, 2.0]),
    ):
        found = np.broadcast_to(fastest_decay(model, moments), 2)
        assert found == pytest.approx(np.broadcast_to(expected, 2))


OF_SAMPLES = ["hold", "trapezoid", "previous", "coning2", "picard"]


@pytest.mark.parametrize("method", in_tiers(["hold", "picard"], OF_SAMPLES))
def test_samples_too_far_apart_are_warned_of(method):
    limit = fa.METHODS[method].limit("rates")
    rates = np.zeros((3, 500, 3))
    rates[:, :, 2] = 0.9 * limit
    with warnings.catch_warnings():
        warnings.simplefilter("error", fa.StepWarning)
        fa.integrate_rates(rates, 1.0, method=method)
    rates[1, 77, 0] = 2.0 * limit
    with pytest.warns(fa.StepWarning, match=f"interval 76 of log 1 .* {method}'s limit is"):
        fa.integrate_rates(rates, 1.0, method=method)
    with pytest.warns(fa.StepWarning, match="interval 76 of log 0"):
        fa.integrate_rates(rates[1], 1.0, method=method)


@pytest.mark.parametrize("method", ["rk4", "kahan_li8", "dmv10"])
def test_rates_of_any_size_are_right_or_flagged(method):
    """Products of rates underflow, their squares overflow: the turn in a step is the same."""
    scene, record = fa.Scene(inertia=(0.6, 0.8, 1.0)), fa.METHODS[method]
    w, steps = np.array([[0.5, -0.3, 0.8], [0.3, 0.9, 0.2]]), {"n_steps": 40, "method": method}
    usual = fa.propagate(scene, [1, 0, 0, 0], w, dt=0.1, **steps)
    for size in (1e-250, 1e-163, 1e-160, 1e-150, 1e150, 1e200, 1e250):
        given = {"dt": 0.1 / size, **steps}
        run = fa.propagate(scene, [1, 0, 0, 0], w * size, **given)
        right = fa.angle_between(run.q[-1], usual.q[-1]) < 1e-9
        assert (right | (run.status != 0)).all()
        if not record.iterates:
            assert not (run.status & fa.Status.NOT_CONVERGED).any()
        if record.measure != "angle" or 1e-155 < size < 1e155:
            assert right.all()
            assert not run.status.any()
    assert not fa.propagate(scene, [1, 0, 0, 0], w * 1e-200, dt=0.1, **steps).status.any()


@pytest.mark.parametrize("method", ["rk4", "rkmk4", "cf4", "strang2"])
def test_a_body_spun_up_from_rest_is_monitored(method):
    """The momentum that it has at first says nothing of the rotation angles of later steps."""
    scene = fa.Scene(inertia=(2.0, 1.0, 2 / 3), torque=fa.torques.Constant((0.0, 0.0, 1.0)))
    with pytest.warns(fa.StepWarning):
        run = fa.propagate(scene, Q0[0], np.zeros(3), dt=0.25, n_steps=100, method=method)
    assert run.w[-1, 2] * 0.25 > 5.0
    assert int(run.status[0]) & fa.Status.STEP_TOO_LARGE


@pytest.mark.parametrize("method", ["rk4", "rkmk4", "kahan_li8"])
def test_slow_rates_under_a_torque_are_right_or_flagged(method):
    """Without invariants too, no body whose products of rates underflow passes for right."""
    w0, wanted, steps = np.array([0.7, 1.1, -0.4]), None, {"n_steps": 100, "method": method}
    for size in (1.0, 1e-140, 1e-157, 1e-160, 1e-165, 1e-250):
        scene = fa.Scene(inertia=(3.0, 2.0, 1.2), torque=fa.torques.Damping(1e-3 * size))
        run = fa.propagate(scene, [1, 0, 0, 0], w0 * size, dt=0.02 / size, **steps)
        wanted = run.q[-1] if wanted is None else wanted
        if not run.status[0]:
            assert fa.angle_between(run.q[-1], wanted) < 1e-10
        assert run.status[0] == 0 or size < 1e-150
    rest = fa.propagate(scene, [1, 0, 0, 0], [0, 0, 0], dt=1e100, n_steps=1, method=method)
    assert not rest.status.any()


def ending(t, q, w, p):
    return np.sqrt(1.0 - t), 0.0 * t, 0.0 * t


@each(
    ("text", "category", "torque", "speed", "dt", "n_steps"),
    [
        (r"status: found NON_FINITE \(3\).*3 of 3 bodies", RuntimeWarning, ending, 1.0, 0.1, 30),
        (r"status: found INVARIANT \(3\).*3 of 3 bodies", RuntimeWarning, None, 1.0, 3.0, 3000),
        ("dt: a step of body 0 is", fa.StepWarning, None, 20.0, 1.0, 99),
    ],
)
def test_a_run_with_flags_warns_once(text, category, torque, speed, dt, n_steps):
    scene, w0 = fa.Scene(inertia=(3.0, 2.0, 1.0), torque=torque), speed * np.array([0.1, 0.2, 0.3])
    with pytest.warns() as told:
        run = fa.propagate(scene, Q0[:3], w0, dt=dt, n_steps=n_steps, method="rk4")
    assert run.status.all()
    (warning,) = told
    assert (warning.category, warning.filename) == (category, __file__)
    assert re.match(text, str(warning.message))
