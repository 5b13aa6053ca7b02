"""What an exact motion conserves: energy and angular momentum, and their drift in a run."""
