"""Representations of the attitude."""

from fastatt.attitudes.attitude import Attitude
from fastatt.attitudes.representations import (
    ATTITUDES,
    COMPENSATED,
    DIRECTION,
    KNOWN,
    QUATERNION,
)

__all__ = ["ATTITUDES", "COMPENSATED", "DIRECTION", "KNOWN", "QUATERNION", "Attitude"]
