"""Plans: what ``propagate`` gives, to the bit, of values given in any form and by any thread."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest

import fastatt as fa
from fastatt.codegen import lanes
from fastatt.engine import program as programs
from fastatt.engine.job import Job

BODY = (2.0, 1.0, 2.0 / 3.0)
SCENES = {
    "free": fa.Scene(inertia=BODY),
    "torqued": fa.Scene(inertia=BODY, torque=fa.torques.HeavyTop((0.0, 0.0, 0.5), 2.0)),
    "rate": fa.Scene(rate=fa.rates.Coning(1.0, 1.0)),
}
TILTED = np.diag(BODY) + 0.1  # its axes are numbers beside those of a function
N = 5
RNG = np.random.default_rng(5)
Q0, W0 = RNG.normal(size=(N, 4)), RNG.normal(size=(N, 3))


def swing(t, q, w, p):
    return (p[0] * np.sin(t), p[1] * w[1], 0.0)


OWN = fa.Scene(inertia=BODY, torque=swing, params=(0.3, -0.1))


def bits(run):
    """All numbers of a trajectory."""
    arrays = [run.t, run.q, run.w, run.norm_error, run.status, *run.carried.values()]
    return [(x.shape, x.dtype, np.ascontiguousarray(x).tobytes()) for x in arrays]


def rates_of(scene, w=W0):
    return () if scene.kind == "rate" else (w,)


def test_one_body():
    """Histories of one body have no axis of bodies, unless it is given as an ensemble of one."""
    plan = fa.plan(SCENES["torqued"], 1, dt=0.05, n_steps=3, method="rk4")
    for q, w, shape in (
        (Q0[0], W0[0], (1, 4)),
        (Q0[:1], W0[0], (1, 1, 4)),
        (Q0[0], W0[:1], (1, 1, 4)),
        (Q0[0].tolist(), W0[0].tolist(), (1, 4)),
    ):
        run = plan(q, w)
        assert run.q.shape == shape
        wanted = fa.propagate(SCENES["torqued"], q, w, dt=0.05, n_steps=3, method="rk4")
        assert bits(run) == bits(wanted)


@pytest.mark.parametrize("inertia", [BODY, TILTED], ids=["principal", "tilted"])
def test_new_numbers_compile_nothing(monkeypatch, inertia):
    own = replace(OWN, inertia=inertia)
    plan = fa.plan(own, N, dt=0.05, n_steps=3, method="rk4")
    other = (-0.7, 0.2)
    wanted = fa.plan(replace(own, params=other), N, dt=0.05, n_steps=3, method="rk4")(Q0, W0)
    before = bits(plan(Q0, W0))
    monkeypatch.setattr(lanes, "generated", lambda *_: pytest.fail("compiled"))
    programs.program.cache_clear()
    assert bits(plan(Q0, W0, params=other)) == bits(wanted)
    assert bits(plan(Q0, W0)) == before != bits(wanted)


@pytest.mark.parametrize("kind", SCENES)
def test_other_steps_trace_nothing(monkeypatch, kind):
    scene, options = SCENES[kind], {"method": "magnus4" if kind == "rate" else "rk4"}
    fa.propagate(scene, Q0, *rates_of(scene), dt=0.05, n_steps=3, **options)
    monkeypatch.setattr(Job, "scope", lambda *_, **__: pytest.fail("traced"))
    run = fa.propagate(scene, Q0, *rates_of(scene), t0=1.0, dt=0.025, n_steps=4, **options)
    assert run.t[-1] == 1.1


def test_runs_with_and_without_positions_are_apart():
    """Of one scene, one after the other: what is kept of the first is not for the second."""
    scene = fa.Scene(inertia=BODY, mass=2.0, force=(0.1, 0.2, 0.3))
    options = {"v0": W0, "dt": 0.05, "n_steps": 3, "method": "rk4"}
    for _ in range(2):
        moved = fa.propagate(scene, Q0, W0, r0=W0 + 1.0, **options)
        plain = fa.propagate(scene, Q0, W0, **options)
        assert moved.r.shape == (1, N, 3)
        assert "r" not in plain.carried
        assert plain.v.tobytes() == moved.v.tobytes()


def test_a_scene_keeps_few_plans():
    scene = fa.Scene(inertia=(2.0, 1.0, 2 / 3))
    for k in range(30):
        for method in ("rk4", "exact"):
            fa.propagate(scene, [1, 0, 0, 0], [0, 0, 1], dt=0.1 + k, n_steps=0, method=method)
    assert len(scene.memo) <= 20


def test_numbers_beyond_the_precision_are_flagged():
    plan = fa.plan(OWN, N, dt=0.05, n_steps=1, method="rk4", dtype=np.float32)
    assert (plan(Q0, W0, params=(1e39, 0.0)).status & fa.Status.NON_FINITE).all()
    assert not plan(Q0, W0).status.any()
    unread = replace(OWN, torque=lambda t, q, w, p: (0.1 * t, 0.0, 0.0))
    plan = fa.plan(unread, N, dt=0.05, n_steps=1, method="rk4", dtype=np.float32)
    assert (plan(Q0, W0, params=(1e39, 0.0)).status == fa.Status.NON_FINITE).all()
    assert not plan(Q0, W0).status.any()


def test_several_threads():
    """Each finds what it finds alone, and may read what another ran."""
    plan = fa.plan(SCENES["torqued"], N, dt=1e-3, n_steps=2000, method="rk4")
    values = [(RNG.normal(size=(N, 4)), RNG.normal(size=(N, 3))) for _ in range(24)]
    alone = [bits(plan(*pair)) for pair in values]
    with ThreadPoolExecutor(8) as pool:
        runs = list(pool.map(lambda pair: plan(*pair), values))
        assert list(pool.map(bits, runs)) == alone
        assert len(set(map(str, pool.map(lambda _: bits(runs[0]), range(8))))) == 1


def test_a_plan_to_a_time_has_its_start():
    """With a number of steps its calls may begin at any time."""
    scene, w0 = SCENES["torqued"], W0
    ends = {"t_end": 100.33}, {"save_at": [100.1]}, {"save_at": [100.1], "n_steps": 3}
    for end in ends:
        options = {"t0": 100.0, "dt": 0.05, "method": "rk4", **end}
        plan = fa.plan(scene, N, **options)
        assert bits(plan(Q0, w0)) == bits(fa.propagate(scene, Q0, w0, **options))
        assert bits(plan(Q0, w0, t0=100.0)) == bits(plan(Q0, w0))
        with pytest.raises(ValueError, match=r"t0: found 0\.0 in a plan with t_end.*: 100\.0"):
            plan(Q0, w0, t0=0.0)
    plan = fa.plan(scene, N, dt=0.05, n_steps=3, method="rk4", t0=7.0)
    assert plan(Q0, w0).t.tolist() == [7.15]
    assert plan(Q0, w0, t0=8.0).t.tolist() == [8.15]
