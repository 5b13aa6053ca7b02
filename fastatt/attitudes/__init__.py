"""Representations of the attitude, one file each."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from fastatt.attitudes.angles import ANGLES
from fastatt.attitudes.attitude import Attitude
from fastatt.attitudes.direction import DIRECTION
from fastatt.attitudes.matrix import MATRIX
from fastatt.attitudes.mrp import MRP
from fastatt.attitudes.quaternion import COMPENSATED, QUATERNION
from fastatt.attitudes.rotation_vector import ROTATION_VECTOR
from fastatt.attitudes.rows import ROWS

_ALL = (QUATERNION, MATRIX, MRP, ROWS, ANGLES, ROTATION_VECTOR)
ATTITUDES: Mapping[str, Attitude] = MappingProxyType({a.name: a for a in _ALL})

#: the representations of the library by name
KNOWN = {**ATTITUDES, "compensated": COMPENSATED, "direction": DIRECTION}

__all__ = ["ATTITUDES", "COMPENSATED", "DIRECTION", "KNOWN", "QUATERNION", "Attitude"]
