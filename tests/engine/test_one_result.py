"""One result, to the bit: whoever is beside a body, whatever is saved, however a run is divided.

Over ways of a run: methods of each sort, and all that a run may carry or do beside its steps.
"""

import pickle
from dataclasses import replace

import numpy as np
import pytest
from each import each, in_tiers
from ways import DT, OWN, Q0, RATE, RNG, STEPS, TORQUED, W0, WAYS, N, given

import fastatt as fa
from fastatt.attitudes import ATTITUDES
from fastatt.engine import run as engine_run
from fastatt.propagation import plan as plans

STEPPED = [way for way, (_, options) in WAYS.items() if options["method"] != "exact"]
ways, stepped = (pytest.mark.parametrize("way", x) for x in (WAYS, STEPPED))


def run(way, rows=slice(None), **more):
    scene, arguments = given(way, rows, **more)
    return fa.propagate(scene, **arguments)


def of(found, bodies=slice(None), saves=slice(None)):
    """All numbers of some bodies of a run: NaN equals NaN, 0 does not equal −0."""
    histories = [found.state, of_one_sign(found), found.norm_error, *found.carried.values()]
    each = [x for x in (found.status, found.first_crossings) if x is not None]
    numbers = [x[saves][:, bodies] for x in histories] + [x[bodies] for x in each]
    for name in found.crossing_numbers:  # of which a resumed run has those from its start on
        x = found.crossings(name)
        shown = np.isin(x.body, np.arange(len(found.status))[bodies]) & (x.t > found.t[saves][0])
        numbers += [x.t[shown], x.q[shown], x.w[shown]]
    return [(x.shape, x.dtype, x.tobytes()) for x in numbers]


def of_one_sign(found):
    """Attitudes, whose sign is a matter of the saves where it is not propagated."""
    if found.representation == "quat":
        return found.q
    return found.q * np.copysign(1.0, found.q[..., :1])


@ways
def test_an_ensemble_is_its_single_runs(way):
    full = run(way, save_every=32)
    for n in (1, 2, 63, 64, 65):
        assert of(run(way, slice(n), save_every=32)) == of(full, slice(n)), n
    for b in (0, 62, 63, 64, 128, 199):
        assert of(run(way, slice(b, b + 1), save_every=32)) == of(full, slice(b, b + 1)), b


@ways
def test_threads_change_no_bit(way):
    one = of(run(way, save_every=32, n_threads=1))
    for k in (2, 3, 7):
        assert of(run(way, save_every=32, n_threads=k)) == one


@ways
def test_saves_change_no_bit(way):
    """Every k steps and at any times, in memory and handed out; of a few steps and of none too."""
    every = run(way, save_every=1)
    assert every.t.tolist() == (np.arange(STEPS + 1) * WAYS[way][1].get("dt", DT)).tolist()
    for k in (None, 1, 7, 64, STEPS, 2 * STEPS):
        steps = [STEPS] if k is None else [*range(0, STEPS, k), STEPS]
        found = run(way, save_every=k)
        assert found.t.tolist() == every.t[steps].tolist()
        assert of(found) == of(every, saves=steps), k
    for at in ((7, 100, STEPS), (7, 50.4, 100, 170.7, STEPS)):
        found = run(way, save_at=every.t[1] * np.array(at))
        on_grid = [k for k, step in enumerate(at) if step == int(step)]
        assert of(found, saves=on_grid) == of(every, saves=[7, 100, STEPS])
    for n in (0, 1, 63):
        few = run(way, n=n)
        assert of_one_sign(few).tobytes() == of_one_sign(every)[[n]].tobytes()
    steps = [*range(0, STEPS, 7), STEPS]
    for saves in ({"save_every": 7}, {"save_at": every.t[steps]}):
        pieces = []
        last = run(way, **saves, on_save=lambda x, p=pieces: p.append((x.t.copy(), x.state.copy())))
        t, states = map(np.concatenate, zip(*pieces, strict=True))
        assert t.tobytes() == every.t[steps].tobytes()
        assert states.tobytes() == every.state[steps].tobytes()
        assert of(last) == of(every, saves=[-1])


@ways
@pytest.mark.filterwarnings("ignore::fastatt.StepWarning", "ignore:status")
def test_neighbours_harm_nobody(way):
    """Rates that are too fast, some of which leave no number."""
    scene, options = given(way, save_every=32)
    alone = fa.propagate(scene, **options)
    bad = []
    if "w0" in options:
        w0 = options["w0"].copy()
        w0[[3, 64, 199], 0], w0[65], w0[130] = 1e200, 1e300, 1e9 if way in STEPPED else 1e200
        options["w0"], bad = w0, [3, 64, 65, 130, 199]
    if scene is RATE:
        fast = OWN[:, 1] + 1.0
        fast[[17, 40]] = 1e4, 1e6
        scene, bad = fa.Scene(rate=fa.rates.Coning(OWN[:, 0], fast)), [*bad, 17, 40]
    found = fa.propagate(scene, **options)
    others = np.setdiff1d(np.arange(N), bad)
    assert of(found, others) == of(alone, others)
    assert (found.status[bad] != 0).all()


@ways
def test_a_plan_gives_the_same(way):
    """Twice in the same memory, with another run between; copied too."""
    scene, options = given(way, save_every=64)
    wanted = of(fa.propagate(scene, t0=0.3, **options))
    start = {name: options.pop(name) for name in ("q0", "w0", "v0", "r0", "s0") if name in options}
    plan = fa.plan(scene, N, position="r0" in start, **options)
    assert of(plan(**start, t0=0.3)) == wanted
    assert of(plan(**start | {"q0": Q0[::-1]}, t0=0.3)) != wanted
    assert of(plan(**start, t0=0.3)) == wanted
    if "events" not in options:
        assert of(pickle.loads(pickle.dumps(plan))(**start, t0=0.3)) == wanted


