"""Warnings of rounding: angles and times beyond a precision."""

from __future__ import annotations

import math
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

import numpy as np
from numpy.typing import DTypeLike, NDArray

#: rad; a closed form with a larger rounding error is reported as wrong
LOST = 0.1
#: the largest rounding of the time, as a share of the step size
SHARE = 1e-3
#: a list that collects warnings in place of Python's
heard: ContextVar[list[str] | None] = ContextVar("heard", default=None)


class StepWarning(UserWarning):
    """Warns of a step that is beyond the method's limit, or too small for the precision."""


def warn(text: str, category: type[Warning] = StepWarning) -> None:
    """Issue a warning that points to the first line outside this package."""
    if (listed := heard.get()) is not None:
        listed.append(text)
        return
    frame, level = sys._getframe(1), 2  # noqa: SLF001
    while frame.f_back is not None and frame.f_globals.get("__name__", "").startswith("fastatt."):
        frame, level = frame.f_back, level + 1
    warnings.warn(text, category, stacklevel=level)


@contextmanager
def noted() -> Iterator[list[str]]:
    """Collect the warnings that are issued within the context in a list."""
    texts: list[str] = []
    before = heard.set(texts)
    try:
        yield texts
    finally:
        heard.reset(before)


def most_turned(dtype: DTypeLike) -> float:
    """The largest rotation angle of one exponential, rad, at which rounding reaches ``LOST``."""
    return LOST / float(np.finfo(dtype).eps)


def most_half_right(dtype: DTypeLike) -> float:
    """The largest rotation angle of one exponential, rad, of which half of the digits are right."""
    return math.sqrt(1.0 / float(np.finfo(dtype).eps))


def of_angles(angles: NDArray[np.float64], dtype: DTypeLike) -> str:
    """The warning of rotation angles of a step, rad; "" if half of their digits are right."""
    eps = float(np.finfo(dtype).eps)
    most = float(np.max(angles, initial=0.0, where=np.isfinite(angles)))
    if most <= most_half_right(dtype):
        return ""
    return (
        f"{most:.3g} rad at once, which {np.dtype(dtype)} rounds by {most * eps:.2g}: take shorter "
        "times or steps" + ("" if eps < 1e-12 else ", or float64")
    )


def of_times(longest: float, h: float) -> str:
    """The warning of times up to ``longest`` s in steps of h; "" if their rounding is small."""
    tick = math.ulp(longest)
    if tick <= SHARE * abs(h):
        return ""
    return (
        f"t0: at {longest:.6g} s the time is rounded to {tick:.2g} s, of steps of {abs(h):.3g} s: "
        "count from a later epoch"
    )
