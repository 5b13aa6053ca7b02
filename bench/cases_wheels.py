"""A spacecraft with three reaction wheels under sampled control: Basilisk's scenario."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import wheel_feedback as problem
from cases_rows import Case, Row, printed

import fastatt as fa

# by seconds: σ and the torques that are computed then, N·m
PUBLISHED = {
    122: (
        "0.01388161005273, -0.15485878435765, -0.01758943080705",
        "0.01088653639664, -0.51081088867427, -0.04946500172158",
    ),
    244: (
        "-0.02792374056311, 0.01126997616911, 0.00047871422911",
        "-0.05335602054612, 0.07328012186258, 0.02362267848955",
    ),
    366: (
        "0.00619593424474, 0.00249185591809, 0.00373004090794",
        "0.02405327355514, -0.00278772846190, 0.00010490688668",
    ),
    488: (
        "0.00001526013364, -0.00124915494140, -0.00141585820393",
        "-0.00446668968669, -0.00308065636427, -0.00323359935030",
    ),
}
# of 2.12.1 after 600 s
SIGMA = "-0.00056192759523, 0.00013111659754, 0.00016885306763"
RATE = "0.00004313748277, 0.00002115305090, 0.00002007090319"
SPEEDS = "19.4387710974, -209.1563064461, 170.4863975545"
LATE = "-0.00056207802108, 0.00013616704771, 0.00017411651973"
# as there: RK4 on these parameters, in steps from sample to sample
AS_THERE = {"method": "rk4", "representation": "mrp"}


def scenario() -> Iterator[Row]:
    craft = problem.craft()
    run = craft.run(**AS_THERE)
    sigma = fa.quat_to_mrp(run.q)
    torques = problem.STIFFNESS * sigma + problem.DAMPING * run.w
    for seconds, (attitude, torque) in PUBLISHED.items():
        k = int(np.abs(run.t - seconds).argmin())
        yield printed(f"σ, {seconds} s", attitude, sigma[k])
        yield printed(f"torques computed, {seconds} s, N·m", torque, torques[k])
    yield printed("σ, 600 s", SIGMA, sigma[-1])
    yield printed("rate, 600 s, rad/s", RATE, run.w[-1])
    yield printed(
        "speeds of the wheels, 600 s, rad/s", SPEEDS, craft.wheels.speeds(run.s, run.w)[-1]
    )
    late = problem.craft(problem.late).run(**AS_THERE)
    yield printed("σ, torques a sample late, 600 s", LATE, fa.quat_to_mrp(late.q[-1]))


CASES = (
    Case(
        "Basilisk's scenarioAttitudeFeedbackRW",
        """\
A hub of 900, 800 and 600 kg·m² with three Honeywell HR16 of 50 N·m·s at 6000 rpm and 0.2 N·m,
which rotate at 100, 200 and 300 rpm; K = 3.5 N·m and P = 30 N·m·s on σ and w, every 0.1 s.
Figures to 488 s are the truth of `test_scenarioAttitudeFeedbackRW.py` of 2017, to 14 places;
those at 600 s are of Basilisk 2.12.1, run by `bench/peers_wheels.py`.
The wheels read a torque before the spacecraft's next step: torques are held without delay.
The last figure is of 2.12.1 with wheels and spacecraft in the opposite order: a sample late.""",
        "2.12.1 is within 2e-15 of the truth of 2017; RK4 in steps of 0.1 s is off the solution "
        "of the equations by 2.7e-14, as `python bench/wheels.py` finds.",
        scenario,
    ),
)
