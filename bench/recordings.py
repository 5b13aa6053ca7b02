"""A filter of gyro, accelerometer and magnetometer on recordings, beside a reference's attitudes.

    python bench/recordings.py          # an x-IMU3, beside its maker's filter on the same samples
    python bench/recordings.py BROAD    # a clone of BROAD, beside optical attitudes: a minute

BROAD: Laidig, Caruso, Cereatti and Seel, Data 6 (2021) 72, https://github.com/dlaidig/broad, CC BY
4.0. Errors are rms angles over what it marks as movement, no frame aligned. Beside them stand those
that it publishes of Madgwick's and Mahony's filters, each with its one setting for all trials. The
setting here is one for all as well, chosen on the same trials. The x-IMU3's recording comes with
scikit-kinematics (T. Haslwanter, BSD licence).
"""

from __future__ import annotations

import argparse
import json
from importlib.metadata import files
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.linalg import block_diag
from scipy.spatial.transform import Rotation

import fastatt as fa
from fastatt import estimation as es
from fastatt.interchange import from_scipy

UP = np.array([0.0, 0.0, 1.0])
GATE = 13.82  # 1 in 1000 of two degrees of freedom
LEAST = 0.03  # s from one update to the next
WEIGHTS = np.array([5e-3, 2e-2]) ** -2.0  # rad⁻², of the mean directions at rest


class Recording(NamedTuple):
    """Samples (n, 3) at intervals (n - 1,), s, the first ``still`` at rest, and attitudes (n, 4).

    ``north`` is the inertial axis along which the field points, beside up.
    """

    dt: np.ndarray
    rates: np.ndarray
    accel: np.ndarray
    mag: np.ndarray
    reference: np.ndarray
    still: int
    north: np.ndarray


def x_imu3() -> Recording:
    """10 s by hand, the first 1.1 s on a table; axes north, west, up."""
    parts = files("scikit-kinematics")
    folder = next(f for f in parts if f.match("data_xio3/Inertial.csv")).locate().parent
    log = fa.read_gyro_log(folder / "Inertial.csv")
    when, *columns = np.loadtxt(folder / "Magnetometer.csv", delimiter=",", skiprows=1).T
    mag = np.stack([np.interp(log.t, 1e-6 * when - log.start, x) for x in columns], axis=1)
    q = np.loadtxt(folder / "Quaternion.csv", delimiter=",", skiprows=1)[:, 1:]
    return Recording(log.dt, log.rates, log.accel, mag, q, 55, np.array([1.0, 0.0, 0.0]))


def broad(path: Path) -> tuple[Recording, np.ndarray]:
    """A trial, and whether it moves at each sample; axes east, north, up."""
    from scipy.io import loadmat

    trial = loadmat(path)
    moves = trial["movement"][:, 0].astype(bool)
    dt = np.full(len(moves) - 1, 1.0 / trial["sampling_rate"].item())
    samples = (trial[name] for name in ("imu_gyr", "imu_acc", "imu_mag", "opt_quat"))
    still = int(0.9 * np.argmax(moves))
    return Recording(dt, *samples, still, np.array([0.0, 1.0, 0.0])), moves


def follow(r: Recording) -> tuple[np.ndarray, np.ndarray]:
    """Attitudes from the rest's last sample on: the filter's, and those of the gyro alone."""
    rest = slice(0, r.still)
    pull, field = r.accel[rest].mean(axis=0), r.mag[rest].mean(axis=0)
    strength = float(np.linalg.norm(field))
    lift = pull @ field / (np.linalg.norm(pull) * strength)
    known = np.sqrt(1.0 - lift**2) * r.north + lift * UP
    gravity = float(np.linalg.norm(pull))
    turn, _, sensitivity = Rotation.align_vectors(
        [UP, known], [pull / gravity, field / strength], WEIGHTS, return_sensitivity=True
    )
    start = from_scipy(turn)
    bias, noise = r.rates[rest].mean(axis=0), r.rates[rest].var(axis=0) / r.still
    P = es.covariance_to_body(block_diag(sensitivity / WEIGHTS.mean(), np.diag(noise)), start)
    ahrs = es.MEKF(start, P, bias=bias, angle_noise=3e-3, bias_noise=1e-5)
    every = max(1, round(LEAST / float(np.mean(r.dt))))
    q = np.empty((len(r.rates) - r.still + 1, 4))
    q[0] = start
    for i, k in enumerate(range(r.still, len(r.rates)), 1):
        ahrs.predict(r.rates[k], r.dt[k - 1])
        if k % every == 0:
            for seen, axis, usual in ((r.accel[k], UP, gravity), (r.mag[k], known, strength)):
                size = np.linalg.norm(seen)
                # what is pushed, or near iron, is of another length
                sigma = 0.1 + abs(size / usual - 1.0)
                ahrs.update_vector(seen / size, axis, sigma=sigma, gate=GATE)
        q[i] = ahrs.q
    turns = (r.rates[r.still :] - bias) * r.dt[r.still - 1 :, None]
    return q, fa.integrate_rates(turns, r.dt[r.still - 1 :], start, increments=True)


def errors(r: Recording, seen: np.ndarray | None = None) -> list[float]:
    """The filter's angle from the reference and the gyro's alone, degrees rms, of samples seen."""
    at = np.arange(r.still - 1, len(r.rates))
    if seen is not None:
        at = at[seen[at]]
    angles = (fa.angle_between(q[at - r.still + 1], r.reference[at]) for q in follow(r))
    return [float(np.degrees(np.sqrt(np.mean(a**2)))) for a in angles]


def published(folder: Path, name: str) -> dict[str, float]:
    """A filter's errors as BROAD publishes them, by trial, with its setting for all."""
    from scipy.io import loadmat

    results = folder / "example_code" / "out"
    text = (results / f"results_{name}_average_rmse.json").read_text(encoding="utf-8")
    setting = tuple(json.loads(text)["tagp_parameter_ind"])
    found = loadmat(results / f"results_{name}.mat", squeeze_me=True)["total_rmse_deg"]
    pairs = zip(found.dtype.names, found.item(), strict=True)
    return {trial.removeprefix("trial_"): float(table[setting]) for trial, table in pairs}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("broad", nargs="?", type=Path, help="a clone of BROAD's repository")
    folder = parser.parse_args().broad
    if folder is None:
        filtered, alone = errors(x_imu3())
        print(f"x-IMU3, from the maker's filter: {filtered:.1f}° rms; gyro alone {alone:.1f}°")
        return
    others = {name: published(folder, name) for name in ("madgwick", "mahony")}
    rows = {}
    for path in sorted((folder / "data_mat").glob("*.mat")):
        recording, moves = broad(path)
        found = errors(recording, moves & np.isfinite(recording.reference).all(axis=1))
        rows[path.stem] = (*found, *(other[path.stem] for other in others.values()))
    print("| trial | MEKF, ° rms | gyro alone | Madgwick's, published | Mahony's, published |")
    print("| --- | --- | --- | --- | --- |")
    calm = {name for name in rows if "_undisturbed_" in name}
    means = {
        f"mean of {len(some)} {kind}": np.mean([rows[name] for name in some], axis=0)
        for kind, some in (("undisturbed", calm), ("disturbed", rows.keys() - calm))
        if some
    }
    for name, values in {**rows, **means}.items():
        print(f"| {name} | " + " | ".join(f"{x:.1f}" for x in values) + " |")


if __name__ == "__main__":
    main()
