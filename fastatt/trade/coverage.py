"""What measurements of some bodies say about the error of all."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from fastatt import checks
from fastatt.trade.search import Point, Search

_CONFIDENCE = 0.95
_NAMED = 8  # bodies, at most, that the text names


@dataclass(frozen=True, kw_only=True)
class Coverage:
    """What measurements of some bodies say about the errors of all.

    Attributes
    ----------
    n_bodies : int
        Number of bodies.
    measured : int
        Number of bodies that were run.
    worst_body : int
        The body with the largest error of those that were run.
    exceeding_share : float
        Largest share of the bodies whose error may exceed the tolerance, with a confidence of 95 %
        (Clopper and Pearson 1934), as it follows from the bodies that were chosen at random.
    undetermined : tuple of int
        Bodies, of those that were run, that double precision does not determine to the tolerance,
        since their motion magnifies rounding. They are left out of errors, and count as exceeding
        the tolerance.
    exceeding : int or None
        Number of bodies whose attitude differs by more than the tolerance from a run with half the
        step size, if all were run (``all_bodies``).
    """

    n_bodies: int
    measured: int
    worst_body: int
    exceeding_share: float
    undetermined: tuple[int, ...]
    exceeding: int | None

    def _lines(self) -> list[str]:
        """Lines on bodies that were not run or may exceed the tolerance; none if all are well."""
        lines = []
        if self.exceeding is not None:
            few = f"{self.exceeding} of {self.n_bodies} bodies"
            lines.append(f"  all        {few} exceed tol, beside a run with half the step size")
        elif self.exceeding_share > 0.0:
            share = f"at most {100.0 * self.exceeding_share:.2g} %"
            lines.append(f"  others     {share} of the bodies exceed tol, with 95 % confidence")
        if self.undetermined:
            first = ", ".join(map(str, self.undetermined[:_NAMED]))
            more = ", ..." if len(self.undetermined) > _NAMED else ""
            lines.append(f"  chaotic    not determined by double precision: body {first}{more}")
        return lines


def coverage_of(searches: Sequence[tuple[Search, Point]], tol: float, all_bodies: bool) -> Coverage:
    """The errors and failures of all bodies, as far as searches on some of them show."""
    bodies, points = [search.whole.ensemble for search, _ in searches], [x for _, x in searches]
    size, beyond = sum(x.size for x in bodies), sum(x.beyond for x in points)
    # as many as if all groups were sampled as thinly as the thinnest
    random = min(point.random / x.size for point, x in zip(points, bodies, strict=True))
    worst, exceeding = max(points, key=lambda point: point.error).worst, None
    if all_bodies:
        each = np.concatenate([search.by_halving(point) for search, point in searches])
        places = np.concatenate([x.places for x in bodies])
        worst, exceeding = int(places[np.argmax(each)]), int((each > tol).sum())
    lost = [x.places[search.undetermined] for x, (search, _) in zip(bodies, searches, strict=True)]
    return Coverage(
        n_bodies=size, measured=sum(x.measured for x in points), worst_body=worst,
        exceeding_share=most_beyond(beyond, int(random * size), size), exceeding=exceeding,
        undetermined=tuple(sorted(np.concatenate(lost).tolist())),
    )  # fmt: skip


def share_of(name: str, value: Any) -> float:
    """A share above 0, up to 1."""
    accepted = "a number above 0, up to 1"
    share = checks.above_zero(name, value, accepted)
    if share > 1.0:
        raise ValueError(f"{name}: found {share:g}; accepted: {accepted}")
    return share


def most_beyond(beyond: int, random: int, size: int) -> float:
    """The largest share of bodies beyond a tolerance, of which a random sample shows so few.

    A larger one shows no more than ``beyond`` in ``random`` bodies in less than 5 % of samples.
    """
    if random == size:
        return beyond / size
    if beyond >= random:
        return 1.0
    k = np.arange(beyond + 1)
    ways = [math.lgamma(random + 1) - math.lgamma(j + 1) - math.lgamma(random - j + 1) for j in k]
    low, high = 0.0, 1.0
    for _ in range(60):
        p = 0.5 * (low + high)
        seen = np.exp(ways + k * math.log(p) + (random - k) * math.log1p(-p)).sum()
        low, high = (p, high) if seen > 1.0 - _CONFIDENCE else (low, p)
    return high
