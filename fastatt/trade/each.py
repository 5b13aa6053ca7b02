"""Steps of each body's own for a tolerance: from the bodies' rates and from measured errors."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fastatt import checks
from fastatt.arrays import angle_between
from fastatt.engine.loop import WIDTH
from fastatt.methods import Method
from fastatt.propagation.choice_of_method import method_of
from fastatt.propagation.ensemble import Ensemble
from fastatt.propagation.propagate import propagate
from fastatt.rounding import noted
from fastatt.scene.rates import lengths
from fastatt.scene.scene import as_scene

# classes of like rates, times that errors are looked at
_CLASSES, _LOOKS = 12, 16
_FIRST = 0.3  # rad a step of the first trial
_LARGE = 0.1  # rad between two trials: more is no order yet
_TRIALS = 10
_WORTH = 0.7  # of the steps: less is offered
_FINEST = 1e-15  # rad
_SAFETY = 1.5  # for the bodies that were not measured


@dataclass(frozen=True)
class OwnSteps:
    """A step and a number of steps for each body, (N,), and what to expect of them.

    ``share`` is the number of steps beside that of one step for all, the smallest; the error, rad,
    is the largest over the run, of the bodies that were looked at.
    """

    method: str | Method
    dt: NDArray[np.float64] = field(repr=False)
    n_steps: NDArray[np.int64] = field(repr=False)
    expected_error: float
    share: float

    @property
    def arguments(self) -> dict[str, Any]:
        """Keyword arguments for ``fastatt.propagate``."""
        return {"method": self.method, "dt": self.dt, "n_steps": self.n_steps}

    def __str__(self) -> str:
        name = self.method if isinstance(self.method, str) else self.method.name
        return (
            f"{name}: {self.n_steps.min()} to {self.n_steps.max()} steps, {self.share:.2f} of the "
            f"steps of one dt for all; error {self.expected_error:.1e} rad at most"
        )


def own_steps(
    scene: Any,
    q0: ArrayLike,
    w0: ArrayLike,
    *,
    t_end: float,
    tol: float,
    method: str | Method | None = None,
    t0: float = 0.0,
    sample: int = 1536,
    seed: int = 0,
) -> OwnSteps:
    """Steps of each body's own with which the largest error over a run meets a tolerance.

    Bodies are put into classes of like rates. On a sample of each the method's error is measured by
    halving the steps. A body takes the lesser of two numbers that were enough for all of its class
    that were looked at: one for the class, and one that falls with the rate to the power
    1 + 1/order; those that are stepped side by side take the most of their numbers. Takes as long
    as a few runs of the sample. Other bodies can exceed the tolerance: of 6000 under gravity
    gradient up to seven did, by up to four times; of free bodies and heavy tops up to 15, by half.

    Parameters
    ----------
    scene, q0, w0, t0 : as of :func:`fastatt.propagate`, of a scene with inertia.
    t_end : duration, s, above 0.
    tol : largest error of a body over the run, rad, at least 1e-15.
    method : one that steps; None takes rk8 where it fits, else the first that does.
    sample : how many bodies are looked at, the fastest among them, besides those with the least and
        the largest of each number of the scene; as many as there are, and none exceeds the
        tolerance unseen.
    seed : of the choice of bodies.

    Raises
    ------
    ValueError, TypeError : an argument that does not fit; a tolerance that rounding hides.

    Examples
    --------
    >>> import fastatt as fa, numpy as np
    >>> scene = fa.Scene(inertia=(2.0, 1.0, 2 / 3))
    >>> w0 = np.geomspace(0.1, 10.0, 500)[:, None] * (0.6, 0.0, 0.8)
    >>> own = fa.own_steps(scene, (1, 0, 0, 0), w0, t_end=10.0, tol=1e-6, method="rk4")
    >>> run = fa.propagate(scene, (1, 0, 0, 0), w0, **own.arguments)
    >>> bool(own.share < 0.3)
    True
    """
    if as_scene(scene).kind == "rate":
        raise ValueError("scene: found a rate; accepted: with inertia")
    ensemble = Ensemble.of(scene, q0, w0)
    duration, wanted = checks.real("t_end", t_end), checks.real("tol", tol)
    if not duration > 0.0:
        raise ValueError(f"t_end: found {t_end}; accepted: above 0")
    if not wanted >= _FINEST:
        raise ValueError(f"tol: found {tol}; accepted: at least {_FINEST}, less is rounding")
    record = method_of(scene, method, "quat", need="is_stepped")
    run = (checks.real("t0", t0), duration, wanted)
    n = ensemble.size
    rates = lengths(np.broadcast_to(np.asarray(ensemble.w0, dtype=np.float64), (n, 3)))
    rates = np.maximum(rates, rates.max(initial=0.0) * 1e-6 + 1e-300)
    classes = _Classes(rates)
    looked_at = checks.whole("sample", sample, 1)
    rows = np.arange(n)
    if looked_at < n:
        rows = classes.sample(looked_at, np.random.default_rng(seed))
        if scene.rows is not None:
            numbers = scene.packed(n).params
            rows = np.unique([*rows, *numbers.argmin(axis=0), *numbers.argmax(axis=0)])
    sampled = rates[rows], classes.of[rows], classes.tops
    power = 1.0 + 1.0 / record.order_of(scene.kind)
    flat, rising = _counts(ensemble.take(rows), record, run, sampled, power)
    # each is enough for all bodies of a class that were looked at, so the lesser one is
    share = (rates / classes.tops[classes.of]) ** power
    enough = np.minimum(flat[classes.of], rising[classes.of] * share)
    limit = rates * duration / record.limit("quat", body=True, torqued=scene.kind == "torqued")
    steps = np.ceil(np.maximum(np.maximum(enough, limit), 1.0) - 1e-9).astype(np.int64)
    # bodies of a tile wait for its slowest anyway, and of equal steps share what time alone decides
    order = np.argsort(-steps, kind="stable")
    steps[order] = np.repeat(steps[order[::WIDTH]], WIDTH)[:n]
    return OwnSteps(
        method if method is not None else record.name, duration / steps, steps, wanted,
        float(steps.mean() / steps.max()),
    )  # fmt: skip


def share_of(ensemble: Ensemble, order: int) -> float | None:
    """Steps of each body's own beside those of one dt, by rates alone; None where not much less.

    At an equal error steps grow with the rate to the power 1 + 1/order.
    """
    if ensemble.w0 is None or not order or ensemble.size < 2 * _CLASSES:
        return None
    rates = lengths(np.atleast_2d(ensemble.w0).astype(np.float64))
    most = float(rates.max(initial=0.0))
    share = float(np.mean((rates / most) ** (1.0 + 1.0 / order))) if most > 0.0 else 1.0
    return share if share < _WORTH else None


class _Classes:
    """Bodies of like rates: equal ratios, so that the few fastest are not among the many slow."""

    def __init__(self, rates: NDArray[np.float64]) -> None:
        self._logs = np.log(rates)
        low, high = float(self._logs.min()), float(self._logs.max())
        width = max(high - low, 1e-12) / _CLASSES
        found = np.minimum((self._logs - low) / width, _CLASSES - 1).astype(np.int64)
        names, self.of = np.unique(found, return_inverse=True)
        self.tops = np.array([rates[self.of == k].max() for k in range(names.size)])

    def sample(self, n: int, chance: np.random.Generator) -> NDArray[np.intp]:
        """As many of each, n in all, the fastest of all among them."""
        each = max(1, n // self.tops.size)
        chosen = [int(self._logs.argmax())]
        for k in range(self.tops.size):
            members = np.flatnonzero(self.of == k)
            chosen += chance.choice(members, min(each, members.size), replace=False).tolist()
        return np.unique(np.array(chosen, dtype=np.intp))


def _counts(
    bodies: Ensemble,
    method: Method,
    run: tuple[float, float, float],
    classes: tuple[NDArray[np.float64], NDArray[np.intp], NDArray[np.float64]],
    power: float,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Steps for a tolerance, by halving: enough for all of a class, and for its fastest body.

    The latter fall with the rate by its ``power``; ``classes`` are rates and classes of the bodies,
    and the largest rate of each class.
    """
    t0, duration, tol = run
    rates, of, tops = classes
    order = method.order_of(bodies.scene.kind)
    at = t0 + duration * np.arange(1, _LOOKS + 1) / _LOOKS
    aim = tol / _SAFETY
    least = np.maximum(4.0, np.ceil(tops * duration / method.limit("quat", body=True)))
    counts = np.maximum(least, np.ceil(tops * duration / _FIRST))

    def attitudes(steps: NDArray[np.float64]) -> NDArray[Any]:
        n = steps.astype(np.int64)[of]
        with noted():  # steps are still too large
            return propagate(
                bodies.scene, bodies.q0, bodies.w0, dt=duration / n, n_steps=n, method=method,
                t0=t0, save_at=at, invalid="flag",
            ).q  # fmt: skip

    fewer, larger = np.full(counts.size, np.inf), np.full(counts.size, np.inf)
    for _ in range(_TRIALS):
        angles = angle_between(attitudes(counts), attitudes(2.0 * counts)).max(axis=0)
        angles = np.nan_to_num(angles, nan=np.pi)
        errors = np.maximum(angles / (1.0 - 2.0**-order), 1e-16)
        each = counts[of] * (errors / aim) ** (1.0 / order)
        gaps, wanted = np.zeros(counts.size), least.copy()
        np.maximum.at(gaps, of, angles)
        np.maximum.at(wanted, of, each)
        # near enough for the order to say the rest
        near = (wanted <= 2.0 * counts) & (wanted >= np.minimum(0.8 * counts, counts - 2.0))
        if ((gaps < _LARGE) & near).all():
            fastest = np.zeros(counts.size)
            np.maximum.at(fastest, of, each * (tops[of] / rates) ** power)
            return wanted, fastest
        # rounding: in twice the steps no method of any order leaves nearly as much
        if ((gaps < _LARGE) & ~near & (counts > 1.9 * fewer) & (gaps > 0.7 * larger)).any():
            break
        fewer, larger = counts, gaps
        counts = np.where(gaps < _LARGE, np.clip(wanted, 0.5 * counts, 8.0 * counts), 2.0 * counts)
        counts = np.maximum(np.ceil(counts), least)
    raise ValueError(
        f"tol: found {tol}; accepted: what {method.name} can meet, errors stay at "
        f"{errors.max():.1e} rad"
    )
