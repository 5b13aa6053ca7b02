"""The self-check of a method on a scene."""

from __future__ import annotations

from numpy.typing import ArrayLike, DTypeLike

from fastatt import checks
from fastatt.attitudes import Attitude
from fastatt.methods import Method
from fastatt.running.ensemble import Ensemble
from fastatt.running.propagate import check_order
from fastatt.running.self_check import SelfCheck
from fastatt.scene import Scene


def self_check(
    scene: Scene,
    q0: ArrayLike,
    w0: ArrayLike | None = None,
    *,
    v0: ArrayLike | None = None,
    r0: ArrayLike | None = None,
    dt: float,
    n_steps: int,
    method: str | Method | None = None,
    representation: str | Attitude = "quat",
    dtype: DTypeLike | None = None,
    n_threads: int | None = None,
    t0: float = 0.0,
    sample: int = 64,
    at: str = "run",
) -> SelfCheck:
    """Order and error that a run shows of itself, by halving its step on a sample of its bodies.

    Takes 3 to some 100 times as long as the run takes on ``sample`` bodies: the step is halved
    twice, and again while the order is below the declared one. Arguments are those of
    :func:`fastatt.propagate`. Results are compared over the "run", after each of its steps or, of
    more than 1024, at so many even times of it and of its beginnings; with ``at="end"`` at its end
    alone. The check sees any error of the method that lowers its order, such as a wrong weight or
    sign or a stale rate; it sees none that a method of the same order for other equations would
    make.

    Returns
    -------
    SelfCheck : ``order``, ``declared``, ``error``, ``limited_by``, ``norm``, ``passed``.

    Warns
    -----
    OrderWarning : the order observed is below the declared one by more than 0.5: the method is
        broken, or what acts is not smooth, such as a sampled torque between whose samples a step
        is no whole fraction.

    Raises
    ------
    ValueError, TypeError : an argument that does not fit, by name, with what is accepted.
    """
    return check_order(
        Ensemble.of(scene, q0, w0, v0, r0), dt, n_steps, checks.whole("sample", sample, 1), at,
        method=method, representation=representation, dtype=dtype, n_threads=n_threads, t0=t0,
    )  # fmt: skip
