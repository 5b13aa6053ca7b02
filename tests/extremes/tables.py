"""The tables: extremes side by side."""

from __future__ import annotations

import numpy as np

from extremes import bodies, rates
from extremes.cases import ANGLES, Column, Table
from extremes.poles import passage
from extremes.samples import sampled

# the tables


def poles(*, body: bool) -> list[Column]:
    def column(name: str, kind: str, distance: float) -> Column:
        return Column(
            name, passage(kind, distance, body=body), lambda case: case.representation in ANGLES
        )

    return [
        column("3-1-3 at 0", "at 0", 0.0),
        column("at π", "at π", 0.0),
        *[column(f"past 0 by {d:g}", "past 0", d) for d in (0.1, 1e-3, 0.0)],
    ]


def length(size: float) -> Column:
    """Initial quaternions of a length, which float32 holds or not."""
    fits_single = 1e-30 <= size <= 1e30
    run = rates.coning(0.1, size=size)
    return Column(f"{size:.2g}", run, lambda case: fits_single or case.dtype == "float64")


# the last ones are whole turns, at which each sample of a torque is the same
UNDER_WEIGHT = (0.1, 0.5, 1.0, 2.0, 4.0, 2.0 * np.pi, 30.0, 16.0 * np.pi)

TABLES = (
    Table(
        "A constant rate",
        "Columns: |w|h, rad a step; 8 steps along three axes. Error, rad.",
        "rate",
        [Column(name, rates.constant(theta)) for name, theta in rates.THETAS.items()],
    ),
    Table(
        "Coning",
        "Columns: |w|h; 8 steps on cones with half angles of 0.5, 1 and 2 rad. Error, rad.",
        "rate",
        [Column(name, rates.coning(theta)) for name, theta in rates.THETAS.items()],
    ),
    Table(
        "Far from the epoch",
        "Columns: t0, s; 8 steps of 1 s on cones at |w|h = 0.1, angles and frequencies each body's "
        "own. Error, rad.",
        "rate",
        [Column(f"{t0:g}", rates.clock(t0)) for t0 in (0.0, -1e4, 1e6, 1.7e9, 1e12)],
    ),
    Table(
        "Rotations beyond precision",
        "Columns: |w|h, one step at a constant rate. Error, rad.",
        "rate",
        [Column(f"{theta:g}", rates.at_once(theta)) for theta in (1e3, 1e5, 1e9, 1e14, 1e16, 1e18)],
    ),
    Table(
        "Initial quaternions",
        "Columns: length of q0, the least of subnormal numbers; cones at |w|h = 0.1. Error, rad.",
        "rate",
        [length(x) for x in (1e-320, 1e-300, 1e-200, 1e-30, 2.5, 1e30, 1e200, 1e300)],
    ),
    Table(
        "Free bodies of all shapes",
        "Columns: principal moments, V is (0.6, 0.8, 1), the last two can't exist; 16 steps of "
        "|w|h = 0.1 in 11 directions, axes in three orders. Error: angle, rad, or |Δm|/|m|.",
        "free",
        [bodies.shape(name) for name in bodies.SHAPES],
    ),
    Table(
        "A free body's step",
        "Columns: |w|h of body V in 11 directions, 16 steps. Error: angle, rad, or |Δm|/|m|; where "
        "rounding alone would lose the trajectory, energy or momentum, relative.",
        "free",
        [bodies.turning(name, theta) for name, theta in rates.THETAS.items()],
    ),
    Table(
        "About the intermediate axis",
        "Columns: perturbation of the momentum, 1 N·m·s, of moments (2, 1, 0.625) kg·m², 400 steps "
        "of 0.05 s. Error as above.",
        "free",
        [bodies.about_intermediate(x) for x in (1.0, 1e-4, 1e-8, 1e-16, 0.0)],
    ),
    Table(
        "Damping",
        "Columns: c h/I_min; 32 steps of |w|h = 0.0625, w exp(−ct/I) exactly. Error over the "
        "initial |w|, or over the angle of the first step.",
        "torqued",
        [bodies.damping(x) for x in (0.1, 1.0, 2.5, 3.0, 10.0, 100.0, 1000.0)],
    ),
    Table(
        "A weight on a pendulum",
        "Columns: frequency times step; 32 steps, 90° to each side. Error, rad, or of w, relative.",
        "torqued",
        [bodies.pendulum(x) for x in (1e-6, 1e-3, 0.1, 0.3, 1.0, 3.0, 10.0)],
    ),
    Table(
        "A weight on rotating bodies",
        "Columns: |w|h; bodies from a sphere to a needle, in 11 directions, with a weight of "
        "h²/I_min = 1/128; 32 steps. Error: angle, rad, or |Δm|/|m|.",
        "torqued",
        [bodies.turning_under_weight(x) for x in UNDER_WEIGHT],
    ),
    *(
        Table(
            f"Poles, {'free bodies' if body else 'prescribed rates'}",
            "3-1-3 angles that start at a nutation of 0 and π or pass 0 so far away, rad. 64 "
            "steps. Error, rad.",
            "free" if body else "rate",
            poles(body=body),
        )
        for body in (False, True)
    ),
    Table(
        "Many steps, constant rate",
        "Columns: steps of 0.006 rad. Error, rad.",
        "rate",
        [Column("1e4", rates.long_rates(10_000)), Column("1e6", rates.long_rates(1_000_000))],
    ),
    Table(
        "Many steps, free body",
        "Columns: steps of 0.01 rad of body V. Error as above.",
        "free",
        [
            Column(
                f"{n:.0e}".replace("e+0", "e"),
                bodies.free(
                    np.array(bodies.V), 0.01 * bodies.spins(np.array(bodies.V))[:4], 1.0, n
                ),
            )
            for n in (10_000, 1_000_000)
        ],
    ),
    *(
        Table(
            f"Sampled {'increments' if increments else 'rates'}, {name}",
            "Columns: |w|h between samples; 6 intervals. Error, rad. A log has no status: "
            "STEP_TOO_LARGE stands for a warning, or for a refusal.",
            "increments" if increments else "sampled rates",
            [
                Column(k, sampled(theta, a, increments=increments))
                for k, theta in rates.THETAS.items()
            ],
        )
        for increments in (False, True)
        for name, a in (("constant", 0.0), ("coning", 1.0))
    ),
)
