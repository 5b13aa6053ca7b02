"""Which two options of ``propagate`` combine: every pair is tried, as the reference has it."""

from __future__ import annotations

import itertools
import re
from pathlib import Path

import pytest

import fastatt as fa

PAGE = Path(fa.__file__).parent / "docs" / "reference" / "propagation.md"
FREE = fa.Scene(inertia=(2.0, 1.0, 0.7))
START = {
    "q0": [[1.0, 0.0, 0.0, 0.0], [0.6, 0.8, 0.0, 0.0]],
    "w0": [[0.1, 0.3, -0.2], [-0.1, 0.2, 0.3]],
}


def crossing(t, q, w, p):
    return w[0]


OPTIONS = {
    "t_end=": {"t_end": 1.03},
    "dt=(N,)": {"dt": [0.1, 0.05], "n_steps": [10, 20]},
    "save_every=": {"save_every": 4},
    "save_at=": {"save_at": [0.33, 0.77]},
    "on_save=": {"save_every": 4, "on_save": lambda saves: None},
    "events=": {"events": fa.event(crossing)},
    "checkpoint=": {},
    "compensated=True": {"compensated": True},
    "normalise=k": {"normalise": 4},
    'dtype="float32"': {"dtype": "float32"},
    'invalid="flag"': {"invalid": "flag"},
    "t0=": {"t0": 0.25},
    'method="exact"': {"method": "exact"},
    'representation="dcm"': {"representation": "dcm"},
}


def options_of(names, file):
    """The arguments of a run with these options."""
    found = {"dt": 0.1, "n_steps": 10, "method": "rk4"}
    for name in names:
        found.update(OPTIONS[name])
    if "t_end=" in names:
        found["n_steps"] = None
    if "checkpoint=" in names:
        found["checkpoint"] = file
    return {**START, **found}


def refused_by(table):
    """The names in each row of the page's table; the first column is the key."""
    rows = [re.findall(r"`([^`]+)`", row) for row in table.splitlines()]
    return {name: set(others) for name, *others in rows}


def test_every_pair_is_accepted_or_refused_as_the_page_says(tmp_path):
    table = re.search(r"^\| option .*\n.*\n((?:\|.*\n)+)", PAGE.read_text(), re.MULTILINE)
    page = refused_by(table[1])
    found, messages = {name: set() for name in OPTIONS}, []
    for i, (a, b) in enumerate(itertools.combinations(OPTIONS, 2)):
        options = options_of((a, b), tmp_path / str(i))
        try:
            run = fa.propagate(FREE, **options)
        except (TypeError, ValueError) as error:
            messages.append(str(error))
            found[a].add(b)
            found[b].add(a)
        else:
            assert not run.status.any(), (a, b)
    assert found == page
    assert [m for m in messages if not re.search("found .*; accepted", m)] == []


def test_options_that_need_a_third(tmp_path):
    """Saves that are passed on come at intervals."""
    kept = options_of(("on_save=",), None)
    with pytest.raises(ValueError, match="on_save: found without save_every"):
        fa.propagate(FREE, **{**kept, "save_every": None})
    both = [kept["on_save"], fa.to_file(tmp_path / "saves.npy")]
    fa.propagate(FREE, **{**kept, "on_save": both})
    assert (tmp_path / "saves.npy").exists()
