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

import functools
import importlib
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

__all__ = [
    "METHODS", "ConvergenceCheck", "ConvergenceWarning", "Drift",
    "Event", "GyroIntegrator", "GyroLog", "GyroLogError", "GyroLogWarning", "Method",
    "PerBodySteps", "Plan", "Recommendation", "Scene", "Status", "StepWarning",
    "TimeSeries", "Trajectory", "WorkPrecision", "angle_between", "angular_momentum",
    "angular_velocity", "check_convergence", "closed_form", "dcm_to_quat", "drift",
    "estimation", "euler313_to_quat", "euler_to_quat", "event",
    "forces", "from_scipy", "gyro_steps", "inspect_step", "integrate_rates", "interchange",
    "interpolate", "kernels", "kinetic_energy", "lie_group", "mean_attitude",
    "methods_for", "mrp_to_quat", "per_body_steps", "plan", "plots", "potential_energy",
    "propagate", "propagate_directions", "quat_multiply", "quat_rotate", "quat_rotate_inverse",
    "quat_to_dcm", "quat_to_euler", "quat_to_euler313", "quat_to_mrp", "quat_to_rotation_vector",
    "rates", "read_gyro_log", "recommend", "resume", "rotation_vector_to_quat", "runge_kutta",
    "single_step", "to_file", "to_scipy", "torques", "work_precision",
]  # fmt: skip

# modules are imported when they are first used, so that a process loads only those it needs
if TYPE_CHECKING:
    from fastatt import closed_form, estimation, interchange, kernels, plots
    from fastatt.arrays import (
        angle_between,
        dcm_to_quat,
        euler313_to_quat,
        mrp_to_quat,
        quat_multiply,
        quat_rotate,
        quat_rotate_inverse,
        quat_to_dcm,
        quat_to_euler313,
        quat_to_mrp,
        quat_to_rotation_vector,
        rotation_vector_to_quat,
    )
    from fastatt.engine.status import Status
    from fastatt.estimation.filters import mean_attitude
    from fastatt.estimation.single_steps import single_step
    from fastatt.gyro import gyro_steps
    from fastatt.gyro.integrate import integrate_rates
    from fastatt.gyro.streaming import GyroIntegrator
    from fastatt.interchange import from_scipy, to_scipy
    from fastatt.interchange.euler import euler_to_quat, quat_to_euler
    from fastatt.logs import GyroLog, GyroLogError, GyroLogWarning, read_gyro_log
    from fastatt.methods import METHODS, Method
    from fastatt.methods.lie_group import lie_group
    from fastatt.methods.runge_kutta import runge_kutta
    from fastatt.propagation.angular_velocity import angular_velocity
    from fastatt.propagation.choice_of_method import methods_for
    from fastatt.propagation.directions import propagate_directions
    from fastatt.propagation.drift import Drift, drift
    from fastatt.propagation.energy import (
        angular_momentum,
        kinetic_energy,
        potential_energy,
    )
    from fastatt.propagation.event import Event, event
    from fastatt.propagation.histories import to_file
    from fastatt.propagation.inspect_step import inspect_step
    from fastatt.propagation.interpolation import interpolate
    from fastatt.propagation.plan import Plan
    from fastatt.propagation.propagate import plan, propagate
    from fastatt.propagation.resume import resume
    from fastatt.propagation.trajectory import Trajectory
    from fastatt.rounding import StepWarning
    from fastatt.scene import forces, rates, torques
    from fastatt.scene.scene import Scene
    from fastatt.scene.time_series import TimeSeries
    from fastatt.trade.advice import recommend
    from fastatt.trade.convergence import (
        ConvergenceCheck,
        ConvergenceWarning,
        check_convergence,
    )
    from fastatt.trade.per_body import PerBodySteps, per_body_steps
    from fastatt.trade.recommendation import Recommendation
    from fastatt.trade.work_precision import WorkPrecision, work_precision


@functools.cache
def _held_by() -> dict[str, str]:
    """The module of each name, as the imports above say, which a type checker alone runs."""
    import ast
    import inspect
    import sys

    lines = ast.walk(ast.parse(inspect.getsource(sys.modules[__name__])))
    found = [x for x in lines if isinstance(x, ast.ImportFrom) and x.module]
    return {name.name: line.module or "" for line in found for name in line.names}


def __getattr__(name: str) -> Any:
    if name not in __all__:
        of_kernels: list[str] = importlib.import_module("fastatt.kernels").__all__
        place = f" (in fastatt.kernels: {name})" if name in of_kernels else ""
        raise AttributeError(f"module 'fastatt' has no attribute {name!r}{place}")
    module = importlib.import_module(_held_by()[name])
    found = vars(module).get(name) or importlib.import_module(f"{module.__name__}.{name}")
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    return __all__
