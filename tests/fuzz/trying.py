"""Hostile input to what takes arrays and files: runs, scenes, closed forms, logs.

A call passes when it gives back finite numbers and unit attitudes, of each body with status 0, or
refuses in one line that names the argument. Anything else is a finding: another exception, a
warning but ``StepWarning``, ``GyroLogWarning`` and that of a status, more than 5 s, numbers that
are not finite with status 0.
"""

from __future__ import annotations

import contextlib
import re
import time
import warnings
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np

import fastatt as fa
from fastatt.gyro import GyroLogWarning
from fuzz.arrays import METHODS, integrated
from fuzz.draw import Draw
from fuzz.judge import Call
from fuzz.models import closed_form, scened
from fuzz.reading import read
from fuzz.runs import RUNS, Run, propagated

SLOW = 5.0  # s; a call that takes longer twice hangs


class Finding(NamedTuple):
    """A class of findings: where, what, and the first example."""

    target: str
    what: str
    example: str


def _shown(call: Call) -> str:
    given = [repr(a) for a in call.arguments] + [f"{k}={v!r}" for k, v in call.options.items()]
    return f"{getattr(call.function, '__name__', call.function)}({', '.join(given)})"


def tried(call: Call) -> tuple[str, str | None]:
    """("returned" or "refused", what is wrong or None)."""
    began = time.perf_counter()
    outcome, wrong, result = "returned", None, None
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        try:
            result = call.function(*call.arguments, **call.options)
        except call.refusals as error:
            outcome, text = "refused", str(error)
            if isinstance(error, OSError):
                pass
            elif len(text.splitlines()) != 1:
                wrong = f"{type(error).__name__} of several lines: {text[:10]!r}"
            elif len(text) > 1500:
                wrong = f"{type(error).__name__} of {len(text)} characters: {text[:10]!r}"
            elif not any(re.search(rf"(?<!\w){re.escape(n)}(?!\w)", text) for n in call.names):
                wrong = f"{type(error).__name__} names no argument: {text[:90]!r}"
        except (Exception, SystemExit) as error:  # noqa: BLE001
            outcome = "refused"
            wrong = f"{type(error).__name__}: {str(error)[:110]!r}"
        took = time.perf_counter() - began
        if wrong is None and outcome == "returned":
            wrong = call.judge(result)
    expected = fa.StepWarning, GyroLogWarning
    others = [
        w for w in said
        if not (issubclass(w.category, expected) or str(w.message).startswith("status: "))
    ]  # fmt: skip
    if wrong is None and others:
        wrong = f"{others[0].category.__name__}: {str(others[0].message)[:60]!r}"
    if wrong is None and took > SLOW:
        began = time.perf_counter()
        with contextlib.suppress(Exception), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            call.function(*call.arguments, **call.options)
        if time.perf_counter() - began > SLOW:
            wrong = f"takes {took:.0f} s"
    return outcome, wrong


Target = tuple[str, float, Callable[[Draw], Call]]


def targets(
    folder: Path, runs: tuple[Run, ...] = RUNS, methods: tuple[str, ...] = METHODS
) -> list[Target]:
    """Name, weight and maker of calls."""
    return [
        ("propagate", 4.0, lambda d: propagated(d, runs)),
        ("Scene", 4.0, scened),
        ("exact", 2.0, closed_form),
        ("integrate_rates", 3.0, lambda d: integrated(d, methods)),
        ("read_gyro_log", 5.0, lambda d: read(d, folder)),
    ]


def fuzz(
    inputs: int, seed: int, chosen: list[Target]
) -> tuple[dict[str, Counter[str]], Counter[tuple[str, str]], list[Finding]]:
    """Outcomes by target, counts of findings by class, and each class once."""
    d = Draw(seed)
    outcomes: dict[str, Counter[str]] = {name: Counter() for name, _, _ in chosen}
    counts: Counter[tuple[str, str]] = Counter()
    found: list[Finding] = []
    weights = [w for _, w, _ in chosen]
    for i in range(inputs):
        name, _, make = d.random.choices(chosen, weights)[0]
        with np.errstate(all="ignore"), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            call = make(d)
        outcome, wrong = tried(call)
        outcomes[name][outcome] += 1
        if wrong is not None:
            kind = name, re.sub(r"\bfound .*|'.*?'|-?\d+(\.\d+)?(e[+-]?\d+)?", "#", wrong)[:90]
            counts[kind] += 1
            if counts[kind] == 1:
                found.append(Finding(name, wrong, f"input {i}: {_shown(call)[:1500]}"))
    return outcomes, counts, found
