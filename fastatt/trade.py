"""The trade: every method's speed beside its error, on recordings and on a known answer."""

from __future__ import annotations

import csv
import math
import os
import platform
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass, fields
from importlib import metadata
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fastatt import checks, gyrolog, rates
from fastatt.arrays import angle_between
from fastatt.engine.pool import default_threads, progress_bar
from fastatt.integrate import integrate_rates, methods_for_samples
from fastatt.methods import METHODS
from fastatt.propagate import methods_for, propagate
from fastatt.scene import Scene

if TYPE_CHECKING:
    from fastatt import plots

T_END = 20.0
DEGREES = 180.0 / math.pi
# carried by the PyPI package scikit-kinematics: Xsens at 50 and 120 Hz, x-io NGIMU at 50 Hz
RECORDINGS = (
    "data_xsens.txt",
    "walking_xsens_lowerLeg.txt",
    "walking_xsens_upperLeg.txt",
    "data_ngimu/sensors.csv",
)
REFERENCE = "coning3"
_PANELS = {"rate function": "rate as a function of time", "samples": "rate as samples"}
# an inertial frame askew of the cone: about its own axis 3-1-3 angles are exact by accident
TILT = (0.48, -0.6, 0.64, 0.0)


@dataclass(frozen=True)
class Row:
    """One method at one step on the ensemble of coning bodies."""

    input: str
    method: str
    representation: str
    dtype: str
    dt: float
    error_median: float
    error_max: float
    defect_max: float
    seconds_per_body: float
    steps_per_second: float
    order: float | None


@dataclass(frozen=True)
class LogRow:
    """One method on one recording; angles in degrees."""

    recording: str
    method: str
    samples: int
    rate: float
    nanoseconds_per_sample: float
    difference_max: float
    difference_end: float
    half_rate_difference_max: float
    maker_difference_max: float | None


def best_time(call: Callable[[], Any], repeats: int) -> tuple[float, Any]:
    """Shortest of a few runs after a warm-up, and the result."""
    result = call()
    times = []
    for _ in range(repeats):
        begin = perf_counter()
        result = call()
        times.append(perf_counter() - begin)
    return min(times), result


def coning_attitudes(
    angle: NDArray[Any], frequency: NDArray[Any], t: NDArray[Any]
) -> NDArray[np.float64]:
    """Exact attitudes (S, N, 4) of ``rates.Coning`` bodies at times t (S,), in a tilted frame."""
    phase = frequency * t[:, None]
    c, s = np.cos(0.5 * angle), np.sin(0.5 * angle)
    x, y = s * np.cos(phase), s * np.sin(phase)
    a, b, d, _ = TILT
    columns = [a * c - b * x - d * y, a * x + b * c, a * y + d * c, b * y - d * x]
    return np.stack(np.broadcast_arrays(*columns), axis=-1)


def coning_trade(n_bodies: int, steps: Sequence[int], repeats: int, bar: bool) -> list[Row]:
    """Every method, representation and precision over a ladder of steps."""
    generator = np.random.default_rng(1)
    angle = generator.uniform(0.2, 1.5, n_bodies)
    frequency = generator.uniform(0.5, 2.0, n_bodies)
    scene = Scene(rate=rates.Coning(angle, frequency))
    q0 = coning_attitudes(angle, frequency, np.zeros(1))[0]
    exact = coning_attitudes(angle, frequency, np.array([T_END]))[0]
    cases = [
        (name, rep, dtype)
        for name in methods_for(scene)
        for rep in METHODS[name].representations
        for dtype in ("float64", "float32")
        if dtype == "float64" or rep == "quat"
    ]
    rows: list[Row] = []
    with progress_bar(bar, len(cases) + len(methods_for_samples()), "method") as done:
        for name, rep, dtype in cases:
            ladder = []
            for n in steps:
                seconds, result = best_time(
                    lambda n=n, name=name, rep=rep, dtype=dtype: propagate(  # type: ignore[misc]
                        scene, q0, dt=T_END / n, n_steps=n, method=name, representation=rep,
                        dtype=dtype,
                    ),
                    repeats,
                )  # fmt: skip
                error = angle_between(result.q[-1], exact)
                defect = float(np.abs(result.defect).max())
                ladder.append((n, error, defect, seconds))
            rows += _rows("rate function", name, rep, dtype, ladder, n_bodies)
            done(1)
        for name in methods_for_samples():
            ladder = []
            for n in steps:
                t = np.linspace(0.0, T_END, n + 1)
                data = coning_rates(angle, frequency, t)
                seconds, q = best_time(
                    lambda n=n, name=name, data=data: integrate_rates(  # type: ignore[misc]
                        data, T_END / n, q0, method=name
                    ),
                    repeats,
                )
                ladder.append((n, angle_between(q[:, -1], exact), 0.0, seconds))
            rows += _rows("samples", name, "quat", "float64", ladder, n_bodies)
            done(1)
    return rows


