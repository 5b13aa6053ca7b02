"""Cost against scale: bodies, steps, threads, calls, memory.

    python bench/scale.py                    # a minute: bench/SCALE.md and its picture
    python bench/scale.py --small --out DIR  # seconds

A free body by rk4, in double precision. A cell is the median over calls that fill a tenth of a
second, after one that is not counted; cells of more than 2e8 body-steps are left out. Memory and
speed of the largest ensemble are those of a process of its own (Linux: VmHWM).
"""

from __future__ import annotations

import argparse
import json
import os
import re
import subprocess
import sys
from functools import partial
from pathlib import Path
from statistics import median
from time import perf_counter

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

import fastatt as fa
from fastatt.plots.drawing import COLOURS, save
from fastatt.threads import default_threads
from fastatt.trade.measure import machine_line, processor_line

PICTURES = Path(__file__).parents[1] / "fastatt" / "docs" / "pictures"

FREE = fa.Scene(inertia=(2.0, 1.0, 2.0 / 3.0))
STEPS = (1, 100, 10_000)
MOST = 200_000_000  # body-steps of a cell
LARGE = 500  # steps of the largest ensemble


def states(n):
    """Initial attitudes and rates of n bodies."""
    q0, w0 = np.empty((n, 4)), np.empty((n, 3))
    q0[:], w0[:] = (1.0, 0.1, 0.2, 0.3), (0.1, 0.2, 0.3)
    w0[:, 0] += np.linspace(0.0, 0.1, n)
    return q0, w0


def seconds(call, least, together=1):
    """Median time of a call, of as many as take that long; short ones are timed some together."""
    call()
    taken = []
    while not taken or sum(taken) * together < least:
        begin = perf_counter()
        for _ in range(together):
            call()
        taken.append((perf_counter() - begin) / together)
    return median(taken)


def cost(n, steps, threads, least, method="rk4"):
    """Nanoseconds a body-step."""
    values = states(n)
    options = {"dt": 0.01, "n_steps": steps, "method": method, "n_threads": threads}
    return 1e9 * seconds(lambda: fa.propagate(FREE, *values, **options), least) / (n * steps)


def overheads(least):
    """Microseconds of one step by a plan's call, and by propagate."""
    rows = []
    for n in (1, 10, 100):
        values, options = states(n), {"dt": 0.01, "n_steps": 1, "method": "rk4"}
        plan = fa.plan(FREE, n, **options)
        calls = (partial(plan, *values), partial(fa.propagate, FREE, *values, **options))
        rows.append((n, *(1e6 * seconds(call, least, 100) for call in calls)))
    return rows


