"""The command line: ``fastatt`` and ``python -m fastatt``."""

from __future__ import annotations

import argparse
import os
import re
import sys
import warnings
from collections.abc import Callable, Container, Sequence
from contextlib import suppress
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from fastatt import __version__, _store
from fastatt.checks import attitudes, choice
from fastatt.gyro.attitudes import attitude_rows, check_ending, write_attitudes
from fastatt.gyro.columns import ACCEL_UNITS, ANGLES, TIME_UNITS, UNITS
from fastatt.gyro.integrate import methods_for_samples
from fastatt.gyro.invalid_rows import ON_BAD_ROWS
from fastatt.gyro.log import VALUES
from fastatt.gyro.read import read_gyro_log
from fastatt.methods import METHODS
from fastatt.rounding import noted
from fastatt.scene.torque_record import Dependence
from fastatt.trade.ensembles import SCENES
from fastatt.trade.standard_study import run_trade

# options of a log that read it
_READING = (
    "columns", "unit", "rate", "time_column", "time_unit", "rows", "on_bad_rows", "max_gap",
    "values", "accel_columns", "accel_unit", "mag_columns",
)  # fmt: skip
_BAD_INPUT = ValueError, TypeError, OSError
# in a message: the word that it is about, one with a sign of equality, or one of two parts
_ARGUMENT = re.compile(r"(^|(?<=: ))\w+(?=:| is )|\b\w+(?==)|\b\w+_\w+")


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command; returns 0 on success, 2 after one line on standard error on bad input.

    Raises ``ImportError`` for a missing package, ``KeyboardInterrupt``.
    """
    parser = _parser()
    arguments = parser.parse_args(argv)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("default")
            warnings.showwarning = _print_warning
            arguments.run(arguments)
            sys.stdout.flush()
    except BrokenPipeError:
        # at exit, flushing the rest of the output would fail again
        with suppress(OSError, ValueError):  # the stream may be no file
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        print("fastatt: standard output was closed before the end", file=sys.stderr)
        return 2
    except _BAD_INPUT as error:
        _print_error(error, arguments)
        return 2
    return 0


def _print_error(error: Exception, arguments: argparse.Namespace) -> None:
    text = str(error)
    if isinstance(error, OSError) and error.strerror:
        text = ": ".join(str(part) for part in (error.strerror, error.filename) if part)
    print(f"fastatt: {_with_options(text, vars(arguments))}", file=sys.stderr)


def _with_options(text: str, known: Container[str]) -> str:
    """A message on one line, with options in place of Python's arguments."""

    def option(match: re.Match[str]) -> str:
        name = match[0]
        return f"--{name.replace('_', '-')}" if name in known else name

    return _ARGUMENT.sub(option, " ".join(text.split()))


def _print_warning(message: Warning | str, *about: object, **more: object) -> None:
    """Print a warning as one line, without its place in the source."""
    print(f"fastatt: warning: {' '.join(str(message).split())}", file=sys.stderr)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="fastatt",
        description="Orientation of rigid bodies, propagated fast, with known error.",
        epilog="example: fastatt trade --quick",
    )
    parser.add_argument("-V", "--version", action="version", version=f"fastatt {__version__}")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    def command(
        run: Callable[..., None], brief: str, example: str, more: str = ""
    ) -> argparse.ArgumentParser:
        about, epilog = f"{brief}. {more}", f"example: fastatt {example}"
        name = run.__name__.removeprefix("_")
        added = commands.add_parser(name, help=brief, description=about, epilog=epilog)
        added.set_defaults(run=run)
        return added

    command(_methods, "list the methods and where each fits", "methods")
    brief = "integrate a gyro log to attitudes, body to inertial"
    _add_log(command(_integrate, brief, "integrate LOG.csv --unit rad/s --time-unit us"))
    brief = "measure every method's speed, error and drift"
    more = (
        "All fitting methods run on ensembles with a known answer, on quaternions and on matrices, "
        "for two minutes; a summary, CSV files and pictures are written to a folder."
    )
    trade = command(_trade, brief, "trade --scene coning --methods magnus4,rk4 --quick", more)
    add = trade.add_argument
    add("--scene", action="append", choices=SCENES, help="a scene, may be repeated (default: all)")
    add("--methods", type=_names, help="only these methods, where they fit: rk4,magnus4")
    out = "folder for results (default: results)"
    add("-o", "--out", type=Path, default=Path("results"), help=out)
    add("--bodies", type=int, default=512, help="size of the ensembles (default: 512)")
    add("--quick", action="store_true", help="the usual methods with fewer step sizes, 20 s")
    add("--verbose", action="store_true", help="print all rows too")
    brief = "show where compiled functions are kept and how large they are"
    more = "FASTATT_CACHE names another folder; FASTATT_CACHE=0 switches it off."
    cache = command(_cache, brief, "cache", more)
    cache.add_argument("--clear", action="store_true", help="remove them")
    return parser


def _cache(arguments: argparse.Namespace) -> None:
    if arguments.clear:
        _store.clear()
    print(_store.where())


