"""Where rounding takes what a user may expect: angles and times that a precision does not hold."""

from __future__ import annotations

import math
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

import numpy as np
from numpy.typing import DTypeLike, NDArray

#: rad of rounding beyond which a motion in closed form is told to be wrong
LOST = 0.1
#: of a step, what the time may be rounded by
SHARE = 1e-3
#: where warnings go instead, of a thread whose caller hands them on
heard: ContextVar[list[str] | None] = ContextVar("heard", default=None)


class StepWarning(UserWarning):
    """A step beyond what the method can do, or too small for the precision."""


def warn(text: str) -> None:
    """Warn of something, in the first line outside this package."""
    if (told := heard.get()) is not None:
        told.append(text)
        return
    frame, level = sys._getframe(1), 2  # noqa: SLF001
    while frame.f_back is not None and frame.f_globals.get("__name__", "").startswith("fastatt."):
        frame, level = frame.f_back, level + 1
    warnings.warn(text, StepWarning, stacklevel=level)


@contextmanager
def noted() -> Iterator[list[str]]:
    """What is warned of within is listed instead."""
    told: list[str] = []
    before = heard.set(told)
    try:
        yield told
    finally:
        heard.reset(before)


def most_turned(dtype: DTypeLike) -> float:
    """Angle, rad, whose rounding is ``LOST``: what is turned in one exponential."""
    return LOST / float(np.finfo(dtype).eps)


def of_angles(angles: NDArray[np.float64], dtype: DTypeLike) -> str:
    """What to say of angles that bodies turn by in one go, rad: "" while half the digits are right.

    An angle is rounded as a whole, by |w| t eps.
    """
    eps = float(np.finfo(dtype).eps)
    most = float(np.max(angles, initial=0.0, where=np.isfinite(angles)))
    if most * eps <= math.sqrt(eps):
        return ""
    return (
        f"{most:.3g} rad at once, which {np.dtype(dtype)} rounds by {most * eps:.2g}: take shorter "
        "times or steps" + ("" if eps < 1e-12 else ", or float64")
    )


def of_times(longest: float, h: float) -> str:
    """What to say of a clock that counts to ``longest`` s in steps of h: "" if it tells them apart.

    A rate that a step resolves is wrong by less than ``SHARE`` rad of its phase.
    """
    tick = math.ulp(longest)
    if tick <= SHARE * abs(h):
        return ""
    return (
        f"t0: at {longest:.6g} s the time is rounded to {tick:.2g} s, of steps of {abs(h):.3g} s: "
        "count from a later epoch"
    )
