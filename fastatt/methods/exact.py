"""The method "exact": a closed form, with one evaluation for each save."""

from fastatt.methods.method import BODIES, Method

METHOD = Method(
    name="exact",
    order=0,
    scenes=BODIES,
    conserves=("norm", "momentum", "energy"),
    rate_calls=0,
    limits={},
    summary="closed form of free bodies and heavy symmetric tops; for few saves and as a reference",
    source="van Zon and Schofield, J. Comput. Phys. 225 (2007) 145; Celledoni et al. (2008); "
    "Klein and Sommerfeld, The Theory of the Top (1897-1910)",
)