def coning_rates(
    angle: NDArray[Any], frequency: NDArray[Any], t: NDArray[Any]
) -> NDArray[np.float64]:
    """Samples (N, n, 3) of the body rates of ``rates.Coning`` at times t (n,)."""
    a, f = angle[:, None], frequency[:, None]
    axial = np.broadcast_to(-2.0 * f * np.sin(0.5 * a) ** 2, (angle.size, t.size))
    return np.stack([-f * np.sin(a) * np.sin(f * t), f * np.sin(a) * np.cos(f * t), axial], axis=-1)


def _rows(
    source: str, name: str, rep: str, dtype: str, ladder: list[Any], n_bodies: int
) -> list[Row]:
    rows: list[Row] = []
    for i, (n, error, defect, seconds) in enumerate(ladder):
        median = float(np.median(error))
        before = ladder[i - 1] if i else None
        order = None
        if before is not None and median > 0.0:
            order = math.log(float(np.median(before[1])) / median) / math.log(n / before[0])
        rows.append(
            Row(
                input=source,
                method=name,
                representation=rep,
                dtype=dtype,
                dt=T_END / n,
                error_median=median,
                error_max=float(np.max(error)),
                defect_max=defect,
                seconds_per_body=seconds / n_bodies,
                steps_per_second=n_bodies * n / seconds,
                order=order,
            )
        )
    return rows


def find_recordings() -> list[Path]:
    """The gyro recordings that scikit-kinematics installs.

    Raises ``ImportError`` when the package, or its recordings, are not installed.
    """
    try:
        files = metadata.files("scikit-kinematics") or []
    except metadata.PackageNotFoundError:
        files = []
    found = {
        name: Path(str(f.locate()))
        for name in RECORDINGS
        for f in files
        if str(f).endswith(f"tests/data/{name}")
    }
    if len(found) < len(RECORDINGS):
        raise ImportError(
            "trade: needs the recordings of scikit-kinematics; install them with "
            "pip install 'fastatt[trade]', or name logs with --log"
        )
    return [found[name] for name in RECORDINGS]


