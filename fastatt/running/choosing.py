"""Which method, in which representation: what fits a scene, and what was asked for."""

from __future__ import annotations

from typing import Any

from fastatt import checks
from fastatt.attitudes import ATTITUDES, COMPENSATED, QUATERNION, Attitude
from fastatt.closed_forms import form_of
from fastatt.device import Device
from fastatt.methods import METHODS, Method
from fastatt.running.asked import Choice
from fastatt.running.reducer import Reducer
from fastatt.scene import Scene, as_scene
from fastatt.torques import Dependence

# in this order, the first that fits the scene and the representation
DEFAULTS = ("magnus4", "exact", "rk8", "rk4")
# steps between two looks at the norm of a compensated state
_RESTORE = 64


def methods_for(scene: Scene, representation: str | Attitude | None = None) -> list[str]:
    """Names of the methods that fit a scene and a representation, by name or one's own.

    Raises ``TypeError`` for what is no scene, ``ValueError`` for what is no representation.
    """
    as_scene(scene)
    if representation is not None:
        representation = attitude_of(representation)
    return [m.name for m in METHODS.values() if fits(m, scene, representation)]


def default_method(scene: Scene, representation: str | Attitude, *, steps: bool = False) -> str:
    """The first of magnus4, exact, rk8 and rk4 that fits, else of all; with ``steps`` not exact.

    Raises ``ValueError`` where none does.
    """
    key = "default", steps, _known_as(attitude_of(representation))
    if key in scene.memo:
        return str(scene.memo[key])
    fitting = methods_for(scene, representation)
    if not fitting:
        raise ValueError(
            f"representation: found {_name_of(representation)}, for which no method takes this "
            f"scene ({scene.kind}); accepted: {', '.join(ATTITUDES)}"
        )
    if steps:
        fitting = [name for name in fitting if not METHODS[name].is_exact]
    found = scene.memo[key] = next((name for name in DEFAULTS if name in fitting), fitting[0])
    return found


def fits(method: Method, scene: Scene, representation: str | Attitude | None = None) -> bool:
    """Whether a method takes a scene, in a representation, by name or one's own."""
    if isinstance(representation, Attitude):
        representation = _known_as(representation)
    return (
        scene.kind in method.scenes
        and (representation is None or method.stores(representation))
        and (scene.kind != "torqued" or _takes(method, scene))
        and (method.translates or not scene.moves)
        and (method.couples or not scene.couples)
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


def attitude_of(representation: str | Attitude) -> Attitude:
    """The representation of a name, or one's own."""
    if isinstance(representation, Attitude):
        return representation
    return ATTITUDES[checks.choice("representation", representation, ATTITUDES)]


def _known_as(attitude: Attitude) -> str | Attitude:
    """The name of a representation of the library's; one's own itself."""
    return attitude.name if ATTITUDES.get(attitude.name) is attitude else attitude


def _name_of(representation: str | Attitude) -> str:
    return representation if isinstance(representation, str) else representation.name


def method_of(scene: Scene, method: str | Method, representation: str | Attitude) -> Method:
    """The method of a name, or one's own, that fits a scene in a representation.

    Raises ``ValueError`` for one that does not, with those that do.
    """
    if isinstance(method, Method):
        if fits(method, scene, representation):
            return method
        raise ValueError(
            f"method: found {method.name}, for {', '.join(method.scenes)} in "
            f"{', '.join(method.representations)}; accepted for this scene ({scene.kind}) in "
            f'"{_name_of(representation)}": {", ".join(methods_for(scene, representation))}'
        )
    # anything may come, and a list has no hash
    found = METHODS.get(method) if isinstance(method, str) else None  # type: ignore[redundant-expr]
    if found is not None and fits(found, scene, representation):
        return found
    if found is not None and found.is_exact and scene.kind == "torqued":
        form_of(scene)  # says why there is none
    checks.choice("method", method, methods_for(scene))
    checks.choice(
        f'method for representation "{_name_of(representation)}"',
        method,
        methods_for(scene, representation),
    )
    return METHODS[method]


def chosen(
    scene: Scene,
    method: str | Method | None,
    representation: str | Attitude,
    compensated: bool,
    normalise: str | int,
    looks: bool = True,
    reducer: Reducer | None = None,
    device: Device | None = None,
) -> Choice:
    """How a scene is propagated, from what a user asks for.

    Raises ``ValueError`` and ``TypeError`` as ``propagate`` does.
    """
    key = ("choice", method, representation, compensated, normalise, looks)
    of_names = type(method) is type(representation) is str and type(normalise) is str
    if of_names and reducer is None and device is None and key in scene.memo:
        return scene.memo[key]  # type: ignore[no-any-return]
    attitude = attitude_of(representation)
    steps = device is not None
    record = _method(scene, method, attitude, reducer, steps=steps or compensated)
    if steps and record.is_exact:
        raise ValueError(f'method: found {record.name}; accepted with device "cuda": steps')
    if compensated:
        attitude = _compensated(record, attitude)
    restore = _RESTORE if compensated and normalise == "output" else _restore(normalise)
    found = Choice(record, attitude, restore, normalise == "never", looks, reducer, device)
    if of_names and reducer is None and device is None:
        scene.memo[key] = found
    return found


def _method(
    scene: Scene, method: str | Method | None, attitude: Attitude, reducer: Any, *, steps: bool
) -> Method:
    """The method asked for, or the first that fits."""
    if reducer is None:
        return method_of(scene, method or default_method(scene, attitude, steps=steps), attitude)
    if not isinstance(reducer, Reducer):
        raise TypeError(f"reduce: found {checks.brief(reducer)}; accepted: a fastatt.reducer")
    able = [name for name in methods_for(scene, attitude) if METHODS[name].translates]
    first = next((name for name in DEFAULTS if name in able), None)
    record = method_of(scene, method or first or default_method(scene, attitude), attitude)
    if not record.translates:
        raise ValueError(
            f"reduce: found with method {record.name}; accepted with {', '.join(able)}"
        )
    return record


def _compensated(method: Method, attitude: Attitude) -> Attitude:
    if attitude is not QUATERNION:
        raise ValueError(
            f'compensated: found with representation "{attitude.name}"; accepted with "quat"'
        )
    if not method.compensates:
        able = ", ".join(m.name for m in METHODS.values() if m.compensates)
        raise ValueError(f"compensated: found with method {method.name}; accepted with {able}")
    return COMPENSATED


def _restore(normalise: str | int) -> int:
    """Steps between two returns to the group, 0 for none."""
    if isinstance(normalise, str):
        checks.choice("normalise", normalise, ("output", "never"))
        return 0
    return checks.whole("normalise", normalise, 1)