@stepped
def test_a_resumed_run_is_the_whole_one(way, tmp_path):
    """Left anywhere, and again: within a divided step, after a block, at a sample; files."""
    events = {k: v for k, v in WAYS[way][1].items() if k == "events"}
    scene, whole, last = WAYS[way][0], run(way, save_every=1), 1
    begun = run(way, n=last)
    for first in (1, 25, 50, 51, 260):
        more = {"n_steps": first - last, "checkpoint": tmp_path / "checkpoint", **events}
        begun, last = fa.resume(scene, begun, **more), first
        begun.save_end(tmp_path / "end")
        steps, pieces = [first, *range((first // 4 + 1) * 4, STEPS, 4), STEPS], []
        options = {"n_steps": STEPS - first, "save_every": 4, **events}
        for end in (begun, tmp_path / "end", str(tmp_path / "checkpoint")):
            rest = fa.resume(scene, end, **options)
            np.testing.assert_allclose(rest.t, whole.t[steps], rtol=1e-15)
            assert of(rest) == of(whole, saves=steps)
        fa.resume(scene, begun, **options, on_save=lambda x, to=pieces: to.append(x.state.copy()))
        assert np.concatenate(pieces).tobytes() == rest.state.tobytes()


@ways
def test_parts_are_the_whole(way, monkeypatch):
    """Of bodies, and of steps between looks at events."""
    whole = of(run(way, save_every=32))
    monkeypatch.setattr(engine_run, "_EVENTS", 64)
    monkeypatch.setattr(plans, "PART", 64)
    assert of(run(way, save_every=32)) == whole


OF_EACH = [way for way in STEPPED if "compensated" not in WAYS[way][1]]
OFTEN = ["rate", "rk4", "rk4, matrices", "splitting", "clocks", "breakpoints", "switches", "events"]


@pytest.mark.parametrize("way", in_tiers(OFTEN, OF_EACH))
def test_steps_of_each_bodys_own(way, monkeypatch):
    """What each does alone, whatever its neighbours' steps; at saves on its own grid too."""
    counts = RNG.integers(20, 90, size=N)
    counts[33], size = 45, WAYS[way][1].get("dt", DT) / DT
    steps = {"dt": 1.5 * size / counts, "n": counts, "save_at": [0.0, 0.4 * size, 1.5 * size]}
    together = run(way, **steps)
    for b in (0, 33, N - 1):
        rows = slice(b, b + 1)
        own = {**steps, "dt": steps["dt"][b], "n": int(counts[b])}
        assert of(run(way, rows, **own)) == of(together, rows)
    assert of(run(way, n_threads=3, **steps)) == of(together)
    monkeypatch.setattr(plans, "PART", 64)
    assert of(run(way, **steps)) == of(together)


def test_numbers_in_any_form_are_the_same():
    """Rows given once, lists, arrays with gaps or of the other byte order, and a scene's copy."""
    wide = np.zeros((N, 8))
    wide[:, ::2] = Q0
    wanted = of(run("rk4"))
    for q0 in (wide[:, ::2], np.asfortranarray(Q0), Q0.tolist(), Q0.astype(">f8")):
        assert of(run("rk4", q0=q0)) == wanted
    one = of(run("rk4", q0=np.tile(Q0[1], (N, 1)), w0=np.tile(W0[2], (N, 1))))
    assert of(run("rk4", q0=np.tile(Q0[1], (N, 1)), w0=W0[2])) == one
    assert of(run("rk4", q0=Q0[1:2], w0=np.tile(W0[2], (N, 1)))) == one
    assert of(fa.propagate(replace(TORQUED, params=OWN.copy()), **given("rk4")[1])) == wanted


@each("representation", ATTITUDES)
def test_the_sign_of_attitudes_is_kept(representation, tmp_path):
    """From save to save, between them, in an attitude message, and in a file of saves."""
    body, start = fa.Scene(inertia=(3.0, 2.0, 1.0)), ([0.5, 0.5, -0.5, 0.5], [0.3, 2.0, 0.4])
    options = {"dt": 0.02, "n_steps": 3000, "save_every": 5, "method": "rk8"}
    options["representation"] = representation
    run = fa.propagate(body, *start, **options)
    to_file = fa.propagate(body, *start, **options, on_save=fa.to_file(tmp_path / "h.npy"))
    run.to_aem(tmp_path / "aem", epoch="2026-01-01T00:00:00", frame="ICRF")
    written = fa.interchange.read_aem(tmp_path / "aem").segments[0].q
    between = fa.interpolate(run, np.linspace(0.0, 60.0, 4001)).q
    ensemble = fa.propagate(body, [start[0]] * 2, start[1], **options).q
    pieces = []
    fa.propagate(body, *start, **options, on_save=lambda piece: pieces.append(piece.q.copy()))
    for q in (run.q, to_file.q, between, written, ensemble, np.concatenate(pieces)):
        assert ((q[1:] * q[:-1]).sum(axis=-1) > 0.9).all()
    wanted, _ = fa.closed_form.free_body(*start, body.inertia, run.t)
    assert fa.angle_between(run.q, wanted).max() < (0.1 if representation == "euler313" else 1e-4)
