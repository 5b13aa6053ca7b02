"""What the leaderboard's rows say: curves, winners and the tables."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path

from leaderboard_contestants import DISTRIBUTIONS, OURS, PACKAGES
from leaderboard_problems import MANY, ONE

from fastatt.trade.timing import TIE

TARGETS = (1e-3, 1e-6, 1e-9, 1e-12)
MODES = {ONE: "one", MANY: "ensemble"}
_MOST = 1000.0
_FIGURES = ("error", "p50", "p95", "seconds", "work", "seconds_lower", "seconds_upper")
_SETTINGS = {
    OURS: "`fa.plan` beforehand; in a loop: `fa.single_step`, or closed-form kernels, in `@njit`",
    "heyoka": "unrolled; ensembles in batches of the machine's vector, 1 to 8 bodies a system; "
    "one body by `taylor_adaptive`",
    "CyRK": "`nbsolve2_ivp` in `@njit`, compiled equations, rtol = atol",
    "scipy": "`solve_ivp`, `odeint`, `ode`, compiled equations, rtol = atol; ensembles in an array",
    "diffrax": "`jit`, `vmap`, 64 bits, `PIDController`, rtol = atol, `ForwardMode`",
    "MuJoCo": "a free joint, no contacts, `rollout` in C",
    "Basilisk": "a hub, `svIntegratorRK4`; the simulation is built and reset beforehand; with "
    "wheels `scenarioAttitudeFeedbackRW` without orbit and records, built beforehand",
    "Exudyn": "a body with a rotation vector, `RK67`; the gravity gradient is a Python function",
    "numpy-quaternion": "`integrate_angular_velocity`; samples: mean rates, `exp`, "
    "`multiply.accumulate`",
    "ahrs": "`AngularRate`, mean rates",
    "scikit-kinematics": "`calc_quat`, mean rates",
}


@dataclass(frozen=True)
class Row:
    """One setting of one method: errors, rad, and seconds per body, of a log per sample.

    ``error`` is the root mean square; ``seconds`` is the least of several times, with their
    quartiles; ``work`` counts the operations of a body, 0 if unknown.
    """

    problem: str
    title: str
    reference: str
    mode: str
    package: str
    method: str
    setting: str
    bound: str
    error: float
    p50: float
    p95: float
    seconds: float
    work: float
    seconds_lower: float = math.nan
    seconds_upper: float = math.nan


@dataclass(frozen=True)
class Best:
    """The shortest time of a library at an error, and the method; what bounds it.

    ``row``: the coarsest setting that reaches the error.
    """

    package: str
    method: str
    seconds: float
    row: Row


def read_rows(path: Path) -> list[Row]:
    with path.open(encoding="utf-8", newline="") as file:
        return [
            Row(**{k: float(x) if k in _FIGURES else x for k, x in row.items()})
            for row in csv.DictReader(file)
        ]


def envelope(points: Iterable[tuple[float, float]]) -> list[tuple[float, float]]:
    """The (error, seconds) that no other point beats in both, the largest error first."""
    found: list[tuple[float, float]] = []
    for error, seconds in sorted(points, key=lambda point: (point[1], point[0])):
        if not found or error < found[-1][0]:
            found.append((error, seconds))
    return found


def time_at(points: Iterable[tuple[float, float]], target: float) -> float | None:
    """Seconds at an error, between points of the envelope on a line in logarithms.

    None where no point reaches it; a curve that begins below it is worth its first point.
    """
    curve = envelope(points)
    if not curve or curve[-1][0] > target:
        return None
    k = next(i for i, (error, _) in enumerate(curve) if error <= target)
    if k == 0:
        return curve[0][1]
    (e0, t0), (e1, t1) = curve[k - 1], curve[k]
    share = math.log(e0 / target) / math.log(e0 / max(e1, 1e-300))
    return math.exp(math.log(t0) + share * math.log(t1 / t0))


def ranking(rows: Sequence[Row], target: float) -> list[Best]:
    """Each library's best method at an error, the fastest first."""
    curves: dict[tuple[str, str], list[Row]] = {}
    for row in rows:
        curves.setdefault((row.package, row.method), []).append(row)
    found: dict[str, Best] = {}
    for (package, method), own in curves.items():
        seconds = time_at([(row.error, row.seconds) for row in own], target)
        if seconds is not None and (package not in found or seconds < found[package].seconds):
            row = min((r for r in own if r.error <= target), key=lambda r: r.seconds)
            found[package] = Best(package, method, seconds, row)
    return sorted(found.values(), key=lambda best: best.seconds)


