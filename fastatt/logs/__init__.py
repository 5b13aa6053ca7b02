"""Gyro logs: read as they are found, integrated whole or in chunks, compared with a reference."""

from fastatt.logs.log import Log, read_log
from fastatt.logs.names import LogError, LogWarning

__all__ = ["Log", "LogError", "LogWarning", "read_log"]
