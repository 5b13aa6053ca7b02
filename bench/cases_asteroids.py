"""Asteroids that tumble: 4179 Toutatis against radar, 99942 Apophis' periods."""

from __future__ import annotations

import math
from collections.abc import Iterator
from datetime import UTC, datetime
from typing import Any

import numpy as np
from cases_rows import Case, Row, printed

import fastatt as fa

DAY = 86400.0
DEGREE = math.pi / 180.0


def periods(inertia: Any, w0: Any) -> tuple[float, float]:
    """(of the rate in the body, of the long axis about the momentum), s: the closed form's, timed.

    Of moments that differ by some per cent and a motion that is near no separatrix, so that forty
    turns are several periods.
    """
    moments, w = np.asarray(inertia), np.asarray(w0)
    long, middle, _ = np.argsort(moments)

    def motion(t: Any) -> tuple[Any, Any]:
        return fa.closed_form.free_body([1, 0, 0, 0], w, moments, t)

    t = np.linspace(0.0, 80.0 * math.pi / np.linalg.norm(w), 4001)
    x = motion(t)[1][:, middle]
    # the intermediate component goes through zero upwards once a period
    up = np.flatnonzero((x[:-1] < 0.0) & (x[1:] >= 0.0))
    ends = []
    for k in up[[0, -1]]:
        low, high = t[k], t[k + 1]
        for _ in range(50):
            now = 0.5 * (low + high)
            low, high = (now, high) if motion(now)[1][middle] < 0.0 else (low, now)
        ends.append(low)
    span = ends[1] - ends[0]
    m = moments * w / np.linalg.norm(moments * w)
    across = np.cross(m, np.eye(3)[np.argmin(abs(m))])
    across /= np.linalg.norm(across)
    axis = fa.quat_rotate(motion(np.linspace(*ends, 4001))[0], np.eye(3)[long])
    angle = np.unwrap(np.arctan2(axis @ np.cross(m, across), axis @ across))
    return float(span / (up.size - 1)), float(2.0 * math.pi * span / abs(angle[-1] - angle[0]))


# 4179 Toutatis

EPOCH = "1992-11-09 17:49:47"
MOMENTS = (3.0836, 3.235, 1.0)
START = (145.498, 65.865, 241.524)
RATE = (14.51, 33.529, -98.709)
# UTC; observed 3-1-3 angles, ° and rates, °/day; Principia's angles from them, °: of the body axes
# x, y, z and of the rate
OBSERVED = """\
1992-12-02 21:40 | 122.2 86.5 107.0 | -35.6 7.2 -97.0 | 5.4, 5.9, 7.9, 4.5
1992-12-03 19:30 | 86.3 81.8 24.5 | -16.4 -29.1 -91.9 | 7.7, 4.7, 6.6, 0.5
1992-12-04 18:10 | 47.8 60.7 284.0 | 29.1 -23.2 -97.8 | 15, 9.4, 13, 5.0
1992-12-05 18:50 | 14.6 39.4 207.1 | 33.3 8.2 -92.2 | 4.3, 8.4, 9.4, 1.1
1992-12-06 17:30 | 331.3 23.7 151.6 | 6.6 34.5 -95.8 | 0.6, 2.1, 2.0, 0.8
1992-12-07 17:20 | 222.5 25.4 143.9 | 12.8 25.4 -104.1 | 15, 15, 5.7, 24
1992-12-08 16:40 | 169.8 45.5 106.9 | -31.1 -21.9 -97.7 | 2.6, 2.6, 3.0, 2.7
1992-12-09 17:50 | 137.3 71.3 22.3 | 11.8 -36.9 -94.9 | 3.4, 1.1, 3.4, 3.4
1992-12-10 17:20 | 103.1 85.2 292.6 | 35.8 -8.9 -97.9 | 1.4, 3.4, 3.1, 0.8
1992-12-11 09:40 | 77.0 85.7 225.5 | 31.0 17.0 -96.3 | 1.6, 2.7, 2.8, 1.0
1992-12-12 09:20 | 42.8 70.2 133.2 | -1.3 37.0 -95.9 | 3.2, 2.6, 2.0, 2.2
1992-12-13 08:10 | 13.7 44.4 51.9 | -38.3 17.9 -97.3 | 5.3, 5.3, 2.5, 3.4
1992-12-14 07:50 | 323.7 14.0 0.0 | -70.5 -30.6 -91.1 | 3.8, 4.5, 4.1, 22
1992-12-15 07:50 | 193.2 24.4 21.4 | 22.1 -26.6 -96.6 | 8.2, 8.0, 3.2, 4.9
1992-12-16 07:10 | 165.1 46.4 310.6 | 33.4 -3.4 -93.7 | 5.8, 8.0, 7.3, 2.6
1992-12-17 06:49 | 130.6 76.1 234.9 | 12.6 33.9 -94.0 | 1.1, 1.2, 0.8, 2.1
1992-12-18 07:09 | 91.6 81.6 142.4 | -24.3 29.6 -102.0 | 6.3, 4.1, 5.6, 2.1
2008-11-23 10:45 | 86.2 85.0 0.3 | -0.4 -36.2 -98.9 | 122, 131, 29, 40"""


