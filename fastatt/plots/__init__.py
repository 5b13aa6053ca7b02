"""Pictures of runs with matplotlib, drawn to files without a display."""

from fastatt import checks

checks.optional("pictures", "matplotlib", "fastatt[plot]")

from fastatt.plots.runs import history, polhode  # noqa: E402

__all__ = ["history", "polhode"]
