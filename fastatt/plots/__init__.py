"""Pictures with matplotlib, drawn to files without a display: of runs, and of studies."""

from fastatt.plots.animated import animation
from fastatt.plots.runs import history, polhode
from fastatt.plots.study import (
    Departures,
    MethodCurve,
    Panel,
    Polhode,
    polhodes,
    recordings,
    work_precision,
)

__all__ = [
    "Departures", "MethodCurve", "Panel", "Polhode", "animation",
    "history", "polhode", "polhodes", "recordings", "work_precision",
]  # fmt: skip
