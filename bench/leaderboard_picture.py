"""The leaderboard's picture, drawn from the tables of LEADERBOARD.md.

python bench/leaderboard_picture.py      # bench/LEADERBOARD.md to fastatt/docs/pictures
"""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import Any, NamedTuple

from leaderboard_contestants import OURS, PACKAGES
from leaderboard_report import MODES, TARGETS
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from fastatt.plots.drawing import COLOURS, save

PICTURES = Path(__file__).parents[1] / "fastatt" / "docs" / "pictures"
_COLOURS = dict(
    zip(
        PACKAGES, ("#000000", *COLOURS[:6], "#7F3C00", "#4B0092", "#777777", "#C77CFF"), strict=True
    )
)
_MARKERS = dict(zip(PACKAGES, ("o", "s", "^", "v", "D", "P", "X", "*", "<", ">", "p"), strict=True))
_MOST = 3e4  # times as long as fastatt, beyond which a library is drawn at the edge


class Time(NamedTuple):
    """A library's shortest time per body, µs, at an error, and the method that takes it."""

    microseconds: float
    method: str

    @property
    def is_single(self) -> bool:
        return self.method.endswith("float32")


class OfLog(NamedTuple):
    """A method on the simulated gyro log: its error, rad, and its time per sample, ns."""

    package: str
    method: str
    error: float
    nanoseconds: float


#: by (problem, "one" or "ensemble", library, index of the error in TARGETS)
Times = dict[tuple[str, str, str, int], Time]


def read_page(text: str) -> tuple[Times, list[OfLog]]:
    """All times at equal error, and the gyro log's figures."""
    times: Times = {}
    log = []
    for section in text.split("\n## ")[1:]:
        title = section.splitlines()[0]
        for line in section.splitlines():
            cells = [cell.strip() for cell in line.split("|")[1:-1]]
            found = [re.fullmatch(r"([\d.e+]+) `([^`]+)`", cell) for cell in cells[2:]]
            if len(cells) == 2 + len(TARGETS) and any(found):
                for k, match in enumerate(found):
                    if match:
                        key = title, cells[1], cells[0], k
                        times[key] = Time(float(match[1]), match[2])
            of_log = re.fullmatch(r"(\S+) `([^`]+)`", cells[0]) if cells else None
            if of_log and len(cells) == 5 and cells[1][0].isdigit():
                log.append(OfLog(*of_log.groups(), float(cells[1]), float(cells[4])))
    return times, log


def heading(text: str) -> str:
    """What the page was measured on."""
    machine = re.search(r"One core of ([^,]+),", text)
    return f"Time at equal error, one thread of {machine[1]}" if machine else "Time at equal error"


def picture(text: str, path: Path) -> None:
    """Each library's time over fastatt's, a panel for each error; the gyro log below."""
    times, log = read_page(text)
    rows = list(dict.fromkeys((title, mode) for title, mode, *_ in times))
    rows.sort(key=lambda row: list(MODES.values()).index(row[1]))
    figure = Figure(figsize=(12.0, 2.0 * (0.23 * len(rows) + 0.8) + 4.2), layout="constrained")
    figure.suptitle(heading(text))
    high = 0.23 * len(rows) + 0.8
    grid = figure.subplots(3, 2, height_ratios=(high, high, 3.6))
    for k, axes in enumerate(grid[:2].ravel()):
        _ratios(axes, times, rows, k, named=k % 2 == 0)
    _of_log(grid[2, 0], log)
    grid[2, 1].set_axis_off()
    grid[2, 1].legend(handles=_entries(times, log), loc="center", ncols=2, frameon=False)
    save(figure, path)


def _ratios(
    axes: Any, times: Times, rows: list[tuple[str, str]], target: int, *, named: bool
) -> None:
    axes.set(xscale="log", xlim=(0.03, 1.4 * _MOST), ylim=(len(rows) - 0.5, -0.5))
    axes.set_title(f"at an error of {TARGETS[target]:.0e} rad")
    axes.set_xlabel("time divided by that of fastatt, which is on the left")
    axes.set_yticks(range(len(rows)), [f"{t}, {m}" for t, m in rows] if named else [])
    axes.tick_params(axis="y", labelsize=8, length=0)
    axes.grid(visible=True, axis="x", alpha=0.3)
    axes.axvline(1.0, color="k", lw=1.2)
    axes.axvspan(0.03, 1.0, color="0.93", zorder=0)
    for y, (title, mode) in enumerate(rows):
        modes = ("one", "ensemble") if mode == "ensemble" else ("one",)
        ours = _best(times, title, modes, OURS, target)
        if ours is None:
            axes.text(1.3, y, "no fastatt method", fontsize=7, va="center", color="0.4")
            continue
        axes.axhline(y, color="0.9", lw=0.6, zorder=0)
        single = " float32" if ours.is_single else ""
        said = f"{ours.microseconds:.2g} µs{single}"
        axes.text(0.035, y, said, fontsize=7, va="center", color="#D55E00" if single else "k")
        for package in PACKAGES[1:]:
            peer = _best(times, title, modes, package, target)
            if peer is not None:
                ratio = min(peer.microseconds / ours.microseconds, _MOST)
                axes.plot(ratio, y, color=_COLOURS[package], marker=_MARKERS[package], ms=5)


def _best(
    times: Times, title: str, modes: tuple[str, ...], package: str, target: int
) -> Time | None:
    found = (times.get((title, mode, package, target)) for mode in modes)
    return min((time for time in found if time), default=None)


def _of_log(axes: Any, log: list[OfLog]) -> None:
    axes.set_title("simulated gyro log, spectrum of a walking leg", fontsize=10)
    axes.set(xscale="log", yscale="log", xlabel="time per sample, ns", ylabel="error, rms, rad")
    axes.grid(visible=True, alpha=0.3)
    axes.margins(0.15)
    for row in log:
        style = {"color": _COLOURS[row.package], "marker": _MARKERS[row.package]}
        axes.plot(row.nanoseconds, row.error, **style, ms=6, ls="none")
        if row.package == OURS:
            place = {"xytext": (6, 3), "textcoords": "offset points", "fontsize": 8}
            axes.annotate(row.method, (row.nanoseconds, row.error), **place)


def _entries(times: Times, log: list[OfLog]) -> list[Line2D]:
    used = {package for *_, package, _ in times} | {row.package for row in log}
    return [
        Line2D([], [], color=_COLOURS[p], marker=_MARKERS[p], ls="none", label=p)
        for p in PACKAGES
        if p in used
    ]


if __name__ == "__main__":
    page = Path(__file__).with_name("LEADERBOARD.md").read_text(encoding="utf-8")
    picture(page, Path(sys.argv[1]) if sys.argv[1:] else PICTURES / "leaderboard.png")
