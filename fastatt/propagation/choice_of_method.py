"""The choice of method and representation for a scene."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial

from fastatt import checks, rounding
from fastatt.attitudes import ATTITUDES, COMPENSATED, QUATERNION, Attitude
from fastatt.engine.marks import Event
from fastatt.methods import METHODS, Method
from fastatt.propagation.breakpoints import corners_of
from fastatt.propagation.schedule import refuse_pairs
from fastatt.scene.scene import Scene
from fastatt.scene.torque_record import Dependence
from fastatt.tracing.user import UserFunction

# the default is the first of these that fits the scene and the representation: those first in most
# cells at 1e-3 and 1e-6 rad of bench/LEADERBOARD.md (bench/page_figures.py)
DEFAULTS = ("magnus6", "exact", "rk8", "rk4")
# names of explicit Runge-Kutta methods in other libraries
_ELSEWHERE = ("rk45", "rk23", "dop853", "dopri5", "dopri8", "ode45", "rkf45", "tsit5", "lsoda")
# steps between two projections of a compensated state
_PROJECTED = 64


@dataclass(frozen=True)
class Choice:
    """How a scene is propagated: its method, representation, and projection.

    The state is projected every ``projection`` steps (never if that is 0), and for output unless
    ``raw``.
    """

    method: Method
    attitude: Attitude
    projection: int = 0
    raw: bool = False
    events: tuple[Event, ...] = ()


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
    attitude = attitude_of(representation)
    refuse_pairs({"compensated": compensated, "representation": attitude is not QUATERNION})
    why = "method with events" if events else "method"
    record = method_of(scene, method, representation, stepped=bool(events), why=why)
    if events and method is None and method_of(scene, None, representation).is_exact:
        rounding.warn(
            f"method: found none with events, which the closed form does not locate; accepted: "
            f'method="{record.name}", which is taken and steps by dt',
            RuntimeWarning,
        )
    _refuse_odd([event.function for event in events], representation)
    projection = _projection(normalise)
    if compensated and not record.is_exact:  # a closed form adds up no rounding
        if not record.compensates:
            able = ", ".join(m.name for m in METHODS.values() if m.compensates)
            raise ValueError(f"compensated: found with method {record.name}; accepted with {able}")
        attitude, projection = COMPENSATED, _PROJECTED if normalise == "output" else projection
    return Choice(record, attitude, projection, normalise == "never", events)


def attitude_of(representation: str) -> Attitude:
    """The representation of a name."""
    return ATTITUDES[checks.choice("representation", representation, ATTITUDES)]


def method_of(
    scene: Scene,
    method: str | Method | None,
    representation: str,
    *,
    stepped: bool = False,
    why: str = "method",
) -> Method:
    """The method of a name, or a user-defined method, that fits a scene in a representation.

    None gives the first of magnus6, exact, rk8 and rk4 that fits, or else the first of all methods.
    ``stepped`` is that of ``methods_for``, and ``why`` the argument that the message names.

    Raises ``ValueError`` for a method that does not fit, with those that do, and if none fits.
    """
    attitude_of(representation)  # raises for an unknown name
    _refuse_odd(scene.functions, representation)
    if scene.reads_sign and representation != QUATERNION.name:
        raise ValueError(
            f"representation: found {representation} with a QuaternionPD(divides=True), which "
            'depends on the sign of q; accepted: "quat", or divides=False'
        )
    # a list of methods loads all of them
    able = partial(methods_for, scene, stepped=stepped)
    if method is None:
        names = able(representation)
        if not names:
            raise ValueError(
                f"representation: found {representation}, for which no method takes this "
                f"scene ({scene.kind}); accepted: {', '.join(ATTITUDES)}"
            )
        return METHODS[next((name for name in DEFAULTS if name in names), names[0])]
    # users may pass anything, also what has no hash
    record = METHODS.get(method) if isinstance(method, str) else method
    if not isinstance(record, Method):
        elsewhere = str(method).casefold() in _ELSEWHERE
        reason = " (nearest: rk8)" if elsewhere else checks.nearest(method, able())
        raise _refused("method", method, able(), reason)
    if not fits(record, scene, representation):
        if record.is_exact and scene.kind == "torqued":
            from fastatt.closed_form import solution_of

            solution_of(scene)  # raises, with the reason
        if fits(record, scene):
            where = f'method for representation "{representation}"'
            raise _refused(where, record.name, able(representation))
        raise _refused("method", record.name, able(), _reason(record, scene))
    if not record.within and (scene.samplings or scene.switches or corners_of(scene).size):
        raise ValueError(
            f"method: found {record.name}, whose steps evaluate times outside of them, for a "
            "scene with breakpoints, samples or switches; accepted: nodes from 0 to 1"
        )
    if stepped and not record.is_stepped:
        raise _refused(why, record.name, able(representation))
    return record


def methods_for(
    scene: Scene, representation: str | None = None, *, stepped: bool = False
) -> list[str]:
    """Names of the methods that fit a scene; with ``stepped`` only of those that take steps."""
    return [
        m.name
        for m in METHODS.values()
        if fits(m, scene, representation) and (m.is_stepped or not stepped)
    ]


def fits(method: Method, scene: Scene, representation: str | None = None) -> bool:
    """Whether a method fits a scene in a representation."""
    takes_scene = scene.kind in method.scenes or (scene.states > 0 and method.couples)
    return (
        takes_scene
        and (representation is None or method.stores(representation))
        and not odd_functions(scene.functions, representation or QUATERNION.name)
        and (scene.kind != "torqued" or _takes(method, scene))
        and (method.couples or not scene.is_coupled)
    )


def odd_functions(functions: Sequence[UserFunction], representation: str) -> list[UserFunction]:
    """Those that differ for q and −q, unless the representation keeps the sign continuous."""
    return [] if representation == QUATERNION.name else [f for f in functions if not f.is_even]


def _projection(normalise: str | int) -> int:
    """The number of steps between two projections, 0 for none."""
    if isinstance(normalise, str) and normalise in ("output", "never"):
        return 0
    try:
        return checks.whole("normalise", normalise, 1)
    except (TypeError, ValueError) as error:
        error_class = ValueError if isinstance(normalise, str) else type(error)
        raise error_class(
            f"normalise: found {checks.brief(normalise)}; accepted: output, never, or a whole "
            "number of steps from 1 on"
        ) from None


def _takes(method: Method, scene: Scene) -> bool:
    if method.is_exact:
        from fastatt.closed_form import solution_of

        with suppress(ValueError):
            return bool(solution_of(scene))
        return False
    if method.takes is Dependence.RATE:
        return True
    return scene.dependence(sorted_axes=method.sorted_axes) <= method.takes


def _refuse_odd(functions: Sequence[UserFunction], representation: str) -> None:
    for function in odd_functions(functions, representation):
        raise ValueError(
            f"representation: found {representation} with {function.described}, which differs for "
            'q and −q, the same attitude; accepted: "quat", where the sign of q is continuous, or '
            "a function that does not depend on it, such as one of q[0] * q[1]"
        )


def _refused(name: str, value: object, accepted: list[str], reason: str = "") -> ValueError:
    listed = ", ".join(accepted)
    return ValueError(f"{name}: found {checks.brief(value)}; accepted: {listed}{reason}")


def _reason(method: Method, scene: Scene) -> str:
    """The reason why a method does not fit a scene, as the end of a message; empty if it fits."""
    is_rate = scene.kind == "rate"
    if method.window is not None:
        return f" ({method.name} is for samples: fastatt.integrate_rates)"
    if scene.kind not in method.scenes and (is_rate or "rate" in method.scenes):
        needed, has = ("inertia", "a rate") if is_rate else ("a rate", "inertia")
        return f" ({method.name} needs {needed}; this scene has {has})"
    if scene.kind not in method.scenes:
        return f" ({method.name} is for {', '.join(method.scenes)} bodies; this is {scene.kind})"
    if scene.is_coupled and not method.couples:
        what, has = ("velocity", "mass") if scene.moves else ("states", "states")
        return f" ({method.name} steps no {what}; this scene has {has})"
    if scene.kind == "torqued" and not _takes(method, scene):
        return (
            f" ({method.name} needs a torque that does not depend on w, but for linear damping "
            "along principal axes; of a function that does not, fa.torques.Custom(function, "
            "uses_rate=False) says so)"
        )
    return ""