def _add_log(command: argparse.ArgumentParser) -> None:
    """Options of a log: reading and integration."""
    add = command.add_argument
    log = "text tables with three rate columns, gzipped or not; - is standard input"
    add("log", nargs="+", metavar="LOG", help=log)
    out = "attitudes as .csv or .npy, or a folder (default: LOG.attitudes.csv)"
    add("-o", "--out", type=Path, help=out)
    method = "a method for sampled rates (default: previous)"
    add("-m", "--method", default="previous", help=method)
    add("-c", "--columns", type=_names, help="three names or numbers from 1: Gyr_X,Gyr_Y,Gyr_Z")
    add("-u", "--unit", choices=UNITS | ANGLES, help="unit of the rates, or increments")
    add("--time-unit", choices=TIME_UNITS, help="unit of the time stamps")
    accel = "three of an accelerometer; the attitudes' file then has ax, ay, az in m/s²"
    add("--accel-columns", type=_names, help=accel)
    add("--accel-unit", choices=ACCEL_UNITS, help="unit of --accel-columns")
    mag = "three of a magnetometer; the attitudes' file then has mx, my, mz"
    add("--mag-columns", type=_names, help=mag)
    values = "what the numbers are, if no format says it (default: samples)"
    add("--values", choices=VALUES, help=values)
    timing = command.add_mutually_exclusive_group()
    timing.add_argument("-r", "--rate", type=float, help="sample rate, Hz")
    column = "name or number of the time stamps' column, or two: of seconds and nanoseconds"
    timing.add_argument("-t", "--time-column", type=_names, help=column)
    rows = "read only rows with this text in a column (may be repeated): name=IMU"
    add("--rows", type=_pair, action="append", metavar="COLUMN=TEXT", help=rows)
    q0 = "first attitude: q0,q1,q2,q3 (default: 1,0,0,0)"
    add("--q0", type=_floats, default=[1.0, 0.0, 0.0, 0.0], help=q0)
    bad_rows = (
        "rows without a rate, stamps that do not increase, gaps: refuse (default), drop (intervals "
        "span them)"
    )
    add("--on-bad-rows", choices=ON_BAD_ROWS, default="refuse", help=bad_rows)
    add("--max-gap", type=float, help="longest interval that is not a gap, s")


def _names(text: str) -> list[str]:
    return [part.strip() for part in text.split(",")]


def _pair(text: str) -> tuple[str, str]:
    name, sign, value = text.partition("=")
    if not sign:
        raise argparse.ArgumentTypeError(f"found {text!r}; accepted: COLUMN=TEXT")
    return name, value


def _floats(text: str) -> list[float]:
    try:
        return [float(part) for part in text.split(",")]
    except ValueError:
        raise argparse.ArgumentTypeError(f"found {text!r}; accepted: numbers") from None


def _methods(_: argparse.Namespace) -> None:
    lines = [("method", "order", "scenes", "representations")]
    for m in METHODS.values():
        order = str(m.order or "exact")
        order += "".join(f", {other} for {scenes}" for scenes, other in m.orders.items())
        damped = " *" if m.takes is Dependence.DAMPED else ""
        lines.append((m.name, order, ", ".join(m.scenes) + damped, ", ".join(m.representations)))
    for rows in (lines, [(m.name, f"{m.summary}. {m.source}") for m in METHODS.values()]):
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        for row in rows:
            print("  ".join(x.ljust(w) for x, w in zip(row, widths, strict=True)).rstrip())
        print()
    print("* torques free of w but for linear damping; exact: a closed form")


def _integrate(arguments: argparse.Namespace) -> None:
    """Integrate each log; of several, those that are refused do not stop the others."""
    attitudes("q0", np.array(arguments.q0), "(4,)")
    choice("method", arguments.method, methods_for_samples())
    outs = [_output(arguments.out, log) for log in arguments.log]
    if len(set(outs)) < len(outs):
        twice = max(outs, key=outs.count)
        raise ValueError(
            f"out: found {twice} for several logs; accepted: a file each, or an existing folder"
        )
    refused = 0
    for log, out in zip(arguments.log, outs, strict=True):
        try:
            _integrate_one(arguments, log, out)
        except _BAD_INPUT as error:
            if len(outs) == 1 or isinstance(error, BrokenPipeError):
                raise
            _print_error(error, arguments)
            refused += 1
    if refused:
        raise ValueError(f"{refused} of {len(outs)} logs are not integrated")


def _output(out: Path | None, log: str) -> Path:
    """The file for the attitudes of a log."""
    path = Path("log" if log == "-" else log.removesuffix(".gz"))
    if out and not out.is_dir():
        return out
    return (out or path.parent) / f"{path.stem}.attitudes.csv"


def _integrate_one(arguments: argparse.Namespace, path: str, out: Path) -> None:
    if path != "-" and out.exists() and out.samefile(path):
        raise ValueError(f"out: found {out}, which is LOG; accepted: another file")
    check_ending(out)
    log = read_gyro_log(path, **{name: getattr(arguments, name) for name in _READING})
    sensors = [x for x in ("accel", "mag") if getattr(arguments, f"{x}_columns")]
    with noted() as warned:
        rows = attitude_rows(log, arguments.q0, arguments.method, sensors)
    for text in warned:
        _print_warning(text if len(arguments.log) == 1 else f"{path}: {text}")
    write_attitudes(out, rows, sensors)
    print(log.summary)
    print(f"{out}: {len(rows)} attitudes by {arguments.method}, body to inertial, scalar first")


def _trade(arguments: argparse.Namespace) -> None:
    has_bar = sys.stderr.isatty() and find_spec("tqdm") is not None
    run_trade(
        arguments.out, scenes=arguments.scene or SCENES, methods=arguments.methods,
        n_bodies=arguments.bodies, quick=arguments.quick, verbose=arguments.verbose,
        progress=has_bar,
    )  # fmt: skip
