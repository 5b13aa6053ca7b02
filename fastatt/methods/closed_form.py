"""The closed form of free motion: one evaluation for each save, whatever the number of steps."""

from __future__ import annotations

from fastatt.methods.method import FREE, Method

METHOD = Method(
    name="exact",
    order=0,
    scenes=FREE,
    representations=("quat", "dcm"),
    conserves=("norm", "momentum", "energy"),
    rate_calls=0,
    exponentials=0,
    limits={},
    summary="Jacobi's closed form at every save; sparse output, reference",
    source="van Zon and Schofield, J. Comput. Phys. 225 (2007) 145; Celledoni et al. (2008)",
)
