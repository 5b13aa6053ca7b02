"""A run from what a user asks to what he gets: checked, propagated, looked at."""
