"""Orientation of rigid bodies, propagated fast and with known error.

Conventions
-----------
Quaternions are scalar first, Hamilton, unit: q = (q0, q1, q2, q3) maps body components to inertial
ones, v_i = q∘v_b∘q*. C is its matrix, v_i = C v_b; its rows are the inertial axes in body
components. The angular velocity w of the body relative to the inertial frame is along body axes,
rad/s: q̇ = ½ q∘w, Ċ = C [w×]. A rate along inertial axes is marked ``frame="inertial"``:
q̇ = ½ w∘q, Ċ = [w×] C. Units are SI. One body is q (4,); an ensemble (N, 4); histories put time
first, (S, N, 4). 3-1-3 Euler angles (φ, θ, ψ) have
w = (φ̇ sinθ sinψ + θ̇ cosψ, φ̇ sinθ cosψ − θ̇ sinψ, φ̇ cosθ + ψ̇).
"""

from __future__ import annotations

import importlib
import importlib.util
from typing import Any

__version__ = "0.1.0"

#: the module of each public name, which is imported when the name is first used, so that a process
#: loads only what it needs; type checkers read ``__init__.pyi``
_MODULES = {
    "Scene": "fastatt.scene.scene",
    "rates": "fastatt.scene",
    "torques": "fastatt.scene",
    "forces": "fastatt.scene",
    "propagate": "fastatt.propagation.propagate",
    "plan": "fastatt.propagation.propagate",
    "resume": "fastatt.propagation.resume",
    "event": "fastatt.propagation.event",
    "to_file": "fastatt.propagation.output",
    "TimeSeries": "fastatt.scene.time_series",
    "METHODS": "fastatt.methods",
    "runge_kutta": "fastatt.methods.runge_kutta",
    "lie_group": "fastatt.methods.lie_group",
    "Trajectory": "fastatt.propagation.trajectory",
    "Status": "fastatt.engine.status",
    "StepWarning": "fastatt.rounding",
    "drift": "fastatt.invariants.drift",
    "interpolate": "fastatt.propagation.interpolation",
    "closed_form": "fastatt",
    "estimation": "fastatt",
    "kernels": "fastatt",
    "propagate_directions": "fastatt.propagation.directions",
    "recommend": "fastatt.trade.advice",
    "work_precision": "fastatt.trade.work_precision",
    "check_convergence": "fastatt.trade.convergence",
    "ConvergenceWarning": "fastatt.trade.convergence",
    "per_body_steps": "fastatt.trade.per_body",
    "inspect_step": "fastatt.propagation.inspect_step",
    "integrate_rates": "fastatt.gyro.integrate",
    "GyroIntegrator": "fastatt.gyro.streaming",
    "gyro_steps": "fastatt.gyro",
    "read_gyro_log": "fastatt.gyro.read",
    "GyroLogError": "fastatt.gyro.log",
    "single_step": "fastatt.estimation.single_steps",
    "angle_between": "fastatt.arrays",
    "quat_multiply": "fastatt.arrays",
    "quat_rotate": "fastatt.arrays",
    "quat_rotate_inverse": "fastatt.arrays",
    "quat_to_dcm": "fastatt.arrays",
    "dcm_to_quat": "fastatt.arrays",
    "quat_to_mrp": "fastatt.arrays",
    "mrp_to_quat": "fastatt.arrays",
    "quat_to_euler313": "fastatt.arrays",
    "euler313_to_quat": "fastatt.arrays",
    "quat_to_rotation_vector": "fastatt.arrays",
    "rotation_vector_to_quat": "fastatt.arrays",
    "quat_to_euler": "fastatt.interchange.euler",
    "euler_to_quat": "fastatt.interchange.euler",
    "kinetic_energy": "fastatt.invariants.energy",
    "angular_momentum": "fastatt.invariants.energy",
}
__all__ = list(_MODULES)


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module 'fastatt' has no attribute {name!r}{_place_of(name)}")
    module = importlib.import_module(_MODULES[name])
    value = vars(module).get(name) or importlib.import_module(f"{module.__name__}.{name}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return __all__


def _place_of(name: str) -> str:
    """The end of a message: where a name is, or the most similar one."""
    from fastatt.checks import nearest

    if importlib.util.find_spec(f"fastatt.{name}"):
        return f" (a module: import fastatt.{name})"
    for place in ("kernels", "interchange", "estimation"):
        if name in importlib.import_module(f"fastatt.{place}").__all__:
            return f" (in fastatt.{place}: {name})"
    return nearest(name, __all__)
