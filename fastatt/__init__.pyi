from typing import Final

from fastatt import closed_form, estimation, kernels
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
from fastatt.estimation.single_steps import single_step
from fastatt.gyro import gyro_steps
from fastatt.gyro.integrate import integrate_rates
from fastatt.gyro.log import GyroLogError
from fastatt.gyro.read import read_gyro_log
from fastatt.gyro.streaming import GyroIntegrator
from fastatt.interchange.euler import euler_to_quat, quat_to_euler
from fastatt.invariants.drift import drift
from fastatt.invariants.energy import (
    angular_momentum,
    kinetic_energy,
)
from fastatt.methods import METHODS
from fastatt.methods.lie_group import lie_group
from fastatt.methods.runge_kutta import runge_kutta
from fastatt.propagation.directions import propagate_directions
from fastatt.propagation.event import event
from fastatt.propagation.inspect_step import inspect_step
from fastatt.propagation.interpolation import interpolate
from fastatt.propagation.output import to_file
from fastatt.propagation.propagate import plan, propagate
from fastatt.propagation.resume import resume
from fastatt.propagation.trajectory import Trajectory
from fastatt.rounding import StepWarning
from fastatt.scene import forces, rates, torques
from fastatt.scene.scene import Scene
from fastatt.scene.time_series import TimeSeries
from fastatt.trade.advice import recommend
from fastatt.trade.convergence import (
    ConvergenceWarning,
    check_convergence,
)
from fastatt.trade.per_body import per_body_steps
from fastatt.trade.work_precision import work_precision

__all__ = [
    "METHODS", "ConvergenceWarning", "GyroIntegrator", "GyroLogError", "Scene", "Status",
    "StepWarning", "TimeSeries", "Trajectory", "angle_between", "angular_momentum",
    "check_convergence", "closed_form", "dcm_to_quat", "drift", "estimation",
    "euler313_to_quat", "euler_to_quat", "event", "forces", "gyro_steps", "inspect_step",
    "integrate_rates", "interpolate", "kernels", "kinetic_energy", "lie_group", "mrp_to_quat",
    "per_body_steps", "plan", "propagate", "propagate_directions", "quat_multiply",
    "quat_rotate", "quat_rotate_inverse", "quat_to_dcm", "quat_to_euler", "quat_to_euler313",
    "quat_to_mrp", "quat_to_rotation_vector", "rates", "read_gyro_log", "recommend", "resume",
    "rotation_vector_to_quat", "runge_kutta", "single_step", "to_file", "torques",
    "work_precision",
]  # fmt: skip

__version__: Final[str]
