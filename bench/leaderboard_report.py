"""What the leaderboard's rows say: curves, winners, the tables and the picture."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path

from leaderboard_contestants import OURS, PACKAGES
from leaderboard_problems import MANY, ONE

TARGETS = (1e-3, 1e-6, 1e-9, 1e-12)
MODES = {ONE: "one", MANY: "ensemble"}
# Okabe and Ito's colours, told apart by colour-blind readers
_COLOURS = ("#000000", "#D55E00", "#0072B2", "#009E73", "#CC79A7", "#56B4E9", "#E69F00", "#999999")
_MARKERS = ("o", "s", "^", "v", "D", "P", "X", "*")


@dataclass(frozen=True)
class Row:
    """One setting of one method: error, rad, and seconds per body, of a log per sample."""

    problem: str
    title: str
    mode: str
    package: str
    method: str
    setting: str
    error: float
    seconds: float


@dataclass(frozen=True)
class Best:
    """The shortest time of a library at an error, and the method."""

    package: str
    method: str
    seconds: float


def write_rows(path: Path, rows: Sequence[Row]) -> None:
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, [f.name for f in fields(Row)])
        writer.writeheader()
        writer.writerows(asdict(row) for row in rows)


def read_rows(path: Path) -> list[Row]:
    with path.open(encoding="utf-8", newline="") as file:
        return [
            Row(**{**row, "error": float(row["error"]), "seconds": float(row["seconds"])})
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
    curves: dict[tuple[str, str], list[tuple[float, float]]] = {}
    for row in rows:
        curves.setdefault((row.package, row.method), []).append((row.error, row.seconds))
    found: dict[str, Best] = {}
    for (package, method), points in curves.items():
        seconds = time_at(points, target)
        if seconds is not None and (package not in found or seconds < found[package].seconds):
            found[package] = Best(package, method, seconds)
    return sorted(found.values(), key=lambda best: best.seconds)


def of_mode(rows: Sequence[Row], problem: str, mode: str) -> list[Row]:
    """Rows that a user may choose from: an ensemble can be run one body a call too."""
    return [row for row in rows if row.problem == problem and mode in (MANY, row.mode)]


def ratio(x: float) -> str:
    return f"{x:.2f}" if x < 1.995 else f"{x:.1f}" if x < 9.95 else f"{x:.0f}"


def verdict(ranked: Sequence[Best]) -> str:
    """Ours against the best peer: who wins by which ratio, in bold where we lose."""
    ours = next((best for best in ranked if best.package == OURS), None)
    peer = next((best for best in ranked if best.package != OURS), None)
    if ours is None and peer is None:
        return "none"
    if ours is None:
        return f"**{peer.package} alone**"
    if peer is None:
        return f"`{ours.method}` alone"
    if ours.seconds <= peer.seconds:
        return f"`{ours.method}` {ratio(peer.seconds / ours.seconds)}× {peer.package}"
    return f"**{peer.package} {ratio(ours.seconds / peer.seconds)}×** `{ours.method}`"


def _problems(rows: Sequence[Row]) -> dict[str, str]:
    """Name to title, in the order of the rows."""
    return {row.problem: row.title for row in rows}


def _is_log(rows: Sequence[Row]) -> bool:
    return all(row.setting == "" for row in rows)


def table(rows: Sequence[Row]) -> str:
    """Markdown: a line for each problem and mode, then one for each method on a recording."""
    lines = ["| problem | bodies | " + " | ".join(f"{x:.0e} rad" for x in TARGETS) + " |"]
    lines.append("| --- " * (2 + len(TARGETS)) + "|")
    logs = []
    for name, title in _problems(rows).items():
        if _is_log([row for row in rows if row.problem == name]):
            logs.append(name)
            continue
        for mode, label in MODES.items():
            own = of_mode(rows, name, mode)
            cells = [verdict(ranking(own, target)) for target in TARGETS]
            lines.append(f"| {title} | {label} | {' | '.join(cells)} |")
    for name in logs:
        own = sorted((row for row in rows if row.problem == name), key=lambda row: row.error)
        lines += ["", f"| {own[0].title} | error, rad | ns/sample |", "| --- | --- | --- |"]
        lines += [
            f"| {r.package} `{r.method}` | {r.error:.2e} | {r.seconds * 1e9:.0f} |" for r in own
        ]
    return "\n".join(lines)


def times(rows: Sequence[Row]) -> str:
    """Text: every library's time at every target."""
    lines = []
    for name, title in _problems(rows).items():
        for mode, label in MODES.items():
            own = of_mode(rows, name, mode)
            if not own or _is_log(own):
                continue
            lines.append(f"{title}, {label}: µs a body")
            for target in TARGETS:
                ranked = ranking(own, target)
                told = [f"{b.package} {b.method} {b.seconds * 1e6:.3g}" for b in ranked]
                lines.append(f"  {target:.0e}  " + ("; ".join(told) or "none"))
    return "\n".join(lines)


def picture(rows: Sequence[Row], heading: str, path: Path) -> None:
    """Each library's best error against its time, a panel for each problem."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

    problems = _problems(rows)
    columns = min(3, len(problems))
    lines = -(-len(problems) // columns)
    figure = Figure(figsize=(4.9 * columns, 3.7 * lines + 1.0), layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(lines, columns, squeeze=False).ravel()
    looks = {
        name: {"color": _COLOURS[i], "marker": _MARKERS[i], "ms": 4.5, "lw": 1.3}
        for i, name in enumerate(PACKAGES)
    }
    drawn = set()
    for axes, (name, title) in zip(panels, problems.items(), strict=False):
        own = [row for row in rows if row.problem == name]
        log = _is_log(own)
        for mode in MODES:
            for package, look in looks.items():
                points = [
                    (r.error, r.seconds) for r in own if (r.package, r.mode) == (package, mode)
                ]
                if not points:
                    continue
                drawn.add(package)
                curve = sorted(points) if log else envelope(points)
                style = dict(look, ls="none") if log else dict(look)
                if mode == ONE and not log:
                    style |= {"ls": "--", "markerfacecolor": "white"}
                errors, seconds = zip(*curve, strict=True)
                axes.plot([t * 1e6 for t in seconds], [max(e, 1e-16) for e in errors], **style)
        for k, r in enumerate(sorted(own, key=lambda row: row.seconds) if log else []):
            at, (side, shift) = (r.seconds * 1e6, r.error), (("right", -5), ("left", 5))[k % 2]
            axes.annotate(r.method, at, (shift, 3), textcoords="offset points", fontsize=7, ha=side)
        if log:
            axes.margins(x=0.45, y=0.12)
        unit = "sample" if log else "body"
        axes.set(xscale="log", yscale="log", xlabel=f"time per {unit}, µs", ylabel="error, rad")
        axes.set_title(title, fontsize=10)
        axes.grid(visible=True, alpha=0.3)
        if not log:
            axes.set_ylim(1e-15, 1.0)
            for target in TARGETS:
                axes.axhline(target, color="0.5", lw=0.8, ls=":", zorder=0)
    for axes in panels[len(problems) :]:
        axes.remove()
    entries = {name: Line2D([], [], **looks[name]) for name in PACKAGES if name in drawn}
    entries["ensemble in one call"] = Line2D([], [], color="0.3", marker="o", ms=4.5)
    entries["one body a call"] = Line2D(
        [], [], color="0.3", ls="--", marker="o", ms=4.5, markerfacecolor="white"
    )
    figure.legend(entries.values(), entries.keys(), loc="outside lower center", ncols=5)
    figure.suptitle(heading, fontsize=11)
    figure.savefig(path, dpi=100)
