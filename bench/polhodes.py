"""The picture of free bodies of the pages: polhodes and herpolhodes, in closed form.

python bench/polhodes.py      # fastatt/docs/pictures/polhodes.png
"""

from __future__ import annotations

import math
import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fastatt import plots
from fastatt.arrays import quat_rotate
from fastatt.propagation import closed_form
from fastatt.propagation.energy import angular_momentum, kinetic_energy
from fastatt.trade.ensembles import TRIAXIAL

PICTURES = Path(__file__).parents[1] / "fastatt" / "docs" / "pictures"
_QUAT = (1.0, 0.0, 0.0, 0.0)
# of the momentum from axis 1 to axis 3, deg; at 45 the energy of TRIAXIAL is that about axis 2
_LATITUDES = (12.0, 24.0, 36.0, 45.0, 54.0, 66.0, 78.0)
_SEPARATRIX = 45.0
_ROLLED = (12.0, 36.0, _SEPARATRIX)


def _momentum(latitude: float) -> NDArray[np.float64]:
    a = math.radians(latitude)
    return np.array([math.cos(a), 0.0, math.sin(a)])


def _energy(m: NDArray[np.float64]) -> float:
    return float(kinetic_energy(m / TRIAXIAL, TRIAXIAL))


def polhodes() -> list[plots.Polhode]:
    """Curves of constant energy on the momentum sphere of ``TRIAXIAL``, (T, 3) each."""
    t = np.linspace(-20.0, 20.0, 2001)
    found = []
    for latitude in _LATITUDES:
        m = _momentum(latitude)
        # the mirror images of a start lie on the curve, or on the one about the axis's other end
        starts = m * np.array(
            [(1.0, 1.0, 1.0), (-1.0, 1.0, 1.0), (1.0, 1.0, -1.0), (-1.0, 1.0, -1.0)]
        )
        _, w = closed_form.free_body(_QUAT, starts / TRIAXIAL, TRIAXIAL, t)
        curves = np.swapaxes(angular_momentum(w, TRIAXIAL), 0, 1)
        found.append(plots.Polhode(_energy(m), list(curves), latitude == _SEPARATRIX))
    return found


def herpolhodes() -> dict[float, NDArray[np.float64]]:
    """Angular velocity in the plane across the momentum, (T, 2) rad/s, by a polhode's energy."""
    t = np.linspace(0.0, 40.0, 2001)
    found = {}
    for latitude in _ROLLED:
        m = _momentum(latitude)
        q, w = closed_form.free_body(_QUAT, m / TRIAXIAL, TRIAXIAL, t)
        # at t = 0 body and inertial axes coincide, and axis 2 lies across the momentum
        y = np.array([0.0, 1.0, 0.0])
        plane = np.stack([np.cross(y, m), y], axis=1)
        found[_energy(m)] = quat_rotate(q, w) @ plane
    return found


if __name__ == "__main__":
    path = Path(sys.argv[1]) if sys.argv[1:] else PICTURES / "polhodes.png"
    plots.polhodes(polhodes(), herpolhodes(), path)
