"""Parts of estimators, for arrays and, as kernels, for jitted code.

Transitions, noise, Jacobians, derivatives of steps and runs, preintegration, and filters.

The error of an attitude is a rotation vector δθ in body axes, q_true = q∘exp(δθ). The error of a
gyro's bias is δb, b_true = b + δb.
"""

from fastatt.estimation import preintegration
from fastatt.estimation.covariance import (
    covariance_to_body,
    covariance_to_inertial,
    left_jacobian,
    left_jacobian_inverse,
    predict_covariance,
    process_noise,
    right_jacobian,
    right_jacobian_inverse,
    transition_matrix,
)
from fastatt.estimation.derivatives import body_tangent, sample_transitions, step_tangent
from fastatt.estimation.filters import attitude_error, mean_attitude
from fastatt.estimation.inertial_logs import preintegrate
from fastatt.estimation.mekf import MEKF
from fastatt.estimation.motions import gyro_motion, scene_motion
from fastatt.estimation.noise import simulate_gyro
from fastatt.estimation.run_derivatives import RunTangent, run_tangent
from fastatt.estimation.ukf import UKF
from fastatt.estimation.updates import (
    mekf_predict,
    mekf_update,
    mekf_update_attitude,
    mekf_update_vector,
)

__all__ = [
    "MEKF", "UKF", "RunTangent", "attitude_error", "body_tangent",
    "covariance_to_body", "covariance_to_inertial", "gyro_motion", "left_jacobian",
    "left_jacobian_inverse", "mean_attitude", "mekf_predict", "mekf_update",
    "mekf_update_attitude", "mekf_update_vector", "predict_covariance", "preintegrate",
    "preintegration", "process_noise", "right_jacobian", "right_jacobian_inverse",
    "run_tangent", "sample_transitions", "scene_motion", "simulate_gyro", "step_tangent",
    "transition_matrix",
]  # fmt: skip
