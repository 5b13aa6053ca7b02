"""Lazy ensembles in chunks, on Dask: several processes of one machine, or many machines.

Each chunk runs on one thread of a worker, so that a worker with k threads runs k chunks at a time.
The first chunk in a process loads the compiled loop, or compiles it. Results have the same bits as
those of :func:`fastatt.propagate`, whatever the chunks. Warnings reach the client's process.
"""

from fastatt import checks

checks.optional("fastatt.dask", "dask.array", "fastatt[dask]")

from fastatt.dask.chunks import LazyTrajectory, propagate  # noqa: E402

__all__ = ["LazyTrajectory", "propagate"]
