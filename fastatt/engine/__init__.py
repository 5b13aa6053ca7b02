"""The engine: tiles of bodies, the time loop, threads and saving."""
