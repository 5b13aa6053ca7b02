"""Which two options of ``propagate`` combine: every pair is tried, but for those of one table."""

import itertools
import re
from pathlib import Path

import fastatt as fa
from fastatt.propagation.schedule import FORBIDDEN

PAGE = Path(fa.__file__).parent / "docs" / "reference" / "propagation.md"
FREE = fa.Scene(inertia=(2.0, 1.0, 0.7))
START = {
    "q0": [[1.0, 0.0, 0.0, 0.0], [0.6, 0.8, 0.0, 0.0]],
    "w0": [[0.1, 0.3, -0.2], [-0.1, 0.2, 0.3]],
}


def crossing(t, q, w, p):
    return w[0]


OPTIONS = {
    "n_steps=": {"n_steps": 10},
    "t_end=": {"t_end": 1.03},
    "dt=(N,)": {"dt": [0.1, 0.05]},
    "save_every=": {"save_every": 4},
    "save_at=": {"save_at": [0.33, 0.77]},
    "on_save=": {"on_save": lambda saves: None},
    "events=": {"events": fa.event(crossing)},
    "checkpoint=": {},
    "compensated=True": {"compensated": True},
    "normalise=k": {"normalise": 4},
    'dtype="float32"': {"dtype": "float32"},
    "t0=": {"t0": 0.25},
    'method="exact"': {"method": "exact"},
    'representation="dcm"': {"representation": "dcm"},
}
#: what a method cannot do, which is a property of the method
OF_METHODS = {("events=", 'method="exact"')}
#: the names of the table in terms of the options
NAMES = {
    "dt (N,)": "dt=(N,)",
    "compensated": "compensated=True",
    "representation": 'representation="dcm"',
}


def options_of(names, file):
    """The arguments of a run with these options, which needs an end, and saves to hand out."""
    options = {"dt": 0.1, "method": "rk4"}
    for name in names:
        options.update(OPTIONS[name])
    if "on_save=" in names and "save_at=" not in names and "dt=(N,)" not in names:
        options.setdefault("save_every", 4)
    if not {"n_steps=", "t_end="} & set(names):
        options["t_end"] = 1.03
    elif "dt=(N,)" in names and "t_end" not in options:
        options["n_steps"] = [10, 20]
    if "checkpoint=" in names:
        options["checkpoint"] = file
    return {**START, **options}


def test_every_pair_is_accepted_or_is_one_of_the_table(tmp_path):
    table = {frozenset(NAMES.get(x, f"{x}=") for x in pair) for *pair, _ in FORBIDDEN}
    refused = {frozenset(pair) for pair in OF_METHODS}
    found, messages = set(), []
    for i, (a, b) in enumerate(itertools.combinations(OPTIONS, 2)):
        options = options_of((a, b), tmp_path / str(i))
        try:
            run = fa.propagate(FREE, **options)
        except (TypeError, ValueError) as error:
            messages.append(str(error))
            found.add(frozenset((a, b)))
        else:
            assert not run.status.any(), (a, b)
    assert found == table | refused
    assert [m for m in messages if not re.search("found .*; accepted", m)] == []


def test_the_page_shows_the_table():
    rows = [f"| `{first}` | `{second}` | {accepted} |" for first, second, accepted in FORBIDDEN]
    assert "\n".join(rows) in PAGE.read_text()
    assert len(FORBIDDEN) <= 6
