"""The choice of method and representation for a scene."""

from __future__ import annotations

from fastatt import checks
from fastatt.attitudes import ATTITUDES, COMPENSATED, QUATERNION, Attitude
from fastatt.closed_form import form_of
from fastatt.methods import METHODS, Method
from fastatt.propagation.breakpoints import corners_of
from fastatt.propagation.event import Event
from fastatt.propagation.options import Choice
from fastatt.scene.scene import Scene, as_scene
from fastatt.scene.torque_record import Dependence

# the default is the first of these that fits the scene and the representation: those first in most
# cells at 1e-3 and 1e-6 rad of bench/LEADERBOARD.md (bench/choose.py)
DEFAULTS = ("magnus6", "exact", "rk8", "rk4")
# names of explicit Runge-Kutta methods in other libraries
_ELSEWHERE = ("rk45", "rk23", "dop853", "dopri5", "dopri8", "ode45", "rkf45", "tsit5", "lsoda")
# steps between two projections of a compensated state
_PROJECTED = 64


def methods_for(scene: Scene, representation: str | None = None, *, need: str = "") -> list[str]:
    """Names of the methods that fit a scene and a representation.

    Parameters
    ----------
    scene : Scene
        The scene.
    representation : str, optional
        A representation, such as "quat" or "dcm". The default lists methods for any representation.
    need : str, optional
        Name of a property of :class:`Method` that must be true, such as "is_stepped".

    Returns
    -------
    list of str
        Names in :data:`fastatt.METHODS`.

    Raises
    ------
    TypeError
        If ``scene`` is not a scene.
    ValueError
        If the representation or the property is unknown.

    Examples
    --------
    >>> import fastatt as fa
    >>> "magnus4" in fa.methods_for(fa.Scene(rate=fa.rates.Constant((0.1, 0.2, 0.3))))
    True
    """
    as_scene(scene)
    properties = [name for name, found in vars(Method).items() if isinstance(found, property)]
    checks.choice("need", need, ["", *properties])
    if representation is not None:
        attitude_of(representation)
    return [
        m.name
        for m in METHODS.values()
        if fits(m, scene, representation) and (not need or getattr(m, need))
    ]


def fits(method: Method, scene: Scene, representation: str | None = None) -> bool:
    """Whether a method fits a scene in a representation."""
    takes_kind = scene.kind in method.scenes or (scene.states > 0 and method.couples)
    return (
        takes_kind
        and (representation is None or method.stores(representation))
        and (scene.kind != "torqued" or _takes(method, scene))
        and (method.couples or not scene.is_coupled)
    )


def _takes(method: Method, scene: Scene) -> bool:
    if method.is_exact:
        try:
            return bool(form_of(scene))
        except ValueError:
            return False
    if method.takes is Dependence.RATE:
        return True
    return scene.dependence(sorted_axes=method.sorted_axes) <= method.takes


def attitude_of(representation: str) -> Attitude:
    """The representation of a name."""
    return ATTITUDES[checks.choice("representation", representation, ATTITUDES)]


def method_of(
    scene: Scene,
    method: str | Method | None,
    representation: str,
    *,
    need: str = "",
    why: str = "method",
) -> Method:
    """The method of a name, or a custom method, that fits a scene in a representation.

    None gives the first of magnus6, exact, rk8 and rk4 that fits, or else the first of all methods.
    ``need`` is that of ``methods_for``, and ``why`` the argument that the message names.

    Raises ``ValueError`` for a method that does not fit, with those that do, and if none fits.
    """
    attitude_of(representation)  # raises for an unknown name
    if isinstance(method, Method):
        if not fits(method, scene, representation):
            able = ", ".join(methods_for(scene, representation, need=need))
            raise ValueError(
                f"method: found {method.name}, for {', '.join(method.scenes)} in "
                f"{', '.join(method.representations)}; accepted for this scene ({scene.kind}) in "
                f'"{representation}": {able}'
            )
        if not method.within and (scene.sampling is not None or corners_of(scene).size):
            raise ValueError(
                f"method: found {method.name}, whose steps evaluate times outside of them, for a "
                "scene with breakpoints or samples; accepted: nodes from 0 to 1"
            )
        found = method
    else:
        found = METHODS[_named(scene, method, representation, need)]
    if need and not getattr(found, need):
        checks.choice(why, found.name, methods_for(scene, representation, need=need))
    return found


