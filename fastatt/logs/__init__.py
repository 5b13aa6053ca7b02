"""Gyro logs: reading files, integrating them to attitudes, comparing these with a reference."""

from fastatt.logs.log import GyroLog, read_gyro_log
from fastatt.logs.names import GyroLogError, GyroLogWarning

__all__ = ["GyroLog", "GyroLogError", "GyroLogWarning", "read_gyro_log"]
