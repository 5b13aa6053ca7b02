"""fastatt and the libraries that a user would pick instead: time at equal error.

Every contestant runs its whole ladder of tolerances or steps once, to find errors and what is worth
timing: settings within twice the best time of their library at their error. Those are timed in
rounds, all contestants of a problem in turn in every round, on one core; the shortest time counts.
Compilation, layouts and what a library can prepare beforehand are left out; a call of ours is the
whole call. Peers that miss what they claim (an adapter's mistake) stop the run.
"""

from __future__ import annotations

import argparse
import gc
import math
import os
import sys
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from leaderboard_contestants import PACKAGES, Contestant, Run, contestants, missing
from leaderboard_problems import MANY, ONE, PROBLEMS, Log, Problem
from leaderboard_report import Row, picture, read_rows, table, times, write_rows

from fastatt.trade.measure import machine

_LONGEST = 0.7  # seconds of a call, beyond which a ladder ends
_LONG = 0.1  # seconds of a call that is timed in the least number of rounds
_ROUND_OFF = 1e-13  # rad
_SHORT = 0.01  # seconds of a call that is measured again at once
_WORTH = 2.0  # a setting this many times slower than its library's best at its error is not timed
_LEAST = 1e-3  # seconds of one timing, reached by repeating a call
_ROUNDS = (2, 25)


@dataclass
class Timed:
    """A run, its error and its shortest time so far."""

    contestant: Contestant
    mode: str
    run: Run
    error: float
    seconds: float
    repeats: int = 1


def _once(call: Callable[[], Any]) -> tuple[float, Any]:
    begin = perf_counter()
    result = call()
    return perf_counter() - begin, result


def climb(
    problem: Problem | Log, contestant: Contestant, mode: str, rivals: Sequence[Timed]
) -> list[Timed]:
    """A contestant's ladder, up to round-off or to where it takes too long.

    That is seconds, or more than another run of its library takes down to round-off.
    """
    found: list[Timed] = []
    exact = [
        rival.seconds
        for rival in rivals
        if rival.contestant.package == contestant.package
        and rival.mode == mode
        and rival.error < _ROUND_OFF
    ]
    longest = min([_LONGEST, *(_WORTH * seconds for seconds in exact)])
    for run in contestant.ladder(mode):
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")  # of coarse settings, which say that they are coarse
            run.call()  # compiles
            seconds, result = _once(run.call)
            for _ in range(4 if seconds < _SHORT else 0):  # an interrupted call looks slow
                seconds = min(seconds, _once(run.call)[0])
            error = problem.error(run.attitudes(result))
        if math.isfinite(error):
            found.append(Timed(contestant, mode, run, error, seconds))
        if seconds > longest or error < _ROUND_OFF:
            break
    return found


def check_claims(problem: Problem, found: Sequence[Timed]) -> None:
    """Raise ``AssertionError`` where a contestant misses what its library claims."""
    for mode in (ONE, MANY):
        ladders: dict[Contestant, list[Timed]] = {}
        for timed in found:
            if timed.mode == mode:
                ladders.setdefault(timed.contestant, []).append(timed)
        for who, ladder in ladders.items():
            name = f"{problem.name}, {who.package} {who.method}, {mode}"
            for timed in ladder if who.claim is not None else []:
                allowed = who.claim * problem.growth * max(timed.run.tol, _ROUND_OFF)
                if timed.error > allowed:
                    raise AssertionError(f"{name}: {timed.error:.1e} rad at {timed.run.setting}")
            if who.order is not None:
                (coarse, middle), n = (t.error for t in ladder[-2:]), len(ladder)
                sizes = [int(t.run.setting.split()[0]) for t in ladder[-2:]]
                order = math.log(coarse / middle) / math.log(sizes[1] / sizes[0])
                if n < 2 or (middle > 1e-12 and order < who.order - 0.3):
                    raise AssertionError(f"{name}: order {order:.2f}, not {who.order:g}")


def worth_timing(found: Sequence[Timed]) -> list[Timed]:
    """What is near the best of its library and mode at its error."""
    kept = []
    for timed in found:
        rivals = [
            other.seconds
            for other in found
            if other.contestant.package == timed.contestant.package
            and other.mode == timed.mode
            and other.error <= timed.error
        ]
        if timed.seconds <= _WORTH * min(rivals):
            kept.append(timed)
    return kept