def by_default(most, least):
    """Of each method the largest ratio of the default's time to the better of one thread and all.

    Over numbers of body-steps from 10³ on, in steps of 2, of 128 bodies and of 4096.
    """
    worst = []
    for method in ("rk4", "strang2", "rk8", "gbs16"):
        ratios = []
        for n in (128, 4096):
            for k in range(10, int(np.log2(most))):
                if (steps := 2**k // n) > 0:
                    each = [cost(n, steps, x, least, method) for x in (None, 1, default_threads())]
                    ratios.append((each[0] / min(each[1:]), n, steps))
                    if each[1] * 2**k > 1e9:  # ns
                        break
        worst.append((method, *max(ratios)))
    return worst


def peak():
    """Most bytes of memory that this process had; getrusage counts what its parent had too."""
    told = Path("/proc/self/status").read_text(encoding="ascii")
    return 1024 * int(re.search(r"VmHWM:\s+(\d+)", told)[1])


def of_large(n):
    """Peak memory over inputs plus outputs, and nanoseconds a body-step, of one run."""
    options = {"dt": 0.01, "n_steps": LARGE, "method": "rk4"}
    fa.propagate(FREE, *states(1000), **options)
    before, values = peak(), states(n)
    begin = perf_counter()
    run = fa.propagate(FREE, *values, **options)
    taken = perf_counter() - begin
    arrays = [*values, run.state, run.norm_error, run.status, *run.carried.values()]
    return (peak() - before) / sum(x.nbytes for x in arrays), 1e9 * taken / (n * LARGE)


def large(n):
    """The same, of a process of its own."""
    root = Path(__file__).resolve().parents[1]
    found = subprocess.run(
        [sys.executable, __file__, "--large", str(n)],
        env={**os.environ, "PYTHONPATH": str(root)},
        check=True,
        capture_output=True,
        text=True,
    )
    return json.loads(found.stdout)


def cells(bodies, least):
    """{(threads, steps, bodies): ns a body-step}."""
    every = sorted({1, default_threads()})
    return {
        (threads, steps, n): cost(n, steps, threads, least)
        for threads in every
        for steps in STEPS
        for n in bodies
        if n * steps <= MOST
    }


def table(found, bodies):
    lines = [
        "| threads | steps | " + " | ".join(f"{n:.0e}" for n in bodies) + " |",
        "| --- | --- |" + " --- |" * len(bodies),
    ]
    for threads, steps in dict.fromkeys(key[:2] for key in found):
        each = [found.get((threads, steps, n)) for n in bodies]
        shown = ["" if x is None else f"{x:.3g}" for x in each]
        lines.append(f"| {threads} | {steps} | " + " | ".join(shown) + " |")
    return lines


def picture(found, path):
    """Time against bodies: a colour for each number of steps, a line style for each of threads."""
    figure = Figure(figsize=(8.0, 5.0), layout="constrained")
    figure.suptitle(f"Free bodies by rk4, float64, {processor_line()}")
    axes = figure.subplots()
    colours = dict(zip(STEPS, COLOURS, strict=False))
    threads = sorted({key[0] for key in found})
    styles = dict(
        zip(threads, ({"ls": "-", "marker": "o"}, {"ls": "--", "marker": "s"}), strict=False)
    )
    for k, steps in dict.fromkeys(key[:2] for key in found):
        points = [(n, x) for (*kind, n), x in found.items() if kind == [k, steps]]
        x, y = np.transpose(points)
        axes.loglog(x, y, color=colours[steps], **styles[k], ms=4)
    axes.set(xlabel="bodies", ylabel="time per body and step, ns")
    axes.grid(visible=True, alpha=0.3)
    shown = {
        f"{k} thread{'s' * (k > 1)}": Line2D([], [], color="k", **styles[k], ms=4) for k in threads
    }
    shown |= {f"{n} step{'s' * (n > 1)}": Line2D([], [], color=colours[n]) for n in STEPS}
    axes.legend(shown.values(), shown, frameon=False)
    save(figure, path)


def report(bodies, least, folder, pictures):
    found, few, big = cells(bodies, least), overheads(least), large(bodies[-1])
    threads = max(key[0] for key in found)
    default = by_default(1e5 if least == 0.0 else 1e8, 0.2 * least)
    middle = bodies[-3]
    beside = cost(middle, LARGE, None, 10.0 * least)
    one, several = (cost(middle, LARGE, k, 10.0 * least) for k in (1, threads))
    lines = [
        "# Cost against scale",
        "",
        "Made by `make scale`: a free body by rk4, final state, double precision.",
        f"Measured on {machine_line()}.",
        "",
        "## Nanoseconds a body-step, by number of bodies",
        "",
        *table(found, bodies),
        "",
        "![time per body and step against bodies](../fastatt/docs/pictures/scale.png)",
        "",
        "## Microseconds a call, of one step",
        "",
        "| bodies | plan | `propagate` |",
        "| --- | --- | --- |",
        *(f"| {n} | {a:.1f} | {b:.1f} |" for n, a, b in few),
        "",
        "## Threads by default",
        "",
        "The largest ratio of the time by default to the better of one thread and all, from 10³ to",
        "10⁸ body-steps, or a second:",
        "",
        "| method | ratio | bodies | steps |",
        "| --- | --- | --- | --- |",
        *(f"| {method} | {ratio:.2f} | {n} | {k} |" for method, ratio, n, k in default),
        "",
        "## Many bodies",
        "",
        f"| of {LARGE} steps | |",
        "| --- | --- |",
        f"| {bodies[-1]:.0e} bodies: peak memory over inputs plus outputs | {big[0]:.2f} |",
        f"| {bodies[-1]:.0e} bodies: speed over that of {middle:.0e} | {beside / big[1]:.2f} |",
        f"| {middle:.0e} bodies: speed of {threads} threads over one | {one / several:.2f} |",
    ]
    (folder / "SCALE.md").write_text("\n".join(lines) + "\n", encoding="utf-8")
    picture(found, pictures / "scale.png")


def main(arguments=None):
    parser = argparse.ArgumentParser(description="cost against bodies, steps and threads")
    parser.add_argument("--out", type=Path, help="folder; default: those of page and picture")
    parser.add_argument("--small", action="store_true", help="to 10^3 bodies, a call a cell")
    parser.add_argument("--large", type=int, help="one run of so many bodies, printed as JSON")
    given = parser.parse_args(arguments)
    if given.large:
        print(json.dumps(of_large(given.large)))
    else:
        bodies = [10**k for k in range(4 if given.small else 8)]
        least = 0.0 if given.small else 0.1
        report(bodies, least, given.out or Path(__file__).parent, given.out or PICTURES)


if __name__ == "__main__":
    main()