def _seconds(instant: str) -> float:
    return datetime.fromisoformat(instant).replace(tzinfo=UTC).timestamp()


def _between(a: Any, b: Any) -> Any:
    """Angles between vectors, °."""
    return np.arctan2(np.linalg.norm(np.cross(a, b), axis=-1), (a * b).sum(axis=-1)) / DEGREE


def toutatis() -> Iterator[Row]:
    lines = [line.split(" | ") for line in OBSERVED.splitlines()]
    t = np.array([_seconds(line[0]) for line in lines]) - _seconds(EPOCH)
    angles, rates = (
        np.array([[float(x) for x in line[k].split()] for line in lines]) * DEGREE for k in (1, 2)
    )
    start = fa.euler313_to_quat(np.array(START) * DEGREE)
    w0 = np.array(RATE) * DEGREE / DAY
    q, w = fa.closed_form.free_body(start, w0, MOMENTS, t)
    # columns of the matrices are the body's axes
    computed, observed = fa.quat_to_dcm(q), fa.quat_to_dcm(fa.euler313_to_quat(angles))
    axes = _between(np.swapaxes(computed, 1, 2), np.swapaxes(observed, 1, 2))
    found = np.column_stack([axes, _between(w * DAY, rates)])
    for line, ours in zip(lines, found, strict=True):
        yield printed(f"{line[0]}, °", line[3], ours)
    own, about = (period / DAY for period in periods(MOMENTS, w0))
    for name, value, theirs, deviation in (
        ("rotation", own, "5.38 ± 0.03", 0.03),
        ("precession", about, "7.40 ± 0.03", 0.03),
    ):
        mean = float(theirs.split()[0])
        apart = abs(value - mean)
        yield Row(f"period of {name}, d", theirs, f"{value:.3f}", apart, deviation, "d")


# 99942 Apophis

SHAPE = np.array([0.64, 0.97, 1.0])
PRECESSION, ROTATION = 27.38547, 264.178  # h


def apophis() -> Iterator[Row]:
    """The energy at which the periods have their ratio, by bisection."""

    def ratio(excess: float) -> float:
        # |m| = 1: m₁² + m₃² = 1 and m₁²/I₁ + m₃²/I₃ = E/E0/I₃
        first = math.sqrt(excess / (SHAPE[2] / SHAPE[0] - 1.0))
        m = np.array([first, 0.0, math.sqrt(1.0 - first**2)])
        own, about = periods(SHAPE, m / SHAPE)
        return own / about

    low, high = 0.005, 0.03
    above = ratio(low) > ROTATION / PRECESSION
    for _ in range(12):
        middle = 0.5 * (low + high)
        same = (ratio(middle) > ROTATION / PRECESSION) == above
        low, high = (middle, high) if same else (low, middle)
    energy = 1.0 + low
    yield Row("E/E0", "1.024 ± 0.013", f"{energy:.4f}", abs(energy - 1.024), 0.013, "(3 σ)")


CASES = (
    Case(
        "4179 Toutatis against radar",
        """\
Angles between observed and computed body axes x, y, z, and between the rates.
They are those of Principia's `euler_solver_test.cpp`, test `Toutatis`, a unit of the last digit.
The observations and the model are those of Takahashi, Busch and Scheeres, Astron. J. 146 (2013) 95.
Both propagate a free body from one initial condition. The difference from the radar is that of
the model.
In 2008 it is large, because the model has no tides of Earth and Sun.
Periods are those that Zhao, Hu and Ji found at Chang'e-2's flyby, arXiv:1511.04357.""",
        "5.41 d and 7.35 d are the periods of Hudson and Ostro, Science 270 (1995) 84.",
        toutatis,
    ),
    Case(
        "99942 Apophis' periods",
        """\
E0 is the least energy of a momentum; at E the two periods have the ratio observed.
Moments .64 : .97 : 1 and periods of 27.38547 h and 264.178 h: Lee and others, A&A 661 (2022) L3.
The energy is that of Pravec and others, Icarus 233 (2014) 48, from another apparition.""",
        "the deviation of E/E0 is theirs, 3 σ.",
        apophis,
    ),
)
