"""Pictures of runs with matplotlib, drawn to files without a display."""

try:
    import matplotlib as mpl  # noqa: F401
except ImportError:
    raise ImportError(
        "pictures: need matplotlib; install it with pip install 'fastatt[plot]'"
    ) from None

from fastatt.plots.runs import history, polhode

__all__ = ["history", "polhode"]
