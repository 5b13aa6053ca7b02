"""Orientation of rigid bodies, propagated fast and with known error.

Conventions
-----------
Quaternions are scalar first, Hamilton, unit: q = (q0, q1, q2, q3) maps body components to inertial
ones, v_i = q∘v_b∘q*. C is its matrix, v_i = C v_b; its rows are the inertial axes seen from the
body. The angular velocity w is the body's relative to the inertial frame, in body axes, rad/s:
q̇ = ½ q∘w, Ċ = C [w×]. A rate in inertial axes is marked ``frame="inertial"``: q̇ = ½ w∘q,
Ċ = [w×] C. Units are SI. One body is q (4,); an ensemble (N, 4); histories put time first,
(S, N, 4). 3-1-3 Euler angles (φ, θ, ψ) have
w = (φ̇ sinθ sinψ + θ̇ cosψ, φ̇ sinθ cosψ − θ̇ sinψ, φ̇ cosθ + ψ̇).
"""

from fastatt import estimation, exact, forces, interchange, kernels, rates, steps, torques
from fastatt.angular_velocity import angular_velocity
from fastatt.arrays import (
    angle_between,
    dcm_to_quat,
    euler313_to_quat,
    quat_multiply,
    quat_to_dcm,
    quat_to_euler313,
    quat_to_rotation_vector,
    rotate,
    rotate_inverse,
    rotation_vector_to_quat,
)
from fastatt.drift import Drift, drift
from fastatt.energy import (
    angular_momentum,
    kinetic_energy,
    kinetic_energy_symmetric,
    potential_energy,
)
from fastatt.integrate import integrate_rates
from fastatt.interchange import from_scipy, to_scipy
from fastatt.limits import StepWarning
from fastatt.methods import METHODS, Method
from fastatt.propagate import methods_for, propagate, propagate_directions
from fastatt.scene import Scene
from fastatt.self_check import OrderWarning, SelfCheck
from fastatt.steps import single_step
from fastatt.trade import (
    ErrorBudget,
    Recommendation,
    WorkPrecision,
    error_budget,
    recommend,
    self_check,
    work_precision,
)
from fastatt.trajectory import Status, Trajectory
from fastatt.watch import DriftStatistics, watch_drift

__version__ = "0.1.0"

__all__ = [
    "METHODS",
    "Drift",
    "DriftStatistics",
    "ErrorBudget",
    "Method",
    "OrderWarning",
    "Recommendation",
    "Scene",
    "SelfCheck",
    "Status",
    "StepWarning",
    "Trajectory",
    "WorkPrecision",
    "angle_between",
    "angular_momentum",
    "angular_velocity",
    "dcm_to_quat",
    "drift",
    "error_budget",
    "estimation",
    "euler313_to_quat",
    "exact",
    "forces",
    "from_scipy",
    "integrate_rates",
    "interchange",
    "kernels",
    "kinetic_energy",
    "kinetic_energy_symmetric",
    "methods_for",
    "potential_energy",
    "propagate",
    "propagate_directions",
    "quat_multiply",
    "quat_to_dcm",
    "quat_to_euler313",
    "quat_to_rotation_vector",
    "rates",
    "recommend",
    "rotate",
    "rotate_inverse",
    "rotation_vector_to_quat",
    "self_check",
    "single_step",
    "steps",
    "to_scipy",
    "torques",
    "watch_drift",
    "work_precision",
]
