"""Saves handed out as they come, under one bar."""

import sys

import numpy as np
import pytest

import fastatt as fa
from fastatt.codegen import lanes
from fastatt.engine import program as programs

Q0, W0 = np.random.default_rng(2).normal(size=(2, 70, 4))  # more than a tile
FREE = fa.Scene(inertia=(2.0, 1.0, 2.0 / 3.0))


def run(**options):
    return fa.propagate(FREE, Q0, W0[:, 1:], dt=0.05, progress=True, **options)


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
    """Which counts the saves: each is handed out once."""
    found = []
    run(n_steps=333, save_every=10, method=method, on_save=lambda piece: found.extend(piece.t))
    assert bars == [(35, [17, 16, 2])]
    assert found == pytest.approx([*(0.5 * np.arange(34)), 16.65])


def test_many_pieces_are_handed_out(bars):
    """The pace of a run does not grow without end where saves end all of its pieces."""
    sizes = []
    run(n_steps=18000, save_every=1, method="rk4", on_save=lambda piece: sizes.append(piece.t.size))
    assert sum(sizes) == 18001


def test_a_bar_counts_the_steps_of_all_bodies(bars):
    run(n_steps=130, n_threads=2, method="rk4")
    ((total, done),) = bars
    assert sum(done) == total == 70 * 130


def test_progress_needs_its_package(monkeypatch):
    monkeypatch.setitem(sys.modules, "tqdm", None)
    with pytest.raises(ImportError, match="progress: needs tqdm"):
        run(n_steps=1)


def test_nothing_is_compiled_under_a_bar(bars, monkeypatch):
    """The wait is over, or said to be one, before there is anything to count."""
    opened_at_compilation = []

    def compiled(*given):
        opened_at_compilation.append(len(bars))
        return made(*given)

    made = lanes.generated
    monkeypatch.setattr(lanes, "generated", compiled)
    programs.program.cache_clear()
    run(n_steps=2, method="rk4")
    assert opened_at_compilation == [0]
    assert len(bars) == 1


def test_steps_that_grow_past_the_limit_are_warned_of_once():
    """As in the run that keeps its saves, at its end."""
    scene = fa.Scene(inertia=FREE.inertia, torque=fa.torques.Constant((0.0, 0.0, 2.0 / 3.0)))
    said = []
    for options in ({}, {"on_save": lambda piece: None}):
        with pytest.warns(fa.StepWarning, match="a step of body 0 is .* rad, rk4's limit") as found:
            fa.propagate(
                scene, [1, 0, 0, 0], [0, 0, 0.01], dt=0.2, n_steps=80, method="rk4", save_every=1,
                **options,
            )  # fmt: skip
        said.append([str(warning.message) for warning in found])
    assert said[0] == said[1]
    assert len(said[0]) == 1
