"""The picture of free bodies of the pages: polhodes and herpolhodes of one angular momentum.

python bench/polhodes.py      # fastatt/docs/pictures/polhodes.png
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

import fastatt as fa
from fastatt import plots
from fastatt.trade.ensembles import TRIAXIAL

PICTURES = Path(__file__).parents[1] / "fastatt" / "docs" / "pictures"
# of the momentum from axis 1 to axis 3, deg; at 45 the energy of TRIAXIAL is that about axis 2
LATITUDES = (12.0, 36.0, 45.0, 66.0)
SCENE = fa.Scene(inertia=TRIAXIAL)


def motion() -> fa.Trajectory:
    """20 s of a body at each latitude, with an angular momentum of 1 N·m·s."""
    angle = np.radians(LATITUDES)
    momentum = np.stack([np.cos(angle), 0.0 * angle, np.sin(angle)], axis=1)
    q0 = np.tile([1.0, 0.0, 0.0, 0.0], (len(LATITUDES), 1))
    return fa.propagate(
        SCENE, q0, momentum / TRIAXIAL, dt=0.02, n_steps=1000, save_every=1, method="exact"
    )


if __name__ == "__main__":
    path = Path(sys.argv[1]) if sys.argv[1:] else PICTURES / "polhodes.png"
    plots.polhode(motion(), SCENE, path)
