"""Hostile input: what ``fuzz.trying`` tries."""
