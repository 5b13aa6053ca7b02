"""What acts on a body: only what the scene requires."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from numpy.typing import ArrayLike

from fastatt import checks, rates


@dataclass(frozen=True)
class Scene:
    """What is propagated.

    A kinematic scene has a ``rate``: a model of ``fastatt.rates``, whose numbers may be one for
    all bodies or a row each, or an ``@njit`` function ``rate(t, p) -> (w1, w2, w3)`` in rad/s, with
    t in s and p the tuple of ``params``, (P,) for all bodies or (N, P). ``frame`` says along which
    axes the rate is given: "body" (q̇ = ½ q∘w) or "inertial" (q̇ = ½ w∘q).

    Raises ``TypeError`` or ``ValueError`` for an unknown model, frame, or numbers of wrong shape.
    """

    rate: Any
    params: ArrayLike | None = None
    frame: str = "body"

    def __post_init__(self) -> None:
        checks.choice("frame", self.frame, ("body", "inertial"))
        if self.params is not None and not callable(self.rate):
            raise ValueError(
                f"params: found {checks.brief(self.params)} beside the model "
                f"{type(self.rate).__name__}; accepted: params with an @njit function only"
            )
        self.packed(None)

    @property
    def kind(self) -> str:
        """Always "rate": the angular velocity is given."""
        return "rate"

    @property
    def is_constant(self) -> bool:
        """Whether the rate never changes along its axes; then one exponential is exact."""
        return isinstance(self.rate, rates.Constant)

    def packed(self, n_bodies: int | None) -> rates.Packed:
        """The rate's tag and flat parameters, checked against the number of bodies."""
        function: Callable[..., Any] | None = self.rate if callable(self.rate) else None
        if function is not None:
            packed = rates.pack_user(function, self.params, n_bodies)
        else:
            packed = rates.pack(self.rate, n_bodies)
        if self.frame == "inertial":
            packed = packed._replace(tag=rates.InertialAxes(packed.tag))
        return packed