def log_rows(log: gyrolog.GyroLog, repeats: int, max_gap: float | None = None) -> list[LogRow]:
    """Every method on one log.

    Its difference from the reference, from itself at half the rate, and from the maker's
    orientation where the log has it.
    """
    q0 = np.array([1.0, 0.0, 0.0, 0.0]) if log.attitudes is None else log.attitudes[0]
    n = len(log.rates)
    even = np.arange(0, n, 2)
    half_dt = np.diff(log.t[even]) if isinstance(log.dt, np.ndarray) else 2.0 * log.dt
    half_gap = None if max_gap is None else 2.0 * max_gap

    def attitudes(name: str) -> NDArray[Any]:
        return integrate_rates(log.rates, log.dt, q0, method=name, max_gap=max_gap)

    reference = attitudes(REFERENCE)
    rows = []
    for name in methods_for_samples():
        seconds, q = best_time(lambda name=name: attitudes(name), repeats)  # type: ignore[misc]
        half = integrate_rates(log.rates[even], half_dt, q0, method=name, max_gap=half_gap)
        away = angle_between(q, reference) * DEGREES
        maker = None
        if log.attitudes is not None:
            maker = float(angle_between(q, log.attitudes).max() * DEGREES)
        rows.append(
            LogRow(
                recording=log.path.name,
                method=name,
                samples=n,
                rate=log.rate,
                nanoseconds_per_sample=seconds / n * 1e9,
                difference_max=float(away.max()),
                difference_end=float(away[-1]),
                half_rate_difference_max=float(angle_between(half, q[even]).max() * DEGREES),
                maker_difference_max=maker,
            )
        )
    return rows


def compare_on_log(log: gyrolog.GyroLog, method: str, max_gap: float | None = None) -> str:
    """Table: how far the methods differ on a log, and what the sample rate itself costs."""
    rows = log_rows(log, repeats=1, max_gap=max_gap)
    table = log_table(rows)
    own = next(r for r in rows if r.method == method)
    spread = max(r.difference_max for r in rows if r.method in ("previous", "coning2"))
    verdict = (
        "the sample rate is what limits, more than the method"
        if own.half_rate_difference_max > spread
        else "the method matters more than the sample rate"
    )
    return (
        f"{table}\nhalf the samples change {method} by {own.half_rate_difference_max:.2g} deg, "
        f"the choice among previous, coning2 and coning3 by {spread:.2g} deg: {verdict}"
    )


def log_table(rows: Iterable[LogRow]) -> str:
    """The rows of one or more recordings as text."""
    head = (
        f"{'recording':26} {'method':16} {'ns/sample':>9} {'max diff':>9} {'end diff':>9} "
        f"{'half rate':>9} {'maker':>7}   (deg; diff from {REFERENCE})"
    )
    lines = [head]
    for r in rows:
        maker = "" if r.maker_difference_max is None else f"{r.maker_difference_max:.2f}"
        lines.append(
            f"{r.recording:26} {r.method:16} {r.nanoseconds_per_sample:9.1f} "
            f"{r.difference_max:9.2g} {r.difference_end:9.2g} "
            f"{r.half_rate_difference_max:9.2g} {maker:>7}"
        )
    return "\n".join(lines)


def trade_table(rows: Iterable[Row]) -> str:
    """The rows of the ensemble as text."""
    head = (
        f"{'input':13} {'method':13} {'rep':15} {'dtype':8} {'dt, s':>7} {'median, rad':>11} "
        f"{'max, rad':>9} {'defect':>8} {'order':>6} {'M steps/s':>9}"
    )
    lines = [head]
    for r in rows:
        order = "" if r.order is None else f"{r.order:.2f}"
        lines.append(
            f"{r.input:13} {r.method:13} {r.representation:15} {r.dtype:8} {r.dt:7.4f} "
            f"{r.error_median:11.2e} {r.error_max:9.1e} {r.defect_max:8.1e} {order:>6} "
            f"{r.steps_per_second / 1e6:9.0f}"
        )
    return "\n".join(lines)


def frontier(rows: Iterable[Row]) -> list[Row]:
    """The rows that no other beats in both error and time, fastest first."""
    best: list[Row] = []
    for row in sorted(rows, key=lambda r: (r.seconds_per_body, r.error_median)):
        if not best or row.error_median < best[-1].error_median:
            best.append(row)
    return best


def ladders(rows: Sequence[Row]) -> list[plots.Ladder]:
    """A curve for each method on quaternions and on matrices."""
    from fastatt import plots

    keys = dict.fromkeys(
        (r.method, r.representation) for r in rows if r.representation in ("quat", "dcm")
    )
    found = []
    for method, rep in keys:
        own = [r for r in rows if (r.method, r.representation) == (method, rep)]
        found.append(
            plots.Ladder(
                method, rep, [r.seconds_per_body for r in own], [r.error_median for r in own]
            )
        )
    return found


