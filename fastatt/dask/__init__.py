"""Ensembles in chunks, lazily, on Dask: several processes of one machine, or many machines.

Each chunk runs on one thread of a worker, so a worker with k threads runs k chunks at a time. The
first chunk in a process loads the compiled loop, or compiles it. Results are those of the library's
own calls, bit for bit, whatever the chunks. Warnings reach the process that asked.
"""

try:
    import dask.array  # noqa: F401
except ImportError:
    raise ImportError(
        "fastatt.dask: needs dask; install it with pip install 'fastatt[dask]'"
    ) from None

from fastatt.dask.runs import LazyTrajectory, propagate
from fastatt.dask.statistics import Drifts, drift_statistics, work_precision

__all__ = ["Drifts", "LazyTrajectory", "drift_statistics", "propagate", "work_precision"]
