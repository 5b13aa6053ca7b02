"""The tape of a run: in pieces as a whole, without a compiler (what it does: test_one_result)."""

import math

import numpy as np
import pytest

from fastatt.engine import tape
from fastatt.engine.tape import UNBROKEN, Action, Breaks, Steps, legs_of

MANY = 1 << 40


def saves_at(*times):
    return np.array(times, dtype=float), 1e-14 * np.abs(np.array(times, dtype=float))


def breaks_at(*times, jumps=()):
    at = np.array([0.0, *times])
    edges = np.array([-np.inf, *times, np.inf])
    there = np.array([x in jumps for x in at.tolist()])
    return Breaks(at, at, 1e-14 * np.abs(at), edges[:-1], edges[1:], there)


def pieces(*args, t0=0.0, pace=MANY, stops=(), **options):
    steps = Steps(*args, **options)
    return list(steps.pieces(t0, lambda: pace, stops))


def read(records):
    """The actions with the numbers that matter for each, and CLOCK where another one is used."""
    found, clock = [], None
    for x in records:
        later = max(0, int(x["action"]) - Action.JUMP)  # JUMP+1: of the second controller
        action = Action(int(x["action"]) - later)
        now = [float(x[name]) for name in tape.CLOCK]
        if not Action.FORK <= action <= Action.RESTORE and now != clock:
            found.append(f"CLOCK {round(now[0], 9):g} {round(now[1], 9):g}")
            clock = now
        numbers = {
            "STEPS": ("first", "end"), "SAVE": ("first", "slot"), "LEAVE": ("first",),
            "ENTER": ("first",), "JUMP": ("first",), "LOOK": ("first",), "MIDDLE": ("first",),
        }.get(action.name, ())  # fmt: skip
        found.append(" ".join([action.name + "+1" * later, *(f"{x[n]:g}" for n in numbers)]))
    return found


def test_the_time_of_the_start_moves_clocks_alone():
    legs, saves = legs_of(0.5, 3, UNBROKEN, 1.2), saves_at(0.7, 1.2)
    (a,), (b,) = (pieces(legs, saves, t0=t0) for t0 in (0.0, 7.0))
    assert (b.tape["begin"] == a.tape["begin"] + 7.0).all()
    names = [name for name in tape.RECORD.names if name != "begin"]
    assert (a.tape[names] == b.tape[names]).all()


def joined(found):
    """The actions of pieces without what begins and ends each."""
    actions = [x for piece in found for x in read(piece.tape)[2:-1] if x != "RESTORE"]
    steps = []
    for x in actions:  # blocks that were cut
        if x.startswith("STEPS") and steps and steps[-1].startswith("STEPS"):
            before, now = steps[-1].split(), x.split()
            if before[2] == now[1]:
                steps[-1] = f"STEPS {before[1]} {now[2]}"
                continue
        steps.append(x)
    return steps


@pytest.mark.parametrize("seed", range(30))
def test_pieces_are_the_whole(seed, monkeypatch):
    """Of random runs: whatever their length, each action comes once, in the same order."""
    rng = np.random.default_rng(seed)
    h, n = float(rng.choice([0.25, -0.1])), int(rng.integers(1, 40))
    end = None if rng.random() < 0.5 else (n - float(rng.uniform(0.1, 0.9))) * h
    last = n * h if end is None else end
    times = np.sort(rng.uniform(0.0, 1.0, 4)) * abs(last)
    breaks = np.sign(h) * np.sort(np.unique([*times, *(abs(h) * rng.integers(1, n + 1, 2))]))
    breaks = breaks[np.abs(breaks) < abs(last) - 1e-9]
    at = np.sort(np.concatenate([rng.uniform(0.0, abs(last), 8), [0.0, abs(last)]])) * np.sign(h)
    given = (
        legs_of(h, n, breaks_at(*breaks.tolist(), jumps=breaks[::2].tolist()), end),
        saves_at(*at),
    )
    options = {"every": int(rng.integers(0, 4)), "block": 4}
    wanted = joined(pieces(*given, **options))
    for pace in (1, 4, 9):
        found = pieces(*given, pace=pace, **options)
        assert joined(found) == wanted
        assert found[-1].saved == at.size
        assert found[-1].position == sum(given[0]["end"] - given[0]["first"])
        assert [x.position for x in found] == sorted({x.position for x in found})
    monkeypatch.setattr(tape, "_LEGS", 2)
    monkeypatch.setattr(tape, "_SAVES", 2)
    assert joined(pieces(*given, **options)) == wanted


def test_pieces_end_at_saves():
    found = pieces(legs_of(0.5, 100), saves_at(*(0.5 * np.arange(101))), stops=[16, 32])
    assert [(x.position, x.whole, x.saved) for x in found] == [
        (16, 16, 17),
        (32, 32, 33),
        (100, 100, 101),
    ]


def test_whole_steps_are_counted():
    found = pieces(legs_of(0.5, 3, breaks_at(0.7)), saves_at(1.5), pace=1, block=1)
    assert [x.whole for x in found] == [1, -1, 2, 3]


def test_every_save_is_made_once():
    """Of random runs, whose saves and breaks may be nearer to each other than rounding."""
    rng = np.random.default_rng(2)
    for _ in range(300):
        dt, t0 = float(rng.choice([0.05, 1.0, -0.3])), float(rng.choice([0.0, 10.0, 1e6]))
        end = float(rng.choice([1e-15, 4e-15, 1e-10, 0.3, 2.0])) * math.copysign(1.0, dt)
        slack = 16.0 * np.finfo(float).eps * (2.0 * abs(t0) + abs(end))
        cuts = np.sort(np.append(rng.uniform(0.0, 1.0, 3), rng.choice([0.5, 0.5 + 1e-14])))
        cuts = cuts[np.diff(cuts, prepend=-1.0) * abs(end) > slack] * end
        breaks = breaks_at(*cuts)
        breaks = breaks._replace(times=breaks.times + t0, slack=slack * (breaks.since != 0.0))
        at = end * np.sort([*rng.uniform(0.0, 1.0, 4), 0.0, 1.0, rng.choice([0.0, 1.0])])
        legs = legs_of(dt, max(1, math.ceil(abs(end / dt))), breaks, end)
        made = pieces(legs, (at, np.full(at.size, slack)), t0=t0, pace=1)
        slots = [x.tape["slot"][x.tape["action"] == Action.SAVE] for x in made]
        assert sorted(np.concatenate(slots)) == [*range(at.size)], (dt, t0, end, cuts)


def test_saves_at_the_ends_of_steps_copy_no_tile():
    """Rounding moves a save from the end of a step, a breakpoint or the end: it is still there."""
    rng = np.random.default_rng(20261129)
    eps = np.finfo(float).eps
    for _ in range(2000):
        n, dt = int(rng.integers(1, 12)), rng.uniform(0.01, 2.0) * rng.choice([1.0, -1.0])
        end = (n - 1 + rng.uniform(0.01, 0.99) ** rng.integers(1, 40)) * dt
        cuts = np.sort(rng.uniform(0.0, 1.0, rng.integers(0, 4)) * abs(end)) * math.copysign(
            1.0, dt
        )
        ends = np.sort(np.abs(np.concatenate([np.arange(n) * dt, cuts, [end]])))
        moved = ends * (1.0 + rng.integers(-7, 8, ends.size) * eps) * math.copysign(1.0, dt)
        steps = Steps(legs_of(dt, n, breaks_at(*cuts), end), (moved, 16.0 * eps * np.abs(moved)))
        assert not steps.forks
