"""Sampled rates and angle increments, gyro logs, to attitudes."""
