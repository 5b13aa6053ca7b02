"""Integration of sampled rates and angle increments to attitudes, and gyro logs."""

from fastatt.gyro.log import GyroLog, GyroLogWarning

__all__ = ["GyroLog", "GyroLogWarning"]