def of_mode(rows: Sequence[Row], problem: str, mode: str) -> list[Row]:
    """Rows that a user may choose from: an ensemble can be run one body a call too."""
    return [row for row in rows if row.problem == problem and mode in (MANY, row.mode)]


def ratio(x: float) -> str:
    return f"{x:.2f}" if x < 1.995 else f"{x:.1f}" if x < 9.95 else f"{x:.0f}"


def two(ranked: Sequence[Best]) -> tuple[Best | None, Best | None]:
    """Ours and the best peer."""
    ours = next((best for best in ranked if best.package == OURS), None)
    return ours, next((best for best in ranked if best.package != OURS), None)


def verdict(ranked: Sequence[Best]) -> str:
    """Ours against the best peer: who wins by which ratio, in bold where we lose; ties are told."""
    ours, peer = two(ranked)
    if ours is None or peer is None:
        alone = f"`{ours.method}` alone" if ours else f"**{peer.package} alone**" if peer else ""
        return alone or "none"
    lead = peer.seconds / ours.seconds
    if 1.0 / TIE <= lead <= TIE:
        return f"tie: `{ours.method}`, {peer.package}"
    if lead > _MOST:
        return f"`{ours.method}` >1000× {peer.package} ({peer.row.bound})"
    if lead > 1.0:
        return f"`{ours.method}` {ratio(lead)}× {peer.package}"
    return f"**{peer.package} {ratio(1.0 / lead)}×** `{ours.method}`"


def _problems(rows: Sequence[Row]) -> dict[str, str]:
    """Name to title, in the order of the rows."""
    return {row.problem: row.title for row in rows}


def _is_log(rows: Sequence[Row]) -> bool:
    return all(row.setting == "" for row in rows)


def table(rows: Sequence[Row]) -> str:
    """Markdown: a line for each problem and mode."""
    lines = _head("problem", "bodies", *(f"{x:.0e} rad" for x in TARGETS))
    for name, title in _problems(rows).items():
        if _is_log([row for row in rows if row.problem == name]):
            continue
        for mode, label in MODES.items():
            own = of_mode(rows, name, mode)
            lines.append(_line(title, label, *(verdict(ranking(own, x)) for x in TARGETS)))
    return "\n".join(lines)


def _line(*cells: str) -> str:
    return f"| {' | '.join(cells)} |"


def _head(*cells: str) -> list[str]:
    return [_line(*cells), _line(*["---"] * len(cells))]


def _of_log(rows: Sequence[Row]) -> list[str]:
    lines = _head("method", "rms, rad", "p50 over time", "p95", "ns a sample")
    return lines + [
        _line(
            f"{r.package} `{r.method}`", *(f"{x:.2e}" for x in (r.error, r.p50, r.p95)),
            f"{r.seconds * 1e9:.0f}",
        )
        for r in sorted(rows, key=lambda row: row.error)
    ]  # fmt: skip


def _times(rows: Sequence[Row], name: str) -> list[str]:
    """Every library's time at every error."""
    lines = _head("library", "bodies", *(f"µs a body at {x:.0e} rad" for x in TARGETS))
    for mode, label in MODES.items():
        # an ensemble that is run body by body is told of once
        own = [row for row in rows if (row.problem, row.mode) == (name, mode)]
        best = [{b.package: b for b in ranking(own, x)} for x in TARGETS]
        for package in PACKAGES:
            cells = [
                f"{b[package].seconds * 1e6:.3g} `{b[package].method}`" if package in b else "–"
                for b in best
            ]
            if any(package in b for b in best):
                lines.append(_line(package, label, *cells))
    return lines


