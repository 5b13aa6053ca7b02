"""The record of a method, and its steps as formulas on traced numbers."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from fastatt import checks
from fastatt.attitudes import ATTITUDES
from fastatt.scene.torque_record import Dependence

#: key of the limit for a rigid body
BODY = "body"
#: key of the limit for a body under a torque, if it is another one
TORQUED = "torqued"
FREE = ("spherical", "symmetric", "free")
BODIES = (*FREE, "torqued")


@dataclass(frozen=True, eq=False)
class Steps:
    """The formulas of a method: plain functions on traced numbers.

    ``rate(motion, t, h, x)`` and ``body(motion, t, h, x)`` return (x(t + h), z) for the equations
    of motion ``scene.equations.Turning`` and ``Body``. z is the squared angle (rad²) of the step's
    largest rotation, infinite if an iteration did not converge. ``constant`` replaces ``rate`` for
    a constant rate, if it is given.

    A splitting method has ``stage(motion, t, h, k, x, e)`` instead: free motion for h s, then the
    other flow for k s. ``prepare(motion, h, x)`` returns the numbers e that a run with step size h
    needs of a body in addition to its parameters, from its initial state. ``enter`` and ``leave``
    convert between the state and the stepped variables: ``f(motion, t, s, k, x, e)``, s after the
    start t. ``iterates`` says that a step is solved by iteration.
    """

    rate: Callable[..., Any] | None = None
    constant: Callable[..., Any] | None = None
    body: Callable[..., Any] | None = None
    stage: Callable[..., Any] | None = None
    prepare: Callable[..., Any] | None = None
    enter: Callable[..., Any] | None = None
    leave: Callable[..., Any] | None = None
    iterates: bool = False


@dataclass(frozen=True, eq=False)
class Method:
    """The record of a method, from which tests, benchmarks, tables and advice are generated.

    Records are in :data:`fastatt.METHODS`. :func:`runge_kutta` and :func:`lie_group` make further
    ones.

    Parameters
    ----------
    name : str
        Name of the method.
    order : int
        Order, as tests measure it.
    scenes : tuple of str
        Kinds of scenes (``Scene.kind``) that the method accepts, "sampled rates" and "increments"
        for samples.
    rate_calls : int
        Evaluations of the rate or torque in a step.
    limits : mapping of str to float
        Largest ``|w| h``, rad, of a step whose error is at most 0.1 rad per radian of rotation, for
        rates that change no faster than the body rotates. Keys are families of representations,
        "body" and "torqued" for rigid bodies, "rates" and "increments" for samples. Beyond the
        limit the status is ``STEP_TOO_LARGE``. The ``measure`` says what is limited.
    source : str
        Author, year and equation.
    summary : str
        A line for tables.
    conserves : tuple of str
        Quantities that the method conserves.
    exponentials : int
        Exponentials in a step.
    body_calls : int
        Evaluations of the torque in a step of a body, if the method has others of a rate, which it
        evaluates once for each time; else 0.
    uses : tuple of str
        Formulas of a representation that the method needs.
    steps : Steps, optional
        The formulas; None for the closed form and for methods for samples.
    window : Window, optional
        The formulas of a method for samples.
    exact_for_constant : bool
        Whether the method is exact for a constant rate, with no limit of the step.
    orders : mapping of str to int
        Orders on kinds of scenes for which they differ from ``order``.
    stages : tuple of tuple of float
        (h, k, c) of each stage of a splitting method: its share of free motion, its share of the
        other flow, and the time of the other flow as a share of the step.
    reversible : tuple of str
        Kinds of scenes on which a step backwards reverses a step, to rounding.
    symplectic : bool
        Whether the step of a conservative system is symplectic.
    sorted_axes : bool
        Whether the principal moments must be in order.
    takes : Dependence
        How a torque may depend on w.
    measure : {"angle", "momentum", "asymmetry"}
        What ``limits`` hold for: "angle" ``|w| h``; "momentum" ``|m| h``/I_min; "asymmetry" ``|m|
        h`` √(``|1/I1 − 1/I2|`` ``|1/I3 − 1/I2|``) with the intermediate moment I2, and under a
        torque also ``|w| h``.
    damping_limit : float
        Largest c h/I of linear damping, to 0.2: the error of the factor exp(−c h/I) is at most 0.1,
        for splitting methods that of the angle 0.1 ``|w| h``.
    compensates : bool
        Whether ``compensated=True`` is accepted.
    couples : bool
        Whether velocity, position and states can be stepped together with the attitude, as scenes
        with mass or states need.
    within : bool
        Whether a step evaluates rates, torques and forces between its ends only, as scenes with
        breakpoints need.
    tried_on : tuple of str, optional
        Kinds of scenes for which advice tries the method if none is named; the default is all that
        it accepts. A method is left out where others were faster in all that was measured.

    Examples
    --------
    >>> import fastatt as fa
    >>> rk8 = fa.METHODS["rk8"]
    >>> rk8.order, rk8.couples
    (8, True)
    """

    name: str
    order: int
    scenes: tuple[str, ...]
    rate_calls: int
    limits: Mapping[str, float]
    source: str
    summary: str = ""
    conserves: tuple[str, ...] = ()
    exponentials: int = 0
    body_calls: int = 0
    #: formulas of a representation that the method needs
    uses: tuple[str, ...] = ("start",)
    #: None for the closed form and for methods for samples
    steps: Steps | None = field(default=None, repr=False)
    #: the formulas of a method for samples
    window: Any = field(default=None, repr=False)
    exact_for_constant: bool = False
    orders: Mapping[str, int] = field(default_factory=dict)
    #: (h, k, c) of each stage of a step: its shares of free motion and of the other flow, and the
    #: time of the other flow as a share of the step; empty for a method of one stage
    stages: tuple[tuple[float, float, float], ...] = field(default=(), repr=False)
    #: kinds of scenes on which a step backwards reverses a step, to rounding
    reversible: tuple[str, ...] = ()
    #: the step of a conservative system is a symplectic map
    symplectic: bool = False
    #: whether the intermediate principal axis must be the second
    sorted_axes: bool = False
    #: how a torque may depend on w
    takes: Dependence = Dependence.RATE
    #: the quantity that ``limits`` bound: "angle", "momentum" or "asymmetry"
    measure: str = "angle"
    #: largest c h/I of linear damping
    damping_limit: float = math.inf
    #: whether it can compensate rounding
    compensates: bool = False
    #: whether velocity, position and states can be stepped together with the attitude; the step of
    #: a body then serves rates with states too
    couples: bool = False
    #: whether a step evaluates rates, torques and forces between its ends only
    within: bool = True
    tried_on: tuple[str, ...] | None = None

    def __reduce_ex__(self, protocol: Any) -> Any:
        """Pickle the library's methods by name, since they contain nested functions."""
        listed = _listed(self.name) is self
        return (_listed, (self.name,)) if listed else super().__reduce_ex__(protocol)

    @property
    def is_stepped(self) -> bool:
        """Whether the method takes steps: False for the closed form and for methods for samples."""
        return self.steps is not None

    @property
    def is_exact(self) -> bool:
        """Whether the method is a closed form, with one evaluation for each time."""
        return self.steps is None and self.window is None

    @property
    def ahead(self) -> float:
        """By how much of a step the stepped variables of its stages are ahead."""
        return 0.5 * self.stages[-1][1] if self.stages else 0.0

    @property
    def iterates(self) -> bool:
        """Whether a step is implicit and solved by iteration."""
        return self.steps is not None and self.steps.iterates

    def evaluations(self, scene: str) -> int:
        """Evaluations of the right-hand side in a step on a kind of scene.

        Parameters
        ----------
        scene : str
            A kind of scene, ``Scene.kind``.

        Returns
        -------
        int
            The number; 0 for a closed form.
        """
        return self.rate_calls if scene == "rate" else self.body_calls or self.rate_calls

    def is_tried_on(self, scene: str) -> bool:
        """Whether advice tries the method on a kind of scene.

        Parameters
        ----------
        scene : str
            A kind of scene, ``Scene.kind``.

        Returns
        -------
        bool
            Whether it does.
        """
        return self.tried_on is None or scene in self.tried_on

    def order_of(self, scene: str) -> int:
        """Order on a kind of scene.

        Parameters
        ----------
        scene : str
            A kind of scene, ``Scene.kind``.

        Returns
        -------
        int
            The order.
        """
        return self.orders.get(scene, self.order)

    @property
    def representations(self) -> tuple[str, ...]:
        """Names of the library's representations that the method accepts."""
        return tuple(name for name in ATTITUDES if self.stores(name))

    def stores(self, representation: str) -> bool:
        """Whether the method accepts a representation.

        Parameters
        ----------
        representation : str
            Name of a representation.

        Returns
        -------
        bool
            Whether the representation has the formulas that the method needs; methods for samples
            accept quaternions only.
        """
        if self.window is not None:
            return representation == "quat"
        attitude = ATTITUDES[representation]
        return all(getattr(attitude, name) is not None for name in self.uses)

    def limit(self, representation: str, *, body: bool = False, torqued: bool = False) -> float:
        """Largest ``|w| h`` of a step in a representation.

        Parameters
        ----------
        representation : str
            Name of a representation, or a key of ``limits``.
        body : bool, default False
            Whether the scene has inertia.
        torqued : bool, default False
            Whether there is a torque.

        Returns
        -------
        float
            The limit, rad.
        """
        if torqued and TORQUED in self.limits:
            return self.limits[TORQUED]
        known = ATTITUDES.get(representation)
        key = representation if known is None else known.family
        least = min((x for name, x in self.limits.items() if name != TORQUED), default=math.inf)
        limit = self.limits.get(key, least)
        return min(limit, self.limits.get(BODY, math.inf)) if body else limit


def _listed(name: str) -> Method | None:
    """The library's method of a name, for unpickling."""
    from fastatt.methods import METHODS

    return METHODS.get(name)


def named(name: Any) -> str:
    """The name of a new method; raises ``TypeError`` or ``ValueError`` for anything else."""
    from fastatt.methods import METHODS

    if not isinstance(name, str) or not name:
        raise TypeError(f"name: found {checks.brief(name)}; accepted: a name")
    if name in METHODS:
        raise ValueError(f"name: found {name!r}, a method of the library; accepted: another name")
    return name
