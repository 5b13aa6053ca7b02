"""Events: the time at which a user-defined function of a body's motion crosses zero."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fastatt import checks, rounding
from fastatt.engine.marks import MOST_CROSSINGS, Event
from fastatt.scene.models import Packing, names_in, parameters, readings, shown_in
from fastatt.scene.scene import Scene
from fastatt.tracing.signature import SIGNATURES
from fastatt.tracing.user import UserFunction

#: the role in ``SIGNATURES`` and whether it takes states, by the number of the function's arguments
_ROLES = {
    4: ("event", False),
    5: ("event", True),
    6: ("event at position", False),
    7: ("event at position", True),
}


def event(
    g: Callable[..., float],
    direction: int = 0,
    terminal: bool = False,
    reads: str | tuple[str, ...] = (),
    every: bool = False,
) -> Event:
    """Locate the first time at which a function of a body's motion crosses zero.

    The result is passed to ``fastatt.propagate(..., events=[...])``. ``Trajectory.event_times``
    holds the time for each body, as accurate as the method, and NaN where no crossing was found.
    The function is frozen when ``propagate`` or ``plan`` begins, with the values that it refers to.
    It is then followed, called or refused, as torques are.

    Parameters
    ----------
    g : callable
        ``g(t, q, w, p) -> float``, plain or jitted. Its arguments are the time, s, the unit
        quaternion, body to inertial, the angular velocity along body axes, rad/s, and the tuple of
        the scene's ``params``, which is empty if there are none. In a scene with states, ``g(t, q,
        w, s, p)`` takes all of them. If the position is propagated, ``g(t, q, w, v, r, p)`` and
        ``g(t, q, w, v, r, s, p)`` are accepted too, with the velocity along body axes, m/s, and the
        position along inertial axes, m. The number of arguments, 4 to 7, tells them apart. The
        sign of the quaternion is continuous in the representation "quat" only.
    direction : {0, 1, -1}, default 0
        1 counts only crossings from negative to positive, in the order of the steps; -1 counts only
        those from positive to negative, and 0 counts both. A function that stays at zero for a
        while, such as ``max(0, w[0] - 0.3)``, crosses where it reaches zero and where it leaves
        zero, each in its direction. A zero at the start of the run is no crossing, so that a run
        may begin at an event of another.
    terminal : bool, default False
        Whether the body stops at the event: all later saves hold its state at the event, its later
        events are not located, and its status does not change. The run continues for the other
        bodies.
    reads : str or tuple of str, default ()
        Names of terms of the torque, a :class:`fastatt.torques.Sum`, whose numbers g takes as
        tuples, one for each name, before s: ``g(t, q, w, wheels, p)``.
    every : bool, default False
        Whether all crossings are located, which ``Trajectory.crossings`` gives with their states.
        Of each body the first 10⁶ are kept; a RuntimeWarning tells of more. A run raises
        ``MemoryError`` before they fill the memory.

    Returns
    -------
    Event
        For the argument ``events`` of :func:`fastatt.propagate`.

    Raises
    ------
    TypeError
        If ``g`` is not a function, or ``terminal`` is not True or False.
    ValueError
        If ``direction`` is not -1, 0 or 1.

    Notes
    -----
    A crossing is found if g has different signs at the two ends of a step. If g has the same sign
    at both ends but approaches zero in between, the library searches for its extremum within the
    step, so that two crossings in one step are found too. They can be missed if g does not resemble
    a parabola within the step, for example at a kink. Of three crossings in one step any one may be
    found. Where g is not finite there is no crossing; a RuntimeWarning tells of an event that was
    not located for a body where that was so.

    Examples
    --------
    The time at which the third axis of a coning body comes down to a height of 0.9:

    >>> import fastatt as fa
    >>> def height(t, q, w, p):
    ...     return 1.0 - 2.0 * (q[1] * q[1] + q[2] * q[2]) - 0.9
    >>> body = fa.Scene(inertia=(1.0, 1.0, 2.0))
    >>> run = fa.propagate(
    ...     body, [1, 0, 0, 0], [0.5, 0, 1], dt=0.1, n_steps=100, method="rk8",
    ...     events=[fa.event(height, direction=-1)],
    ... )
    >>> run.event_times.round(6)
    array([1.138071])
    """
    checks.function("g", g, "a function g(t, q, w, p)")
    way = checks.any_real("direction", direction, "-1, 0, 1")
    if way not in (-1.0, 0.0, 1.0):
        raise ValueError(f"direction: found {checks.brief(direction)}; accepted: -1, 0, 1")
    stops, each = checks.flag("terminal", terminal), checks.flag("every", every)
    return Event(g, int(way), stops, names_in("reads", reads), each)


#: what was found, and what is accepted, in the order of ``warn_of_events``
_TOLD = (
    ("values that are not finite, and no crossing,", "a function that is finite during the run"),
    (
        f"more than {MOST_CROSSINGS} crossings, of which the first are kept,",
        "a shorter run, which resume continues, or an event without every=True",
    ),
)


def warn_of_events(told: NDArray[np.bool_], events: int, switches: Sequence[str]) -> None:
    """Warn of events, then switches (2, N, E), that are lost, or have too many crossings."""
    for (what, accepted), which in zip(_TOLD, told, strict=True):
        for i in np.flatnonzero(which.any(axis=0)).tolist():
            bodies = np.flatnonzero(which[:, i])
            name = f"events[{i}]" if i < events else f"Switch {switches[i - events]!r}"
            rounding.warn(
                f"{name}: found {what} for {bodies.size} of {len(which)} bodies, the first of them "
                f"body {bodies[0]}; accepted: {accepted}",
                RuntimeWarning,
            )


def events_of(
    events: Event | Sequence[Event], scene: Scene, *, position: bool
) -> tuple[Event, ...]:
    """The events of a run of a scene as a tuple, frozen; ``position`` is propagated.

    Raises ``TypeError`` for anything else, and for functions that do not fit the scene.
    """
    listed = (events,) if isinstance(events, Event) else events
    if not isinstance(listed, (list, tuple)) or not all(isinstance(x, Event) for x in listed):
        raise TypeError(f"events: found {checks.brief(events)}; accepted: a list of fastatt.event")
    return tuple(_frozen(x, scene, position or scene.needs_position) for x in listed)


def _frozen(event: Event, scene: Scene, position: bool) -> Event:
    """The event with its function as it is now, for the parameters of a scene.

    Raises ``TypeError`` and ``ValueError`` for a function that does not fit the scene.
    """
    function = event.function
    if not isinstance(function, UserFunction):
        function = UserFunction(function)
    packing = Packing(None, "event", {}, shown=shown_in(scene.torque))
    reads = readings(event.reads, packing)
    signatures = {name: SIGNATURES[name].with_reads(reads) for name, _ in _ROLES.values()}
    arguments = len(function.required) - len(reads)
    if arguments not in _ROLES:
        accepted = ", ".join(signatures[name].with_states(n).call for name, n in _ROLES.values())
        raise TypeError(f"event: found {function.called_as}; accepted: {accepted}")
    role, is_of_states = _ROLES[arguments]
    call = signatures[role].with_states(is_of_states).call
    if role == "event at position" and not position:
        raise ValueError(
            f"event: found {call}, but no position is carried; accepted: with r0, in a scene "
            "with mass"
        )
    if is_of_states and not scene.states:
        raise ValueError(
            f"event: found {call}, but the scene has no states; accepted: {signatures[role].call}, "
            "or a scene with states"
        )
    params, states = parameters("params", scene.params), scene.states if is_of_states else 0
    function = function.of(role, params.shape[-1], params, states, reads=reads)
    return replace(event, function=function, source=event.source or event)
