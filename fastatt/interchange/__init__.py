"""Exchange with other software: conventions of attitudes, tables, attitude ephemeris messages."""

from fastatt.interchange.aem import Aem, AemSegment, read_aem
from fastatt.interchange.aem_of_run import aem_of
from fastatt.interchange.conventions import (
    from_jpl,
    from_mrp,
    from_scalar_last,
    from_scipy,
    rates_to_body,
    rates_to_inertial,
    to_jpl,
    to_mrp,
    to_passive,
    to_scalar_last,
    to_scipy,
)
from fastatt.interchange.tables import dataframe, write_csv

__all__ = [
    "Aem", "AemSegment", "aem_of", "dataframe", "from_jpl", "from_mrp", "from_scalar_last",
    "from_scipy", "rates_to_body", "rates_to_inertial", "read_aem", "to_jpl", "to_mrp",
    "to_passive", "to_scalar_last", "to_scipy", "write_csv",
]  # fmt: skip
