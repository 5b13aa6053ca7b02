"""Saves handed out as they come: each once, under one bar."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_array_equal

import fastatt as fa
from fastatt.engine import ensemble

N = 70  # more than a tile
RNG = np.random.default_rng(2)
Q0, W0 = RNG.normal(size=(N, 4)), RNG.normal(size=(N, 3))
FREE = fa.Scene(inertia=(2.0, 1.0, 2.0 / 3.0))


def handed_out(n_steps, **options):
    """What a sink was handed: times, attitudes, angular velocities, departures; and the sizes."""
    pieces = []

    def sink(piece):
        pieces.append([x.copy() for x in (piece.t, piece.q, piece.w, piece.defect)])

    last = fa.propagate(FREE, Q0, W0, dt=0.05, n_steps=n_steps, save_every=10, sink=sink, **options)
    return last, [np.concatenate(x) for x in zip(*pieces, strict=True)], [len(p[0]) for p in pieces]


@pytest.mark.parametrize("method", ["rk4", "exact"])
@pytest.mark.parametrize(
    ("n_steps", "sizes"), [(333, [17, 16, 2]), (320, [17, 16]), (160, [17]), (4, [2]), (0, [1])]
)
def test_each_save_once(method, n_steps, sizes):
    """The pieces one after another are the history, of which the last is the result."""
    stored = fa.propagate(FREE, Q0, W0, dt=0.05, n_steps=n_steps, save_every=10, method=method)
    last, found, lengths = handed_out(n_steps, method=method)
    for pieces, whole in zip(found, (stored.t, stored.q, stored.w, stored.defect), strict=True):
        assert_array_equal(pieces, whole)
    assert lengths == sizes
    assert_array_equal(last.q, stored.q[-1:])


@pytest.fixture
def bars(monkeypatch):
    """The bars that were opened: what each counts up to, and its updates."""
    tqdm = pytest.importorskip("tqdm")
    opened = []

    class Bar(tqdm.tqdm):
        def __init__(self, *args, **options):
            super().__init__(*args, **options, disable=True)
            opened.append((options["total"], []))

        def update(self, n=1):
            opened[-1][1].append(n)

    monkeypatch.setattr(tqdm, "tqdm", Bar)
    return opened


@pytest.mark.parametrize("method", ["rk4", "exact"])
def test_one_bar_for_all_pieces(bars, method):
    handed_out(333, method=method, progress=True)
    assert bars == [(35, [17, 16, 2])]


def test_nothing_is_compiled_under_a_bar(bars, monkeypatch):
    """The wait is said to be one, before there is anything to count."""
    opened_at_compilation = []

    def compiled(text):
        opened_at_compilation.append(len(bars))
        return made(text)

    made = ensemble.compiled
    monkeypatch.setattr(ensemble, "compiled", compiled)
    ensemble.program.cache_clear()
    fa.propagate(FREE, Q0, W0, dt=0.05, n_steps=2, method="rk4", progress=True)
    assert opened_at_compilation == [0]
    assert len(bars) == 1


def test_refusals():
    for sink, wrong in ((3, TypeError), (print, ValueError)):
        with pytest.raises(wrong, match="sink: found"):
            fa.propagate(FREE, Q0, W0, dt=0.1, n_steps=1, sink=sink, progress=True)
