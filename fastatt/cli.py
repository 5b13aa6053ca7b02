"""The command line: ``fastatt`` and ``python -m fastatt``."""

from __future__ import annotations

import argparse
import os
import sys
import warnings
from collections.abc import Callable, Sequence
from contextlib import suppress
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from fastatt import __version__, precompile
from fastatt.checks import attitudes, choice, real, whole
from fastatt.codegen import modules
from fastatt.gyro.integrate import methods_for_samples
from fastatt.logs.attitudes import attitude_file, attitude_rows
from fastatt.logs.gaps import ON_BAD_ROWS
from fastatt.logs.log import read_gyro_log
from fastatt.logs.names import TIME_UNITS, UNITS
from fastatt.logs.reference import against_reference, read_attitudes
from fastatt.methods import METHODS
from fastatt.scene.scene import Scene
from fastatt.scene.torque_record import Dependence
from fastatt.trade.advice import recommend
from fastatt.trade.recordings import compare_on_log
from fastatt.trade.run import DEFAULT_SCENES, SCENES, open_folder, run_trade
from fastatt.trade.scene_file import from_words, read_rows, read_scene
from fastatt.trade.work_precision import work_precision

_ALL = "all"
# kinds of scenes on the command line, and in the records of methods
_KINDS = {
    "rate": ("rate",),
    "free": ("spherical", "symmetric", "free"),
    "torqued": ("torqued",),
    "samples": ("sampled rates", "increments"),
}


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command; returns 0 on success, 2 after one line on standard error on bad input."""
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
    except (ValueError, TypeError, OSError, ImportError) as error:
        text = str(error)
        if isinstance(error, OSError) and error.strerror:
            text = ": ".join(str(part) for part in (error.strerror, error.filename) if part)
        print(f"fastatt: {' '.join(text.split())}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("fastatt: stopped", file=sys.stderr)
        return 130
    return 0


def _print_warning(message: Warning | str, *about: object, **more: object) -> None:
    """Print a warning as one line, without its place in the source."""
    print(f"fastatt: warning: {' '.join(str(message).split())}", file=sys.stderr)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="fastatt",
        description="Orientation of rigid bodies, propagated fast, with known error.",
    )
    parser.add_argument("--version", action="version", version=f"fastatt {__version__}")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    def command(run: Callable[..., None], brief: str, more: str = "") -> argparse.ArgumentParser:
        name = run.__name__.removeprefix("_")
        added = commands.add_parser(name, help=brief, description=f"{brief}. {more}")
        added.set_defaults(run=run)
        return added

    methods = command(_methods, "list the methods and where each fits")
    methods.add_argument("--scene", choices=_KINDS, help="only those for this kind of scene")

    integrate = command(_integrate, "integrate a gyro log to attitudes, body to inertial")
    _add_log(integrate)

    trade = command(_trade, "measure every method's speed against its error", _TRADE)
    add = trade.add_argument
    scenes = f"a study, may be repeated (default: {' and '.join(DEFAULT_SCENES)})"
    add("--scene", action="append", choices=(*SCENES, _ALL), help=scenes)
    add("--methods", type=_names, help="only these methods, where they fit: rk4,magnus4")
    add("-o", "--out", type=Path, default=Path("results"), help="folder for results")
    logs = "a gyro log instead of the recordings of scikit-kinematics (may be repeated)"
    add("--log", type=Path, action="append", help=logs)
    _add_scene(trade)
    add("--t-end", type=float, help="duration of the given scene, s")
    add("--quick", action="store_true", help="few steps, one repeat, quaternions in float64 only")

    advice = command(_recommend, "find the fastest method and step size for a given scene")
    _add_scene(advice)
    add = advice.add_argument
    add("--t-end", type=float, required=True, help="duration, s")
    goal = advice.add_mutually_exclusive_group(required=True)
    goal.add_argument("--tol", type=float, help="largest error of any body, rad")
    goal.add_argument("--budget", type=float, help="longest time that the run may take, s")
    where = "measure errors over the run (default), or at its end only"
    add("--at", choices=("run", "end"), default="run", help=where)
    add("--methods", type=_names, help="only these methods: rk4,magnus4")

    compile_usual = command(_precompile, "compile the usual programs beforehand", _PRECOMPILE)
    add = compile_usual.add_argument
    add("--all", action="store_true", help="also single precision and all representations")
    add("--scene-file", type=Path, help="only the methods of a scene, .json or .toml")
    add("-j", "--jobs", type=int, help="number of processes (default: one for each processor)")

    cache = command(_cache, "show where compiled functions are kept and how large they are", _CACHE)
    cache.add_argument("--clear", action="store_true", help="remove them")
    for shows_progress in (integrate, trade, advice, compile_usual):
        shows_progress.add_argument("-q", "--quiet", action="store_true", help="no progress bar")
    return parser


_TRADE = (
    "All fitting methods run on recorded gyro logs and on ensembles with a known answer, or on a "
    "given scene; tables, CSV files and pictures are written to a folder."
)
_PRECOMPILE = (
    "Every method on usual scenes (constant rate, coning, free body, heavy top, gravity gradient "
    "and damping) and for logs, on quaternions and matrices in double precision, in parallel "
    "processes. Programs are kept: FASTATT_CACHE names the folder."
)
_CACHE = "FASTATT_CACHE names another folder; FASTATT_CACHE=0 switches it off."


def _precompile(arguments: argparse.Namespace) -> None:
    if arguments.jobs is not None:
        whole("--jobs", arguments.jobs, 1)
    if arguments.scene_file is None:
        tasks = precompile.usual(everything=arguments.all)
    else:
        scene = read_scene(arguments.scene_file)
        tasks = precompile.of_scene(scene, everything=arguments.all)
    progress = _bar_wanted(arguments.quiet)
    print(precompile.precompile(tasks, processes=arguments.jobs, progress=progress))


def _cache(arguments: argparse.Namespace) -> None:
    if arguments.clear:
        modules.clear()
    print(precompile.where())


def _add_log(command: argparse.ArgumentParser) -> None:
    """Options of a log: reading, integration, comparison."""
    add = command.add_argument
    add("log", help="text table with three rate columns, gzipped or not; - is standard input")
    out = "attitudes as .csv, .npy or .zarr (default: LOG.attitudes.csv)"
    add("-o", "--out", type=Path, help=out)
    method = "a method for sampled rates (default: previous)"
    add("-m", "--method", default="previous", help=method)
    add("-c", "--columns", type=_names, help="three names or numbers from 1: Gyr_X,Gyr_Y,Gyr_Z")
    add("-u", "--unit", choices=UNITS, help="unit of the rates")
    add("--time-unit", choices=TIME_UNITS, help="unit of the time stamps")
    timing = command.add_mutually_exclusive_group()
    timing.add_argument("-r", "--rate", type=float, help="sample rate, Hz")
    timing.add_argument("-t", "--time-column", help="name or number of the time stamps' column")
    add("--q0", type=_floats, default=[1.0, 0.0, 0.0, 0.0], help="first attitude: q0,q1,q2,q3")
    bad_rows = (
        "rows without a rate, stamps that do not increase, gaps: refuse (default), drop (intervals "
        "span them), split (each piece begins at q0), hold (the last rates stay)"
    )
    add("--on-bad-rows", choices=ON_BAD_ROWS, default="refuse", help=bad_rows)
    add("--max-gap", type=float, help="longest interval that is not a gap, s")
    bias = "subtract the mean rate of so many s from the start"
    add("--bias-seconds", type=float, help=bias)
    reference = "table of reference attitudes: clocks and frames are aligned, the angle is printed"
    add("--reference", type=Path, help=reference)
    compare = "print how far the other methods differ, and where the error comes from"
    add("--compare", action=argparse.BooleanOptionalAction, default=False, help=compare)


def _add_scene(command: argparse.ArgumentParser) -> None:
    """Options that make a scene and an ensemble."""
    add = command.add_argument_group("a given scene").add_argument
    add("--scene-file", type=Path, help="a .json or .toml file with the scene")
    add("--inertia", type=_floats, help="principal moments, kg·m²: 2,1,0.7; nine numbers: a tensor")
    model: dict[str, Any] = {
        "nargs": "+", "action": "append", "metavar": ("NAME", "KEY=NUMBERS")
    }  # fmt: skip
    torque = "a model of fastatt.torques, may be repeated: HeavyTop arm=0,0,0.1 weight=10"
    add("--torque", **model, help=torque)
    add("--rate", **model, help="a model of fastatt.rates: Coning angle=0.5 frequency=2")
    add("--frame", choices=("body", "inertial"), help="axes of the rate")
    add("--q0", type=Path, help="initial attitudes, .csv or .npy (default: random)")
    add("--w0", type=Path, help="initial rates, rad/s, .csv or .npy (default: random)")
    add("--spin", type=float, help="deviation of random rates, rad/s per axis (default: 1)")
    bodies = "size of the ensemble (default: 4096)"
    command.add_argument("--bodies", type=int, default=4096, help=bodies)


def _names(text: str) -> list[str]:
    return [part.strip() for part in text.split(",")]


def _floats(text: str) -> list[float]:
    try:
        return [float(part) for part in text.split(",")]
    except ValueError:
        raise argparse.ArgumentTypeError(f"found {text!r}; accepted: numbers") from None


def _bar_wanted(quiet: bool) -> bool:
    return not quiet and sys.stderr.isatty() and find_spec("tqdm") is not None


def _methods(arguments: argparse.Namespace) -> None:
    width = max(map(len, METHODS))
    for m in METHODS.values():
        if arguments.scene and not set(m.scenes) & set(_KINDS[arguments.scene]):
            continue
        order = f"order {m.order}" if m.order else "closed form"
        order += "".join(f", {other} for {kind}" for kind, other in m.orders.items())
        damped = " (torques free of w but for linear damping)"
        scenes = ", ".join(m.scenes) + (damped if m.takes is Dependence.DAMPED else "")
        print(f"{m.name:{width}}  {order}; {scenes}: {m.summary}")
        print(f"{'':{width}}  {', '.join(m.representations)}; {m.source}")


def _integrate(arguments: argparse.Namespace) -> None:
    q0 = attitudes("--q0", np.array(arguments.q0), "(4,)")
    choice("--method", arguments.method, methods_for_samples())
    if Path(arguments.log).is_dir():
        raise ValueError(f"LOG: found the directory {arguments.log}; accepted: a file")
    piped = arguments.log == "-"
    name = "log" if piped else arguments.log.removesuffix(".gz")
    out = arguments.out or Path(name).with_suffix(".attitudes.csv")
    read = {"LOG": None if piped else arguments.log, "--reference": arguments.reference}
    for what, path in read.items():
        if path is not None and out.exists() and out.samefile(path):
            raise ValueError(f"--out: found {out}, which is {what}; accepted: another file")
    write = attitude_file(out)
    said = ("columns", "unit", "rate", "time_column", "time_unit", "on_bad_rows", "max_gap")
    given = {name: getattr(arguments, name) for name in (*said, "bias_seconds")}
    reference = arguments.reference and read_attitudes(arguments.reference)
    method, split = arguments.method, arguments.on_bad_rows == "split"
    log = read_gyro_log(arguments.log, progress=_bar_wanted(arguments.quiet), **given)
    rows = attitude_rows(log, q0, method, pieces=split)
    write(rows)
    print(log.summary)
    n = len(rows)
    print(f"{out}: {n} attitudes by {method}, body to inertial, scalar first")
    if not (arguments.compare or reference) or n == 1:
        return
    if len(log.pieces) > 1:
        raise ValueError(
            f"--on-bad-rows: found {len(log.pieces)} pieces; accepted with --compare and "
            "--reference: one"
        )
    if reference:
        print(against_reference(log.t, rows[:, 1:5], reference, log.start))
    if arguments.compare:
        print("comparing with the other methods ...", flush=True)
        print(compare_on_log(log, method))


def _own_scene(arguments: argparse.Namespace) -> Scene | None:
    """The scene that the options describe; None without such options."""
    given = {name: getattr(arguments, name) for name in ("inertia", "torque", "rate", "frame")}
    words = {name: value for name, value in given.items() if value is not None}
    if arguments.scene_file is not None:
        if words:
            raise ValueError(
                f"--scene-file: found with --{next(iter(words))}; accepted: one of them"
            )
        return read_scene(arguments.scene_file)
    for kind in ("torque", "rate"):
        if kind in words:
            words[kind] = from_words(kind, words[kind])
    if "inertia" in words:
        found = np.array(words["inertia"])
        if found.size not in (3, 9):
            raise ValueError(f"--inertia: found {found.size} numbers; accepted: 3 or 9")
        words["inertia"] = found.reshape((3, 3) if found.size == 9 else 3)
    return Scene(**words) if words else None


def _ensemble(arguments: argparse.Namespace, scene: Scene) -> tuple[Any, Any]:
    """Attitudes and, for bodies, angular velocities: from files, else random."""
    generator = np.random.default_rng(0)
    q0 = None if arguments.q0 is None else read_rows("--q0", arguments.q0, 4)
    w0 = None if arguments.w0 is None else read_rows("--w0", arguments.w0, 3)
    rows = [len(x) for x in (q0, w0) if x is not None and x.ndim == 2]
    n = max(rows) if rows else whole("--bodies", arguments.bodies, 1)
    if q0 is None:
        q0 = generator.normal(size=(n, 4))
    if w0 is None and scene.kind != "rate":
        spin = 1.0 if arguments.spin is None else real("--spin", arguments.spin)
        w0 = spin * generator.normal(size=(n, 3))
    return q0, w0


def _recommend(arguments: argparse.Namespace) -> None:
    scene = _own_scene(arguments)
    if scene is None:
        raise ValueError("no scene: accepted: --inertia, --rate or --scene-file")
    q0, w0 = _ensemble(arguments, scene)
    names = ("t_end", "tol", "budget", "at", "methods")
    asked = {name: getattr(arguments, name) for name in names}
    print(recommend(scene, q0, w0, progress=_bar_wanted(arguments.quiet), **asked))


def _trade_own(arguments: argparse.Namespace, scene: Scene) -> None:
    """Measure work and precision on the user's scene."""
    for name in ("scene", "log"):
        if getattr(arguments, name) is not None:
            raise ValueError(f"--{name}: found with a given scene; accepted: one of them")
    if arguments.t_end is None:
        raise ValueError("--t-end: is missing; a given scene needs its duration, s")
    q0, w0 = _ensemble(arguments, scene)
    out: Path = arguments.out
    open_folder(out)
    quick = arguments.quick
    found = work_precision(
        scene, q0, w0, t_end=arguments.t_end, methods=arguments.methods,
        dtypes=("float64",) if quick else ("float64", "float32"), repeats=1 if quick else 3,
        max_seconds=5.0 if quick else 60.0, progress=_bar_wanted(arguments.quiet),
    )  # fmt: skip
    print(found)
    for ending, write in ((".csv", found.to_csv), (".json", found.to_json), (".png", found.plot)):
        write(out / f"work_precision{ending}")
    print(f"\n{out}: work_precision.csv, work_precision.json, work_precision.png")


def _trade(arguments: argparse.Namespace) -> None:
    own = _own_scene(arguments)
    if own is not None:
        _trade_own(arguments, own)
        return
    for name in ("t_end", "q0", "w0", "spin"):
        if getattr(arguments, name) is not None:
            raise ValueError(
                f"--{name.replace('_', '-')}: found without a given scene; accepted: with "
                "--inertia, --rate or --scene-file"
            )
    scenes = arguments.scene or DEFAULT_SCENES
    run_trade(
        arguments.out, scenes=SCENES if _ALL in scenes else scenes, methods=arguments.methods,
        logs=arguments.log, n_bodies=arguments.bodies, quick=arguments.quick,
        progress=_bar_wanted(arguments.quiet),
    )  # fmt: skip
