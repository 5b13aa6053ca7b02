"""Tiles of bodies, the time loop, threads and saving."""
