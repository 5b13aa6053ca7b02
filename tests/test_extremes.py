"""The stability suite, reduced: with status 0 no method is wrong anywhere.

Scenes are of the types that the tests of methods use, for which all is compiled already.
"""

from pathlib import Path

import numpy as np
import pytest
from each import each, in_tiers
from exact import START, representations
from extremes import bodies, energy, rates, tables
from extremes.cases import Case, Column, Outcome

import fastatt as fa

SPLITTINGS = [m.name for m in fa.METHODS.values() if m.is_stepped and m.sorted_axes]
SINGLE = ("rk4", "strang2", "dmv10")
# whose scenes are of another type, or take seconds
ELSEWHERE = ("A constant rate", "Many steps")
CONSTANT = [
    Column(f"constant {name}", rates.constant(theta, known=False))
    for name, theta in rates.THETAS.items()
]


def of(scene):
    return [m.name for m in fa.METHODS.values() if m.is_stepped and scene in m.scenes]


def cells(case, scene):
    """(title, outcome) of all columns for one kind of scene."""
    columns = [
        (table.title, column)
        for table in tables.TABLES
        if table.scene == scene and not table.title.startswith(ELSEWHERE)
        for column in table.columns
    ]
    if scene == "rate" and case.representation == "quat":
        columns += [("constant", column) for column in CONSTANT]
    found = [(f"{t}: {c.name}", c.run(case)) for t, c in columns if c.fits(case)]
    assert found
    return found


def complaints(found):
    return [
        f"{name}: {cell.error[cell.wrong]} where {cell.allowed[cell.wrong]} is allowed"
        for name, cell in found
        if cell.wrong.any()
    ]


# the rule


# a derivative and an exponential, which alone differ on other representations, whose poles angles
# pass, and in the other precision
SOME = [Case(m, r) for m in ("rk4", "magnus4") for r in representations(fa.METHODS[m])[1:]]
SOME += [Case(m, dtype="float32") for m in ("rk4", "magnus4", "lie_midpoint")]
RATES = [*(Case(m) for m in of("rate")), *SOME]
BODIES = [(m, "float64") for m in of("free")] + [(m, "float32") for m in SINGLE]
LOW_PARTS = [
    (m, scene, dtype)
    for m, scene in (("magnus4", "rate"), ("rk4", "free"), ("dmv10", "free"))
    for dtype in ("float64", "float32")
]


@pytest.mark.parametrize(
    "case", in_tiers([Case("rk4"), Case("rk4", "euler313"), Case("magnus4"), SOME[-2]], RATES)
)
def test_given_rates(case):
    assert complaints(cells(case, "rate")) == []


@pytest.mark.parametrize(
    ("method", "dtype"), in_tiers([("rk4", "float64"), ("dmv10", "float32")], BODIES)
)
def test_free_bodies(method, dtype):
    assert complaints(cells(Case(method, dtype=dtype), "free")) == []


@pytest.mark.parametrize("method", in_tiers(["rk4", "strang2"], of("torqued")))
def test_torques(method):
    """Damping of any strength and a pendulum of any frequency."""
    assert complaints(cells(Case(method), "torqued")) == []


@pytest.mark.parametrize(
    ("method", "scene", "dtype"), in_tiers([("magnus4", "rate", "float64")], LOW_PARTS)
)
def test_compensated(method, scene, dtype):
    """Low parts spoil no status, whatever becomes of them."""
    assert complaints(cells(Case(method, dtype=dtype, compensated=True), scene)) == []


OF_SAMPLES = [m.name for m in fa.METHODS.values() if m.window is not None]


@pytest.mark.parametrize("scene", ["sampled rates", "increments"])
@pytest.mark.parametrize("method", in_tiers(["hold", "coning2"], OF_SAMPLES))
def test_samples(method, scene):
    if scene in fa.METHODS[method].scenes:
        assert complaints(cells(Case(method), scene)) == []


@each("method", [m.name for m in fa.METHODS.values() if m.exponentials and "rate" in m.scenes])
def test_a_rate_that_is_known_to_be_constant(method):
    """One exponential is the whole answer at any angle, but of a method whose equation is not."""
    record = fa.METHODS[method]
    for theta in rates.THETAS.values():
        found = rates.constant(theta)(Case(method))
        assert not found.wrong.any()
        assert found.status.any() == (theta > 2.0 and not record.exact_for_constant)