def _named(scene: Scene, method: str | None, representation: str, need: str) -> str:
    """The given name if its method fits, or the name of the default method."""
    # users may pass anything, also what has no hash
    known = METHODS.get(method) if isinstance(method, str) else None
    if known is not None and fits(known, scene, representation):
        return known.name
    if known is not None and known.is_exact and scene.kind == "torqued":
        form_of(scene)  # raises, with the reason
    if method is not None:
        name, able = "method", methods_for(scene, need=need)
        if known is not None and known.name in able:
            name = f'method for representation "{representation}"'
            able = methods_for(scene, representation, need=need)
        if known is None:
            elsewhere = str(method).casefold() in _ELSEWHERE
            reason = " (nearest: rk8)" if elsewhere else checks.nearest(method, able)
        else:
            reason = _reason(known, scene)
        accepted = ", ".join(able)
        raise ValueError(f"{name}: found {checks.brief(method)}; accepted: {accepted}{reason}")
    fitting = methods_for(scene, representation, need=need)
    if not fitting:
        raise ValueError(
            f"representation: found {representation}, for which no method takes this "
            f"scene ({scene.kind}); accepted: {', '.join(ATTITUDES)}"
        )
    return next((name for name in DEFAULTS if name in fitting), fitting[0])


def _reason(method: Method, scene: Scene) -> str:
    """The reason why a method does not fit a scene, as the end of a message; empty if it fits."""
    found = "a rate" if scene.kind == "rate" else "inertia"
    if method.window is not None:
        return f" ({method.name} is for samples: fastatt.integrate_rates)"
    if scene.kind not in method.scenes and (scene.kind == "rate" or "rate" in method.scenes):
        needed = "inertia" if scene.kind == "rate" else "a rate"
        return f" ({method.name} needs {needed}; this scene has {found})"
    if scene.kind not in method.scenes:
        return f" ({method.name} is for {', '.join(method.scenes)} bodies; this is {scene.kind})"
    if scene.is_coupled and not method.couples:
        what, found = ("velocity", "mass") if scene.moves else ("states", "states")
        return f" ({method.name} steps no {what}; this scene has {found})"
    if scene.kind == "torqued" and not _takes(method, scene):
        return (
            f" ({method.name} needs a torque that does not depend on w, but for linear damping "
            "along principal axes; of a function that does not, fa.torques.Custom(function, "
            "uses_rate=False) says so)"
        )
    return ""


def chosen(
    scene: Scene,
    method: str | Method | None,
    representation: str,
    compensated: bool = False,
    normalise: str | int = "output",
    events: tuple[Event, ...] = (),
) -> Choice:
    """How a scene is propagated, from the arguments of ``propagate``.

    Raises ``ValueError`` and ``TypeError`` as ``propagate`` does.
    """
    compensated = checks.flag("compensated", compensated)
    key = ("choice", method, representation, compensated, normalise)
    of_names = {type(method), type(representation), type(normalise)} <= {str, type(None)}
    is_kept = of_names and not events
    # in one go: another thread may put it out
    known: Choice | None = scene.memo.get(key) if is_kept else None
    if known is not None:
        return known
    attitude = attitude_of(representation)
    need, why = "", "method"
    if events:
        need, why = "is_stepped", "method with events"
    if compensated and method is None:
        need = "is_stepped"
    record = method_of(scene, method, representation, need=need, why=why)
    projection = _projection(normalise)
    if compensated:
        if attitude is not QUATERNION:
            raise ValueError(
                f'compensated: found with representation "{attitude.name}"; accepted with "quat"'
            )
        if not record.compensates:
            able = ", ".join(m.name for m in METHODS.values() if m.compensates)
            raise ValueError(f"compensated: found with method {record.name}; accepted with {able}")
        attitude, projection = COMPENSATED, _PROJECTED if normalise == "output" else projection
    found = Choice(record, attitude, projection, normalise == "never", events)
    if is_kept:
        scene.memo[key] = found
    return found


def _projection(normalise: str | int) -> int:
    """The number of steps between two projections, 0 for none."""
    if isinstance(normalise, str) and normalise in ("output", "never"):
        return 0
    try:
        return checks.whole("normalise", normalise, 1)
    except (TypeError, ValueError) as error:
        kind = ValueError if isinstance(normalise, str) else type(error)
        raise kind(
            f"normalise: found {checks.brief(normalise)}; accepted: output, never, or a whole "
            "number of steps from 1 on"
        ) from None