def departures(log: gyrolog.GyroLog) -> plots.Departures:
    """Each method's angle from the reference on a recording, and the maker's orientation's."""
    from fastatt import plots

    q0 = np.array([1.0, 0.0, 0.0, 0.0]) if log.attitudes is None else log.attitudes[0]

    def attitudes(name: str) -> NDArray[Any]:
        return integrate_rates(log.rates, log.dt, q0, method=name)

    base = attitudes(REFERENCE)
    angles = {
        name: angle_between(attitudes(name), base)[1:] * DEGREES
        for name in methods_for_samples()
        if name != REFERENCE
    }
    maker = None if log.attitudes is None else angle_between(base, log.attitudes)[1:] * DEGREES
    return plots.Departures(f"{log.path.name}, {log.rate:.4g} Hz", log.t[1:], angles, maker)


def write_csv(path: Path, rows: Sequence[Any]) -> None:
    """Rows of one dataclass with a line of names."""
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, [f.name for f in fields(rows[0])])
        writer.writeheader()
        writer.writerows(asdict(row) for row in rows)


def machine() -> str:
    """What the figures were measured on."""
    model = platform.processor() or platform.machine()
    info = Path("/proc/cpuinfo")
    if info.exists():
        lines = info.read_text().splitlines()
        names = [ln.split(":", 1)[1].strip() for ln in lines if ln.startswith("model name")]
        model = names[0] if names else model
    threads = default_threads()
    return f"{model}, {threads} of {os.cpu_count()} threads, Python {platform.python_version()}"


def run_trade(
    out: Path,
    *,
    logs: Sequence[Path] | None = None,
    n_bodies: int = 4096,
    quick: bool = False,
    progress: bool = False,
) -> None:
    """Print the tables; leave ``recordings.csv``, ``trade.csv`` and a picture of each in ``out``.

    Raises ``ImportError`` when matplotlib or the recordings are missing, ``ValueError`` for a log
    that can't be read.
    """
    checks.whole("--bodies", n_bodies, 1)
    try:
        from fastatt import plots
    except ImportError:
        raise ImportError("trade: needs matplotlib; pip install 'fastatt[plot]'") from None
    paths = find_recordings() if logs is None else list(logs)
    out.mkdir(parents=True, exist_ok=True)
    repeats = 1 if quick else 3
    print(machine())
    read = [gyrolog.read_log(path) for path in paths]
    of_logs = [row for log in read for row in log_rows(log, repeats)]
    print(f"\nRecordings\n{log_table(of_logs)}")
    write_csv(out / "recordings.csv", of_logs)
    plots.recordings([departures(log) for log in read], REFERENCE, out / "recordings.png")
    steps = (50, 100) if quick else (50, 100, 200, 400, 800, 1600)
    print(f"\nEnsemble of {n_bodies} coning bodies over {T_END:g} s, against the exact attitude")
    rows = coning_trade(n_bodies, steps, repeats, progress)
    print(trade_table(rows))
    write_csv(out / "trade.csv", rows)
    panels, frontiers = {}, {}
    for source, title in _PANELS.items():
        own = [r for r in rows if r.input == source]
        drawn = [r for r in own if r.dtype == "float64"]
        panels[title] = ladders(drawn)
        best = frontier(drawn)
        frontiers[title] = plots.Ladder(
            "", "", [r.seconds_per_body for r in best], [r.error_median for r in best]
        )
        print(f"\nFrontier, {title}: the cheapest way to each error\n{trade_table(frontier(own))}")
    plots.work_precision(panels, frontiers, T_END, out / "trade.png")
    print(f"\n{out}: recordings.csv, recordings.png, trade.csv, trade.png")
