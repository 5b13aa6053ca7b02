"""Orders and invariants of every method for a given rate, over the list."""

from collections import Counter

import numpy as np
import pytest
from each import each
from exact import (
    LADDER,
    START,
    SWIFT,
    SWIFT_LADDER,
    angle,
    combinations,
    generic,
    observed_order,
)

import fastatt as fa
from fastatt.attitudes import QUATERNION
from fastatt.attitudes.attitude import FAMILIES
from fastatt.engine.job import Job
from fastatt.methods.windows import CHUNK, MOST_HISTORY
from fastatt.propagation.choice_of_method import methods_for
from fastatt.scene.equations import Body, Turning

BODIES = generic(3)
START3 = np.broadcast_to(START, (3, 4))
SPAN = 2.0
END = BODIES.attitude(0.0, SPAN)
METHODS = [m for m in fa.METHODS.values() if "rate" in m.scenes]


def final_error(n, method, representation, motion=BODIES, end=END):
    traj = fa.propagate(
        motion.scene, START3, dt=SPAN / n, n_steps=n, method=method, representation=representation
    )
    return angle(traj.q[-1], end).max()


def some(pairs):
    """Every method on quaternions; a derivative and an exponential on all representations."""
    return [(m, r) for m, r in pairs if r == "quat" or m in ("rk4", "magnus4")]


@pytest.mark.parametrize(("method", "representation"), some(combinations()))
def test_observed_order_is_the_declared_one(method, representation):
    motion, ladder = (SWIFT, SWIFT_LADDER) if method == "gauss12" else (BODIES, LADDER)
    end = motion.attitude(0.0, SPAN)
    found = observed_order(
        lambda n: final_error(n, method, representation, motion, end), SPAN, ladder=ladder
    )
    assert found == pytest.approx(fa.METHODS[method].order_of("rate"), abs=0.25)


def test_the_polynomial_limits_the_error_of_gauss12():
    """With two terms fewer the series would: 1e-8 rad."""
    assert final_error(2, "gauss12", "quat") < 4e-10


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
    names = methods_for(BODIES.scene, representation)
    assert names == [m.name for m in METHODS if representation in m.representations]
    assert set(names) <= set(methods_for(BODIES.scene))


SCENES = {
    "rate": fa.Scene(rate=fa.rates.Coning(0.5, 1.0)),
    "torqued": fa.Scene(inertia=(1.0, 2.0, 2.5), torque=fa.torques.HeavyTop((0.1, 0.2, 0.3), 1.0)),
}


@pytest.mark.parametrize(
    ("record", "kind"),
    [
        (m, kind)
        for m in fa.METHODS.values()
        for kind in ("rate", "torqued")
        if m.is_stepped and kind in m.scenes
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
    formulas = Job(record, QUATERNION, packed.structure)
    assert formulas.small_angle.results
    assert max(1, len(record.stages)) * counts["evaluations"] == record.evaluations(kind)
    assert kind != "rate" or counts["turns"] == record.exponentials


def test_windows_fit_into_the_chunks_of_the_engine():
    windows = [m.window for m in fa.METHODS.values() if m.window is not None]
    assert all(CHUNK % w.span == 0 and w.history <= MOST_HISTORY for w in windows)
