"""What ``fastatt integrate`` takes."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path

from fastatt.logs.names import TIME_UNITS, UNITS
from fastatt.logs.stamps import BAD


def add_options(
    command: argparse.ArgumentParser,
    names: Callable[[str], list[str]],
    floats: Callable[[str], list[float]],
) -> None:
    """A log, how it is read and what is made of it; the functions read lists."""
    add = command.add_argument
    add("log", help="text table with three rate columns, gzipped or not; - is standard input")
    out = "attitudes as .csv, .npy or .zarr (default: LOG.attitudes.csv)"
    add("-o", "--out", type=Path, help=out)
    method = "a method for sampled rates (default: previous)"
    add("-m", "--method", default="previous", help=method)
    add("-c", "--columns", type=names, help="three names or numbers from 1: Gyr_X,Gyr_Y,Gyr_Z")
    add("-u", "--unit", choices=UNITS, help="unit of the rates")
    add("--time-unit", choices=TIME_UNITS, help="unit of the time stamps")
    timing = command.add_mutually_exclusive_group()
    timing.add_argument("-r", "--rate", type=float, help="sample rate, Hz")
    timing.add_argument("-t", "--time-column", help="name or number of the time stamps' column")
    add("--q0", type=floats, default=[1.0, 0.0, 0.0, 0.0], help="first attitude: q0,q1,q2,q3")
    add(
        "--bad",
        choices=BAD,
        default="refuse",
        help="what becomes of rows that are no numbers, stamps that do not grow, and gaps: refuse "
        "(default), drop (intervals go across), split (each piece begins at q0), hold (the last "
        "rates stay)",
    )
    add("--max-gap", type=float, help="longest interval that is no gap, s")
    bias = "take off the mean rate of so many s from the start"
    add("--bias-seconds", type=float, help=bias)
    reference = "table of a reference's attitudes: clocks and frames aligned, the angle is said"
    add("--reference", type=Path, help=reference)
    compare = "besides, how far the other methods differ, and where the error comes from"
    add("--compare", action=argparse.BooleanOptionalAction, default=False, help=compare)
    add("-q", "--quiet", action="store_true", help="no progress bar")
