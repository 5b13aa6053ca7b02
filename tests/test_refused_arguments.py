"""Each argument by itself replaced by what it is not: a result, or a refusal that names it."""

import re
from pathlib import Path

import numpy as np
import pytest

import fastatt as fa
from fastatt import estimation as es
from fastatt import interchange as ic
from fastatt.estimation import mean_attitude
from fastatt.interchange import to_scipy
from fastatt.interchange.aem import to_aem

Q, W, P = np.array([1.0, 0.0, 0.0, 0.0]), np.array([0.1, 0.2, 0.3]), 0.01 * np.eye(6)
BODY = fa.Scene(inertia=(2.0, 1.0, 0.7))
RUN = fa.propagate(BODY, Q, W, dt=0.1, n_steps=4, save_every=1, method="rk4")
HOSTILE = [
    None, True, -1, 10**400, np.nan, 1e300, 1j, "", "abc", b"x", {}, [[1, 2, 3], [4, 5]], ["a"],
    [1e200] * 3, np.array(1.0), np.empty((0, 3)), np.ones((2, 3, 4)),
    np.array([1, 2, 3], dtype="M8[s]"), np.ma.masked_array([1.0, 2.0, 3.0], [0, 1, 0]), object(),
    iter([1]), BODY,
]  # fmt: skip
CALLS = {
    "event": (fa.event, {"g": lambda t, q, w, p: t, "direction": 0, "terminal": False}),
    "mean_attitude": (mean_attitude, {"q": [Q, Q], "weights": [1.0, 1.0]}),
    "euler_to_quat": (fa.euler_to_quat, {"angles": W, "sequence": "ZYX"}),
    "to_scipy": (to_scipy, {"q": Q}),
    "inspect_step": (fa.inspect_step, {"scene": BODY, "method": "rk4"}),
    "propagate": (
        fa.propagate, {
            "scene": BODY, "q0": Q, "w0": W, "dt": 0.1, "n_steps": 1, "method": "rk4", "t0": 0.0,
        },
    ),
    "resume": (
        lambda scene, **options: fa.resume(scene, RUN, **options),
        {"scene": BODY, "t_end": 0.5, "save_every": 1, "n_threads": None},
    ),
    "runge_kutta": (
        fa.runge_kutta,
        {"name": "mine", "order": 2, "c": [0, 0.5], "a": [[0.5]], "b": [0.0, 1.0], "limit": 1.0},
    ),
    "TimeSeries": (fa.TimeSeries, {"t": np.arange(3.0), "values": np.ones(3), "slopes": None}),
    "Scene": (fa.Scene, {"inertia": (2.0, 1.0, 0.7), "allow_unphysical": False}),
    "interpolate": (fa.interpolate, {"t": RUN.t, "q": RUN.q, "w": RUN.w, "times": 0.25}),
    "to_aem": (to_aem, {"run": RUN, "epoch": "2026-01-01", "frame": "ICRF", "body": 0}),
    "drift": (fa.drift, {"run": RUN, "scene": BODY}),
    "dataframe": (ic.dataframe, {"run": RUN}),
    "to_jpl": (ic.to_jpl, {"q": Q}),
    "kinetic_energy": (fa.kinetic_energy, {"w": W, "inertia": (2.0, 1.0, 0.7)}),
    "angular_momentum": (fa.angular_momentum, {"w": W, "inertia": (2.0, 1.0, 0.7), "q": Q}),
    "single_step": (
        fa.single_step, {"scene": BODY, "method": "rk4", "representation": "quat", "dtype": None},
    ),
    "angle_between": (fa.angle_between, {"a": Q, "b": Q}),
    "attitude_error": (es.attitude_error, {"q": Q, "q_true": Q}),
    "gyro_motion": (es.gyro_motion, {"gyro": W, "dt": 0.1}),
    "moved": (es.gyro_motion(W, 0.1), {"q": [Q, Q], "y": np.zeros((2, 3))}),
    "scene_motion": (
        es.scene_motion, {"scene": BODY, "dt": 0.1, "n_steps": 1, "method": None, "t0": 0.0},
    ),
    "UKF.predict": (
        lambda **options: es.UKF(Q, np.zeros(3), P).predict(**options),
        {"motion": es.gyro_motion(W, 0.1), "noise": P},
    ),
    "simulate_gyro": (es.simulate_gyro, {"rates": np.ones((5, 3)), "dt": 0.1, "rng": 0}),
    "body_tangent": (
        es.body_tangent,
        {"scene": BODY, "q0": Q, "w0": W, "dt": 0.1, "method": "rk4", "parameters": False},
    ),
    "right_jacobian": (es.right_jacobian, {"u": W}),
    "transition_matrix": (es.transition_matrix, {"w": W, "dt": 0.1}),
    "process_noise": (
        es.process_noise, {"w": W, "dt": 0.1, "angle_noise": 0.1, "bias_noise": 0.1},
    ),
    "covariance_to_body": (es.covariance_to_body, {"covariance": P, "q": Q}),
    "preintegrate": (
        es.preintegrate,
        {
            "gyro": np.ones((4, 3)), "accel": np.ones((4, 3)), "dt": 0.1, "gyro_noise": 0.1,
            "gyro_bias": W,
        },
    ),
    "predict_covariance": (
        es.predict_covariance,
        {"covariance": P, "w": W, "dt": 0.1, "angle_noise": 0.1, "bias_noise": 0.1},
    ),
}  # fmt: skip
# where one argument has the length of another, that one is named
BESIDE = {"mean_attitude": "weights", "TimeSeries": "values"}


@pytest.mark.parametrize("name", CALLS)
def test_a_refusal_names_its_argument(name):
    function, given = CALLS[name]
    function(**given)
    for argument in given:
        for value in HOSTILE:
            try:
                function(**given | {argument: value})
                continue
            except (TypeError, ValueError) as error:
                text = str(error)
            named = "|".join([argument, *filter(None, [BESIDE.get(name)])])
            assert re.search(rf"(?<!\w)({named})(?!\w)", text), (argument, value, text)
            assert "\n" not in text
            assert re.search("accepted|is missing", text), text


@pytest.mark.parametrize("value", [None, 5, b"a", "a\0b"])
def test_what_is_no_path_is_refused(value):
    for function in (
        ic.read_aem, RUN.to_csv, fa.to_file, lambda path: ic.write_csv(RUN, path),
        lambda path: RUN.to_aem(path, epoch="2026-01-01", frame="ICRF"),
    ):  # fmt: skip
        with pytest.raises(TypeError, match=r"^path: found .*; accepted: a path"):
            function(value)
    assert not Path("5").exists()
