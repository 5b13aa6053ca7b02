"""fastatt and the libraries that a user would pick instead: time at equal error.

Every contestant runs its whole ladder of tolerances or steps once, to find errors and what is worth
timing: settings within twice the best time of their library at their error. Those are timed in
rounds, all contestants of a problem in turn in every round, on one core: five rounds or more, of
which the shortest CPU time counts.
Compilation, layouts and what a library can prepare beforehand are left out; a call of ours is the
whole call. Peers that miss what they claim (an adapter's mistake) stop the run.
"""

from __future__ import annotations

import argparse
import math
import os
import sys
import warnings
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter

import numpy as np
from leaderboard_contestants import OURS, PACKAGES, contestants, missing, our_loop
from leaderboard_picture import picture
from leaderboard_problems import MANY, ONE, PROBLEMS, Log, Problem
from leaderboard_report import TARGETS, Row, page, ranking, read_rows
from leaderboard_solvers import Contestant, Run

from fastatt.trade.measure import machine_line, to_csv
from fastatt.trade.timing import ROUNDS, once, time_in_turns

_LONGEST = 0.25  # seconds of a call, beyond which a ladder ends
_ROUND_OFF = 1e-13  # rad
_SMALL = 0.5  # rad: beyond it an error is no power of the step yet
_SHORT = 0.01  # seconds of a call that is measured again at once
_WORTH = 1.5  # a setting this many times slower than its library's best at its error is not timed


@dataclass
class Timed:
    """A run, its error, its shortest time, and the first and third quartile of its times."""

    contestant: Contestant
    mode: str
    run: Run
    angles: np.ndarray
    seconds: float
    quartiles: Sequence[float] = (0.0, 0.0)

    @property
    def error(self) -> float:
        """Root mean square, rad."""
        return float(np.sqrt(np.mean(self.angles**2)))


def climb(
    problem: Problem | Log,
    contestant: Contestant,
    mode: str,
    rivals: Sequence[Timed],
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
            seconds, result = once(run.call)
            for _ in range(4 if seconds < _SHORT else 0):  # an interrupted call looks slow
                seconds = min(seconds, once(run.call)[0])
            timed = Timed(contestant, mode, run, problem.angles(run.attitudes(result)), seconds)
        if math.isfinite(timed.error):
            found.append(timed)
        # an order is seen in two errors that are small: to them a ladder goes whatever the time
        is_seen = contestant.order is None or sum(x.error < _SMALL for x in found) > 1
        if (seconds > longest and is_seen) or timed.error < _ROUND_OFF:
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
            if who.order is not None and ladder[-1].error > 1e-12:
                errors = [timed.error for timed in ladder[-2:]]
                sizes = [int(timed.run.setting.split()[0]) for timed in ladder[-2:]]
                fall, ratio = errors[0] / errors[-1], sizes[-1] / sizes[0]
                order = math.log(fall) / math.log(ratio) if ratio > 1.0 else math.nan
                if not order >= who.order - 0.3:
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


def take_turns(found: Sequence[Timed], budget: float, rounds: int = ROUNDS) -> None:
    """Time all runs in turns."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        times = time_in_turns([timed.run.call for timed in found], rounds, budget)
    for timed, (least, *quartiles) in zip(found, times, strict=True):
        timed.seconds, timed.quartiles = least, quartiles


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


def leaders(problem: Problem, found: Sequence[Timed]) -> list[str]:
    """Our methods that are first at an error, in double precision, of ensembles or one body."""
    rows = [
        row
        for row in rows_of(problem, found)
        if row.package == OURS and not row.method.endswith("float32")
    ]
    best = [
        ranking([row for row in rows if row.mode == mode], target)
        for mode in (ONE, MANY)
        for target in TARGETS
    ]
    return sorted({ranked[0].method for ranked in best if ranked})


def rows_of(problem: Problem | Log, found: Iterable[Timed]) -> list[Row]:
    return [
        Row(
            problem=problem.name,
            title=problem.title,
            reference=problem.reference,
            mode=timed.mode,
            package=timed.contestant.package,
            method=timed.contestant.method,
            setting=timed.run.setting,
            bound=timed.contestant.bound,
            error=timed.error,
            p50=float(np.quantile(timed.angles, 0.5)),
            p95=float(np.quantile(timed.angles, 0.95)),
            seconds=timed.seconds / problem.units(timed.mode),
            seconds_lower=timed.quartiles[0] / problem.units(timed.mode),
            seconds_upper=timed.quartiles[1] / problem.units(timed.mode),
            work=timed.run.work(),
        )
        for timed in found
    ]


def measure(
    problem: Problem | Log,
    packages: Iterable[str],
    *,
    quick: bool,
    budget: float,
) -> list[Row]:
    """All rows of a problem."""
    begin = perf_counter()
    found: list[Timed] = []

    def run(contestant: Contestant) -> None:
        for mode in (ONE, MANY):
            found.extend(climb(problem, contestant, mode, found))

    for package in packages:
        for contestant in contestants(problem, package, quick):
            run(contestant)
        # a step in a user's loop has no controller that is sampled
        if (
            package == OURS
            and isinstance(problem, Problem)
            and not (problem.sampled or problem.samples_of_control)
        ):
            for name in leaders(problem, found):
                run(our_loop(problem, name, quick))
    kept = found
    if isinstance(problem, Problem):
        check_claims(problem, found)
        kept = worth_timing(found)
    ready = perf_counter()
    take_turns(kept, budget, 1 if quick else ROUNDS)
    print(
        f"{problem.title}; reference: {problem.reference}\n"
        f"  {len(found)} settings in {ready - begin:.0f} s, {len(kept)} of them timed in "
        f"{perf_counter() - ready:.0f} s",
        flush=True,
    )
    return rows_of(problem, kept)


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure into leaderboard.csv; LEADERBOARD.md and leaderboard.png are made from it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--problem", action="append", choices=PROBLEMS, help="default: all")
    parser.add_argument("--package", action="append", choices=PACKAGES, help="default: all")
    parser.add_argument("--out", type=Path, default=Path("results"), help="folder of the figures")
    parser.add_argument("--page", type=Path, help="folder of the page; default: that of --out")
    parser.add_argument("--pictures", type=Path, help="folder of the picture; default: --out")
    parser.add_argument("--budget", type=float, default=10.0, help="timing of each problem, s")
    parser.add_argument("--quick", action="store_true", help="few bodies and settings, one round")
    parser.add_argument("--keep", action="store_true", help="keep the CSV's other problems")
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
            rows = [row for row in rows if row.problem != name] + new
            rows.sort(key=lambda row: list(PROBLEMS).index(row.problem))
            to_csv(path, rows)
    text = page(rows, f"One core of {machine_line()}.")
    folder = options.page or options.out
    (folder / "LEADERBOARD.md").write_text(text, encoding="utf-8")
    pictures = options.pictures or options.out
    pictures.mkdir(parents=True, exist_ok=True)
    picture(text, pictures / "leaderboard.png")


if __name__ == "__main__":
    main(sys.argv[1:])