def time_in_turn(found: Sequence[Timed], budget: float, rounds: tuple[int, int]) -> int:
    """Rounds over all runs, each of which keeps its shortest time; gives how many there were.

    Long calls take part in the first rounds only.
    """
    for timed in found:
        timed.repeats = max(1, math.ceil(_LEAST / max(timed.seconds, 1e-9)))
    begin, done = perf_counter(), 0
    while done < rounds[0] or (done < rounds[1] and perf_counter() - begin < budget):
        gc.collect()
        gc.disable()
        for timed in found:
            if done >= rounds[0] and timed.seconds > _LONG:
                continue
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                start = perf_counter()
                for _ in range(timed.repeats):
                    timed.run.call()
                seconds = (perf_counter() - start) / timed.repeats
            timed.seconds = min(timed.seconds, seconds)
        gc.enable()
        done += 1
    return done


@contextmanager
def one_core() -> Iterator[None]:
    """Keep this process, whatever threads it starts, on one core, where the system can."""
    if not hasattr(os, "sched_setaffinity"):
        yield
        return
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {max(before)})
    try:
        yield
    finally:
        os.sched_setaffinity(0, before)


def measure(
    problem: Problem | Log, packages: Iterable[str], *, quick: bool, budget: float
) -> list[Row]:
    """All rows of a problem."""
    begin = perf_counter()
    found: list[Timed] = []
    for package in packages:
        for contestant in contestants(problem, package, quick):
            for mode in (ONE, MANY):
                found += climb(problem, contestant, mode, found)
    if isinstance(problem, Problem):
        check_claims(problem, found)
        kept = worth_timing(found)
    else:
        kept = found
    ready = perf_counter()
    done = time_in_turn(kept, budget, (1, 1) if quick else _ROUNDS)
    print(
        f"{problem.title}; reference: {problem.reference}\n"
        f"  {len(found)} settings in {ready - begin:.0f} s, {len(kept)} of them timed in {done} "
        f"rounds in {perf_counter() - ready:.0f} s",
        flush=True,
    )
    return [
        Row(
            problem=problem.name,
            title=problem.title,
            mode=timed.mode,
            package=timed.contestant.package,
            method=timed.contestant.method,
            setting=timed.run.setting,
            error=timed.error,
            seconds=timed.seconds / problem.units(timed.mode),
        )
        for timed in kept
    ]


def versions(packages: Iterable[str]) -> str:
    """The libraries and their versions in a line."""
    told = []
    for name in packages:
        try:
            told.append(f"{name} {metadata.version(name)}")
        except metadata.PackageNotFoundError:
            told.append(name)
    return ", ".join(told)


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure, and leave leaderboard.csv, .md and .png in a folder."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--problem", action="append", choices=PROBLEMS, help="default: all")
    parser.add_argument("--package", action="append", choices=PACKAGES, help="default: all")
    parser.add_argument("--out", type=Path, default=Path("results"), help="folder")
    parser.add_argument("--budget", type=float, default=10.0, help="timing of each problem, s")
    parser.add_argument("--quick", action="store_true", help="few bodies and settings, one round")
    parser.add_argument(
        "--keep", action="store_true", help="keep the rows of other problems in the CSV"
    )
    parser.add_argument("--draw", action="store_true", help="only draw the CSV that is there")
    options = parser.parse_args(arguments)

    packages = options.package or list(PACKAGES)
    absent = [name for name in missing() if name in packages]
    packages = [name for name in packages if name not in absent]
    if absent:
        print("not installed, left out: " + ", ".join(absent))
    path = options.out / "leaderboard.csv"
    options.out.mkdir(parents=True, exist_ok=True)
    rows = read_rows(path) if (options.keep or options.draw) and path.exists() else []
    with one_core():
        for name in [] if options.draw else options.problem or PROBLEMS:
            problem = PROBLEMS[name](options.quick)
            new = measure(problem, packages, quick=options.quick, budget=options.budget)
            rows = [row for row in rows if row.problem != problem.name] + new
            rows.sort(key=lambda row: list(PROBLEMS).index(row.problem))
            write_rows(path, rows)
    where = f"one core of {machine()['processor']}"
    lines = [table(rows), "", f"{where}; {versions(packages)}"]
    (options.out / "leaderboard.md").write_text("\n".join(lines) + "\n", encoding="utf-8")
    picture(rows, f"Time at equal error, {where}", options.out / "leaderboard.png")
    print(times(rows), *lines, sep="\n")


if __name__ == "__main__":
    main(sys.argv[1:])