def _first_two(rows: Sequence[Row], name: str) -> list[str]:
    """The settings of ours and of the best peer, with errors over bodies and operations."""
    lines = _head(
        "error", "bodies", "library, method, setting", "rms", "p50", "p95", "operations a body",
        "operations a ns",
    )  # fmt: skip
    for target in TARGETS:
        for mode, label in MODES.items():
            ranked = ranking(of_mode(rows, name, mode), target)
            for r in (best.row for best in two(ranked) if best):
                work = [f"{r.work:.3g}", f"{r.work / r.seconds * 1e-9:.1f}"] if r.work else "––"
                errors = [f"{x:.1e}" for x in (r.error, r.p50, r.p95)]
                what = f"{r.package} `{r.method}`, {r.setting}"
                lines.append(_line(f"{target:.0e}", label, what, *errors, *work))
    return lines


def why(rows: Sequence[Row], name: str) -> str:
    """A sentence: where the difference comes from, at the tightest error of an ensemble."""
    for target in reversed(TARGETS):
        ranked = ranking(of_mode(rows, name, MANY), target)
        if None in two(ranked):
            continue
        ours, peer = two(ranked)
        a, b = ours.row, peer.row
        begin = f"For an ensemble at {target:.0e} rad, `{a.method}` takes "
        if not b.work:
            reason = f" ({b.bound})" if b.bound else ""
            return f"{begin}{a.setting}, {b.package} {b.setting}{reason}."
        if not a.work:
            return f"{begin}no steps; {b.package} takes {_operations(b, 'about ')}."
        return f"{begin}{_operations(a)}, {b.package} {_operations(b, 'about ')}."
    return "No error is reached by fastatt and by another library."


def _operations(row: Row, about: str = "") -> str:
    speed = row.work / row.seconds * 1e-9
    return f"{about}{row.work:.2g} operations per body at {speed:.1f} per ns"


def _libraries() -> list[str]:
    lines = _head("library", "version", "settings")
    for package in PACKAGES:
        try:
            version = metadata.version(DISTRIBUTIONS.get(package, package))
        except metadata.PackageNotFoundError:
            version = "not installed, left out"
        lines.append(_line(package, version, _SETTINGS[package]))
    return lines


_RULES = f"""\
Every library runs with a series of tolerances or step sizes; times are CPU times of one
core, the least of five rounds or more in which the libraries alternate. A cell names the fastest
method at that error, and how many times as long the next library takes. The error is the root mean
square over bodies with a known solution; times at an error are interpolated in logarithms between
settings.
Times within {100 * (TIE - 1):.0f} % of each other are ties; ratios above {_MOST:.0f} are
not stated.
Bold cells are those that fastatt loses.
"One" is a call for each body, "ensemble" one call for 1024 bodies.
Times do not contain compilation, layouts, plans and other preparations that a library allows.
`float32` in a method's name is single precision.
The operations of heyoka follow from its order p and its steps: p² for each product of series and 2p
for each variable. For fastatt, operations that all bodies share, such as a sine of time, are
counted for each body; the rate of operations can then exceed the peak of the core.
MuJoCo, Basilisk and Exudyn run bodies that can exist: no moment is above the sum of the others.
In orbit Basilisk integrates the position too.
With wheels a torque is computed every 0.1 s and held, and steps end there: libraries that integrate
equations are restarted at each sample, while Basilisk and fastatt run the controller themselves."""


def page(rows: Sequence[Row], where: str) -> str:
    """Markdown: rules, libraries, the table, each problem."""
    parts = ["# Time at equal error", f"`make leaderboard` writes this page. {where}", _RULES]
    parts += ["## Libraries", "\n".join(_libraries()), "## Who is first", table(rows)]
    parts.append("![time at equal error](../fastatt/docs/pictures/leaderboard.png)")
    parts.append("`python bench/leaderboard_picture.py` draws the picture from the tables below.")
    for name, title in _problems(rows).items():
        own = [row for row in rows if row.problem == name]
        parts += [f"## {title}", f"Reference: {own[0].reference}."]
        if _is_log(own):
            parts.append("\n".join(_of_log(own)))
            continue
        parts += [why(rows, name), "\n".join(_times(rows, name)), "\n".join(_first_two(rows, name))]
    return "\n\n".join(parts).rstrip() + "\n"
