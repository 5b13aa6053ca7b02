"""Exchange with other software: conventions of attitudes, tables, attitude ephemeris messages."""

from fastatt.interchange.aem import Aem, AemSegment, read_aem
from fastatt.interchange.conventions import (
    from_jpl,
    from_scalar_last,
    from_scipy,
    to_jpl,
    to_scalar_last,
    to_scipy,
)
from fastatt.interchange.run_tables import dataframe, write_csv

__all__ = [
    "Aem", "AemSegment", "dataframe", "from_jpl", "from_scalar_last", "from_scipy", "read_aem",
    "to_jpl", "to_scalar_last", "to_scipy", "write_csv",
]  # fmt: skip