# that the rule can be broken


@pytest.mark.parametrize("method", in_tiers(["rk4", "magnus4"], of("rate")))
def test_cones_past_the_limit_are_wrong_but_for_their_status(method):
    """The flags hide nothing that would do without them."""
    for theta in (3.6, 4.5, 5.5):
        found = rates.coning(theta, n_steps=1)(Case(method))
        assert found.status.all()
        # gauss12 is off by 0.34 rad at 3.6 rad, not yet by a tenth of the angle
        is_wrong = Outcome(found.error, found.allowed, 0 * found.status).wrong.any()
        assert is_wrong or (method == "gauss12" and theta == 3.6 and found.error.max() > 0.3)


@pytest.mark.parametrize("method", in_tiers(["rk4", "dmv10"], of("free")))
def test_bodies_past_the_limit_are_wrong_but_for_their_status(method):
    inertia = np.array(bodies.SHAPES["1, 2, 2.9"])
    w0 = np.vstack([theta * bodies.spins(inertia)[:8] for theta in (4.0, 6.0, 7.0, 8.0, 12.0)])
    found = bodies.free(inertia, w0, 1.0, 1)(Case(method))
    assert not found.wrong.any()
    assert Outcome(found.error, found.allowed, 0 * found.status).wrong.any()


@each("method", SPLITTINGS)
def test_a_splitting_that_samples_a_torque_too_seldom_is_wrong_but_for_its_status(method):
    """However symmetric the body: of a free one any step is right."""
    wrong = []
    for theta in (2.0 * np.pi, 30.0, 16.0 * np.pi):
        found = bodies.turning_under_weight(theta).run(Case(method))
        assert not found.wrong.any()
        assert theta < 7.0 or found.status.all()
        wrong.append(Outcome(found.error, found.allowed, 0 * found.status).wrong.any())
    assert any(wrong)


@each("method", SPLITTINGS)
def test_angles_without_a_digit_are_told(method):
    """Of a symmetric body a splitting may take any step, but not one of 1e20 turns."""
    shapes = np.array([[1.0, 1.0, 0.5], [2.0, 1.0, 2.0 / 3.0]])
    w0 = np.array([[0.1, 0.2, 1.0], [1e20, 3e19, 7e19]])
    for inertia in shapes:
        scene = fa.Scene(inertia=np.tile(inertia, (2, 1)))
        run = fa.propagate(scene, START, w0, dt=1.0, n_steps=20, method=method)
        assert [status == 0 for status in run.status] == [True, False]


def test_what_is_allowed_is_small_where_a_method_is_good():
    """Else the rule would say nothing."""
    free = bodies.free(np.array(bodies.V), 0.1 * bodies.spins(np.array(bodies.V)), 1.0, 16)
    for case, run, most in (
        (Case("lie_midpoint"), rates.coning(0.1), 0.01),
        (Case("magnus6"), rates.coning(0.1), 1e-8),
        (Case("rk4"), free, 1e-4),
        (Case("kahan_li8"), free, 1e-10),
        (Case("dmv10"), free, 1e-11),
    ):
        found = run(case)
        assert not found.status.any()
        assert found.allowed.max() < most


# bodies in other units, backwards, and for long


@each("method", ["rk4", *[m.name for m in fa.METHODS.values() if energy.keeps_energy(m)]])
def test_energy_has_no_secular_drift(method):
    """Mean slope over 64 bodies within its uncertainty, of RK4 far from it."""
    n = 20_000
    drift = energy.energy(Case(method), n)
    assert drift.largest < (1e-2 if fa.METHODS[method].order < 4 else 1e-4)
    lost = abs(drift.slope)
    if method == "rk4":
        assert lost > 5.0 * drift.uncertainty
    else:
        # rounding of the moments' powers has a sign: 1 ulp in 100 steps at most
        assert lost < 4.0 * drift.uncertainty + 0.01 * Case(method).eps


def test_the_page_is_of_all_methods_and_nothing_in_it_is_wrong():
    page = Path(__file__).resolve().parents[1] / "bench/EXTREMES.md"
    text = page.read_text(encoding="utf-8")
    assert "There are 0 in" in text
    assert "Energy over 1e7 steps" in text
    assert [name for name in fa.METHODS if f"| {name} |" not in text] == []
    assert [table.title for table in tables.TABLES if f"| {table.title} |" not in text] == []
