"""Runs from arguments to trajectories: checked, planned, executed, evaluated."""
