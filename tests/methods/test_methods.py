"""Orders, error constants and invariants of every method for a given rate, over the list."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from each import each
from exact import (
    EPS,
    START,
    angle,
    combinations,
    cone,
    coning,
    exp,
    generic,
    mul,
    observed_order,
    steady,
)

import fastatt as fa
from fastatt.attitudes import QUATERNION
from fastatt.attitudes.attitude import FAMILIES
from fastatt.engine.job import Job
from fastatt.scene.equations import Body, Turning

BODIES = generic(3)
START3 = np.broadcast_to(START, (3, 4))
SPAN = 2.0
END = BODIES.attitude(0.0, SPAN)
METHODS = [m for m in fa.METHODS.values() if "rate" in m.scenes]


def final_error(n, method, representation):
    traj = fa.propagate(
        BODIES.scene, START3, dt=SPAN / n, n_steps=n, method=method, representation=representation
    )
    return angle(traj.q[-1], END).max()


def some(pairs):
    """Every method on quaternions; a derivative and an exponential on all representations."""
    return [(m, r) for m, r in pairs if r == "quat" or m in ("rk4", "magnus4")]


@pytest.mark.parametrize(("method", "representation"), some(combinations()))
def test_observed_order_is_the_declared_one(method, representation):
    found = observed_order(lambda n: final_error(n, method, representation), SPAN)
    assert found == pytest.approx(fa.METHODS[method].order_of("rate"), abs=0.25)


# error constants


# errors in the coarse and the fine step: a new method needs a row
KNOWN = [
    ("lie_euler", "9.4e-02", "2.3e-02"),
    ("lie_midpoint", "2.4e-02", "1.5e-03"),
    ("cg3", "9.6e-05", "1.3e-06"),
    ("rk4", "5.9e-06", "2.4e-08"),
    ("rkmk4", "3.1e-06", "1.2e-08"),
    ("magnus4", "6.4e-06", "2.5e-08"),
    ("cf4", "1.3e-05", "5.2e-08"),
    ("magnus6", "1.4e-07", "3.5e-11"),
    ("magnus8", "1.0e-04", "4.1e-07"),
    ("gauss12", "1.8e-09", "4.3e-13"),
]


@each(("method", "coarse", "fine"), KNOWN)
@each("column", [0, 1])
def test_coning_error_has_the_known_digits(method, coarse, fine, column):
    """Goodman and Robinson's coning at 1 rad and 1 rad/s, after 20 s, in steps of 0.2 and 0.05 s.

    Of order 8 and more in steps of 1 and 0.5 s: smaller ones are rounding.
    """
    h = ((1.0, 0.5) if fa.METHODS[method].order >= 8 else (0.2, 0.05))[column]
    start = coning(0.0, 1.0, 1.0)[None]
    n = round(20.0 / h)
    traj = fa.propagate(cone(1.0, 1.0).scene, start, dt=h, n_steps=n, method=method)
    error = angle(traj.q[-1, 0], coning(20.0, 1.0, 1.0))
    assert f"{error:.1e}" == (coarse, fine)[column]


def test_coning_table_names_every_method():
    assert sorted(row[0] for row in KNOWN) == sorted(m.name for m in METHODS)


THETAS = np.array([0.05, 0.1, 0.2, 0.4, 0.8, 1.6, 2.5])


@pytest.mark.parametrize(
    ("representation", "share", "angle_5", "norm_6"),
    [("quat", 2.0, 1920.0, 9216.0), ("dcm", 1.0, 120.0, 144.0), ("dcm_rows", 1.0, 120.0, 144.0)],
)
def test_rk4_on_a_constant_rate(representation, share, angle_5, norm_6):
    """A step multiplies by 1 + ix − x²/2 − ix³/6 + x⁴/24, x = θ/2 of a quaternion, θ of a matrix.

    Its argument is θ⁵/1920 or θ⁵/120 short of the angle, its modulus θ⁶/9216 or θ⁶/144 short of 1.
    """
    n = 20
    w = np.outer(THETAS, [0.0, 0.0, 1.0])
    start = np.tile([1.0, 0.0, 0.0, 0.0], (len(w), 1))
    traj = fa.propagate(
        steady(w).scene, start, dt=1.0, n_steps=n, method="rk4", representation=representation
    )
    x = THETAS / share
    factor = 1.0 - x**2 / 2.0 + x**4 / 24.0 + 1j * (x - x**3 / 6.0)
    lag = THETAS - share * np.angle(factor)
    modulus = np.abs(factor) ** n
    # of a matrix two rows shrink, and the third with them where it is their cross product
    third = modulus**4 - 1.0 if representation == "dcm_rows" else 0.0
    norm_error = np.sqrt(2.0 * (modulus**2 - 1.0) ** 2 + third**2)
    norm_error = modulus - 1.0 if representation == "quat" else norm_error
    assert traj.norm_error[-1] == pytest.approx(norm_error, rel=1e-12, abs=30 * n * EPS)
    left = traj.status & fa.Status.NORM_LOST != 0
    assert left.tolist() == (np.abs(norm_error) > 1e-3).tolist()

    found = fa.quat_to_rotation_vector(mul(exp(-n * w), traj.q[-1]))[:, 2]
    wrong = np.abs(found - np.angle(np.exp(-1j * n * lag)))
    # the length of a quaternion does not touch its attitude; that of rows does, unless it is small
    assert wrong[:3].max() < 30 * n * EPS
    if share == 2.0:
        assert wrong.max() < 30 * n * EPS

    # the leading terms, within the next ones
    small = THETAS <= 0.2
    assert lag[small] == pytest.approx(THETAS[small] ** 5 / angle_5, rel=0.05)
    assert (1.0 - np.abs(factor))[small] == pytest.approx(THETAS[small] ** 6 / norm_6, rel=0.05)


# a constant rate


AXIS = np.array([2.0, -1.0, 2.0]) / 3.0


@each(("method", "representation"), some(combinations(exponential=True)))
def test_exponentials_are_exact_for_a_constant_rate(method, representation):
    """At any angle, though a step is vouched for up to the limit only where the rate may vary."""
    sizes = np.array([0.0, 1e-160, 1e-9, 0.06, 1.0, 2.2])
    w = np.outer(sizes, AXIS)
    start = np.broadcast_to(START, (len(w), 4))
    n = 10
    traj = fa.propagate(
        steady(w).scene, start, dt=1.0, n_steps=n, method=method, representation=representation
    )
    expected = mul(START, exp(n * w))
    # cg3's largest turn is longer than the step
    past = sizes * (24.0 / 17.0 if method == "cg3" else 1.0) > fa.METHODS[method].limit("quat")
    assert (traj.status == np.where(past, fa.Status.STEP_TOO_LARGE, 0)).all()
    # each step rounds the state and the angle, a few ulps of 1 and of 3 rad
    assert angle(traj.q[-1], expected).max() < n * 12 * EPS


# time reversal


@each(("method", "representation"), some(combinations()))
def test_negative_step_retraces(method, representation):
    """Symmetric methods to round-off, the others to their own error.

    RK4's step on a linear equation is a symmetric one times a length, so it may do better.
    """
    n, h = 20, 0.1
    options = {"method": method, "representation": representation}
    out = fa.propagate(BODIES.scene, START3, dt=h, n_steps=n, **options)
    back = fa.propagate(BODIES.scene, out.q[-1], dt=-h, n_steps=n, t0=n * h, **options)
    assert back.t[-1] == pytest.approx(0.0, abs=1e-15)
    error = angle(back.q[-1], START3).max()
    if "rate" in fa.METHODS[method].reversible:
        assert error < 1e-13
    else:
        assert error < 4.0 * angle(out.q[-1], END).max()
        assert error > 1e-13 or method == "rk4"


def test_reversible_methods_are_those_that_are_symmetric():
    found = {m.name for m in METHODS if "rate" in m.reversible}
    assert found == {"lie_midpoint", "magnus4", "magnus6", "magnus8", "gauss12", "cf4"}


# the records


@each("record", fa.METHODS.values())
def test_record_is_complete(record):
    assert fa.METHODS[record.name] is record
    assert record.order >= 1 or not record.is_stepped
    assert record.is_stepped + record.is_exact + (record.window is not None) == 1
    assert set(record.reversible) <= set(record.scenes)
    assert record.summary
    if record.summary.endswith("reversible"):
        assert set(record.reversible) == set(record.scenes)
    assert record.source
    given = {"rate", "sampled rates", "increments"}
    assert set(record.scenes) <= {*given, "spherical", "symmetric", "free", "torqued"}
    kinds = {*FAMILIES, "body", "torqued", "rates", "increments"}
    assert set(record.limits) <= kinds
    assert record.exact_for_constant <= (record.exponentials > 0)
    if record.stages:
        free, other, at = np.array(record.stages).T
        assert [free.sum(), other.sum()] == pytest.approx([1.0, 1.0], abs=1e-15)
        assert at == pytest.approx(np.cumsum(free), abs=1e-15)
        assert free == pytest.approx(free[::-1], abs=1e-15)


@pytest.mark.parametrize("representation", ["quat", "dcm", "dcm_rows", "euler313"])
def test_methods_for_a_representation(representation):
    names = fa.methods_for(BODIES.scene, representation)
    assert names == [m.name for m in METHODS if representation in m.representations]
    assert set(names) <= set(fa.methods_for(BODIES.scene))


SCENES = {
    "rate": fa.Scene(rate=fa.rates.Coning(0.5, 1.0)),
    "torqued": fa.Scene(inertia=(1.0, 2.0, 2.5), torque=fa.torques.HeavyTop((0.1, 0.2, 0.3), 1.0)),
}


def test_the_page_has_the_summaries_of_the_records():
    page = Path(fa.__file__).parent / "docs/explanations/methods.md"
    lines = page.read_text(encoding="utf-8").splitlines()
    rows = [[cell.strip(" `") for cell in line.split("|")[1:-1]] for line in lines]
    found = {(row[0], row[-1]) for row in rows if len(row) == 9 and row[0] in fa.METHODS}
    assert found - {(m.name, m.summary) for m in fa.METHODS.values()} <= {
        (name, "") for name in fa.METHODS
    }
    assert {name for name, summary in found if summary} >= {"cf4", "strang2", "exact"}


def test_the_page_has_the_limits_of_the_records():
    page = Path(fa.__file__).parent / "docs/explanations/status.md"
    text = page.read_text(encoding="utf-8").partition("| method | measure |")[2]
    found = [
        [cell.strip() for cell in line.split("|")[1:-1]]
        for line in text.partition("\n\n")[0].splitlines()[2:]
    ]
    expected = []
    for record in filter(lambda m: m.is_stepped, fa.METHODS.values()):
        stored = [x for x in ("quat", "dcm", "mrp", "euler313") if record.stores(x)]
        limits = [f"{record.limit(x):.3g}" for x in stored] + [""] * (4 - len(stored))
        for other in ({"body": True}, {"torqued": True}):
            own = record.limit("quat", **other)
            limits.append("" if own == record.limit("quat") else f"{own:.3g}")
        expected.append([f"`{record.name}`", record.measure, *limits])
    assert found == expected


@pytest.mark.parametrize(
    ("record", "kind"),
    [
        (m, "rate" if "rate" in m.scenes else "torqued")
        for m in fa.METHODS.values()
        if m.is_stepped and {"rate", "torqued"} & set(m.scenes)
    ],
    ids=lambda x: getattr(x, "name", x),
)
def test_a_step_evaluates_and_turns_as_often_as_its_record_says(record, kind, monkeypatch):
    """While its formulas are recorded; a splitting's are those of one stage."""
    counts = Counter()

    def counting(name, function):
        def counted(*args):
            counts[name] += 1
            return function(*args)

        return counted

    monkeypatch.setattr(Turning, "rate", counting("evaluations", Turning.rate))
    monkeypatch.setattr(Body, "torque", counting("evaluations", Body.torque))
    monkeypatch.setattr(Turning, "turned", counting("turns", Turning.turned))
    packed = SCENES[kind].packed(None, sorted_axes=record.sorted_axes)
    formulas = Job(record, QUATERNION, packed.structure).formulas
    assert formulas.small_angle.results
    assert max(1, len(record.stages)) * counts["evaluations"] == record.rate_calls
    assert kind != "rate" or counts["turns"] == record.exponentials


TORQUED = fa.Scene(inertia=(2.0, 1.0, 0.8), torque=fa.torques.QuadraticDamping(0.1))


@each(
    ("scene", "method", "reason"),
    [
        (TORQUED, "magnus4", "magnus4 needs a rate; this scene has inertia"),
        (BODIES.shared, "dmv2", "dmv2 needs inertia; this scene has a rate"),
        (TORQUED, "dmv2", "dmv2 is for spherical, symmetric, free bodies; this is torqued"),
        (TORQUED, "strang2", "strang2 needs a torque that does not depend on w, but for linear"),
        (TORQUED, "hold", "hold is for samples: fastatt.integrate_rates"),
        (TORQUED, "RK45", "nearest: rk8"),
        (TORQUED, "RK_4", "nearest: rk4"),
        (TORQUED, "gbs", "nearest: gbs16"),
    ],
)
def test_a_method_that_does_not_fit_says_why(scene, method, reason):
    with pytest.raises(ValueError, match=rf"^method: found '{method}'; accepted: .* \({reason}"):
        fa.propagate(scene, (1.0, 0.0, 0.0, 0.0), (0.1, 0.2, 0.3), dt=0.1, n_steps=1, method=method)
