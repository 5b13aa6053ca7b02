"""Pictures with matplotlib, drawn to files without a display: of runs, and of studies."""

from fastatt.plots.animated import animation
from fastatt.plots.runs import history, polhode
from fastatt.plots.study import (
    Departures,
    Ladder,
    Panel,
    Polhode,
    polhodes,
    recordings,
    work_precision,
)

__all__ = [
    "Departures", "Ladder", "Panel", "Polhode", "animation",
    "history", "polhode", "polhodes", "recordings", "work_precision",
]  # fmt: skip
