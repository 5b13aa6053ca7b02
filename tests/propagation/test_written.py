"""No slot of a result is left as memory was: all are NaN first, and numbers at the end."""

import math

import numpy as np
import pytest
from each import each

import fastatt as fa
from fastatt.engine.run import Results
from fastatt.engine.tape import Action, Breaks, Steps, legs_of

BODY = fa.Scene(inertia=(3.0, 2.0, 1.0))
START = [1.0, 0.0, 0.0, 0.0], [0.1, 0.5, 0.2]
# of times up to 10 s, and the ends that rounding does not tell from the start
NEAR = 9.99999999999998, 10.0


@pytest.fixture(autouse=True)
def _unwritten(monkeypatch):
    """New arrays of results hold NaN, and flags that no run sets."""
    empty = Results.empty.__func__

    def filled(cls, *args):
        results = empty(cls, *args)
        results.saves.fill(np.nan)
        results.status.fill(255)
        return results

    monkeypatch.setattr(Results, "empty", classmethod(filled))


def is_written(run):
    parts = [run.q, run.w, run.norm_error]
    return all(np.isfinite(x).all() for x in parts) and (run.status == 0).all()


WAYS = {
    "t_end": {"t_end": 10.0},
    "save_every": {"t_end": 10.0, "save_every": 1},
    "save_at": {"save_at": [10.0]},
    "save_at both": {"save_at": list(NEAR)},
    "before the end": {"save_at": [10.0], "t_end": 10.00001},
    "event": {"t_end": 10.0, "events": [fa.event(lambda t, q, w, p: w[0])]},
    "terminal": {"t_end": 10.0, "events": [fa.event(lambda t, q, w, p: w[0] - 2.0, terminal=True)]},
    "per body": {"dt": [0.05, 0.04, 0.03], "t_end": 10.0},
    "ring": {"save_at": list(NEAR), "on_save": lambda piece: None},
    "float32": {"t_end": 10.0, "dtype": "float32"},
    "compensated": {"t_end": 10.0, "compensated": True, "normalise": 1},
}


@each("way", WAYS)
@each("method", ("rk4", "rk8", "dmv10", "exact"))
def test_an_end_within_rounding_of_the_start_is_the_state_there(way, method):
    options = {"dt": 0.05, "t0": NEAR[0], "method": method, **WAYS[way]}
    if (method == "exact" and {"events", "compensated"} & options.keys()) or (
        way == "compensated" and not fa.METHODS[method].compensates
    ):
        return  # refused
    start = (np.tile(x, (3, 1)) for x in START)
    run = fa.propagate(BODY, *start, **options)
    assert is_written(run)
    assert np.abs(run.q - START[0]).max() < 1e-5
    assert np.abs(run.w - START[1]).max() < 1e-5


def test_a_loop_to_an_end():
    """The last run is as short as the rounding of its times; no warning tells of its step."""
    (q, w), t = START, 0.0
    while t < 10.0:
        end = min(t + 0.1, 10.0)
        run = fa.propagate(BODY, q, w, t0=t, dt=0.05, t_end=end, method="rk8")
        assert is_written(run)
        q, w, t = run.q[-1], run.w[-1], end
    right, _ = fa.closed_form.free_body(*START, (3.0, 2.0, 1.0), 10.0)
    assert fa.angle_between(q, right) < 1e-12


def test_backwards_and_at_once():
    back = fa.propagate(BODY, *START, dt=-0.05, t0=NEAR[1], t_end=NEAR[0], method="rk8")
    still = fa.propagate(BODY, *START, dt=0.05, n_steps=0, method="rk8", save_every=1)
    assert is_written(back)
    assert is_written(still)


def test_every_save_of_random_runs_is_made_once():
    """Legs and saves at random, some nearer to each other than rounding."""
    rng = np.random.default_rng(2)
    for _ in range(300):
        dt, t0 = float(rng.choice([0.05, 1.0, -0.3])), float(rng.choice([0.0, 10.0, 1e6]))
        end = float(rng.choice([1e-15, 4e-15, 1e-10, 0.3, 2.0])) * math.copysign(1.0, dt)
        slack = 16.0 * np.finfo(float).eps * (2.0 * abs(t0) + abs(end))
        cuts = np.sort(np.append(rng.uniform(0.0, 1.0, 3), rng.choice([0.5, 0.5 + 1e-14])))
        cuts = cuts[np.diff(cuts, prepend=-1.0) * abs(end) > slack] * end
        n, wide = len(cuts) + 1, np.inf
        breaks = Breaks(
            np.append(0.0, cuts) + t0, np.append(0.0, cuts), np.append(0.0, np.full(n - 1, slack)),
            np.full(n, -wide), np.full(n, wide), np.zeros(n, np.bool_),
        )  # fmt: skip
        steps = max(1, math.ceil(abs(end / dt)))
        saves = (
            np.sort(np.append(rng.uniform(0.0, 1.0, 4), [0.0, 1.0, rng.choice([0.0, 1.0])])) * end
        )
        tape = Steps(legs_of(dt, steps, breaks, end), (saves, np.full(saves.size, slack)))
        made = [
            piece.tape["slot"][piece.tape["action"] == Action.SAVE]
            for piece in tape.pieces(t0, lambda: 1)
        ]
        assert sorted(np.concatenate(made)) == [*range(saves.size)], (dt, t0, end, cuts)
