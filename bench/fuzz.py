"""Hostile input to every public function, to the log reader and to ``fastatt integrate``.

``python bench/fuzz.py --inputs 100000 --seed 1`` prints what was tried and what was found. A call
passes when it gives back finite numbers and unit attitudes (of each body with status 0, and right
ones where the right ones are known), or refuses in one line that names the argument. Anything else
is a finding: another exception, a warning but ``StepWarning``, more than 5 s, numbers that are not
finite with status 0, a log read otherwise than it was written.
"""

from __future__ import annotations

import argparse
import contextlib
import datetime as dt
import faulthandler
import gzip
import io
import math
import os
import random
import re
import sys
import tempfile
import time
import warnings
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from decimal import Decimal
from fractions import Fraction
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import fastatt as fa
from fastatt import cli, gyrolog

SLOW = 5.0  # s; a call that takes longer twice hangs
HUNG = 300.0  # s, after which the process shows where it is and ends
REFUSALS = (ValueError, TypeError)
ONE = (1.0, 0.0, 0.0, 0.0)
SPECIAL = (
    math.nan, math.inf, -math.inf, 0.0, -0.0, 5e-324, -5e-324, 1e-310, 1e-300, 1e-160, 1e-154,
    1e154, 1e160, 1e300, 1e308, -1e308, 1.7976931348623157e308, 1e38, 1e39, 1e-38, 1e-45, 1e16,
    2.0**53, 2.0**63, math.pi, 2.0 * math.pi, 1e6,
)  # fmt: skip


class Anything:
    """No number, no array."""


class Indexed:
    """A whole number by its own word."""

    def __index__(self) -> int:
        return 3


class Sparse:
    """Two-dimensional by its shape alone, as sparse matrices are."""

    shape = (2, 4)
    ndim = 2

    def toarray(self) -> NDArray[np.float64]:
        return np.ones((2, 4))


ODD: tuple[Any, ...] = (
    None, "", "1", "0.5", "nan", "north", b"\x00\xff", True, False, 1j, 1 + 0j, [], (), {}, {1: 2},
    set(), Ellipsis, NotImplemented, Anything, Anything(), Indexed(), Sparse(), len, np, range(4),
    10**400, -(10**400), 2**63, 2**64, Decimal("1.5"), Decimal("NaN"), Fraction(1, 3),
    dt.date(2020, 1, 1), dt.timedelta(1), np.datetime64("2020-01-01"),
    np.timedelta64(5, "s"), np.float16(2.0), np.longdouble(3.0), np.longdouble("1e4000"),
    np.int8(3), np.uint64(2**64 - 1), np.bool_(True), np.str_("x"), np.void(b"abcd"),
    np.array(0.1), np.array([0.1]), np.array([[0.1]]), np.array(None), np.array("x"),
    np.array([], dtype=float), np.zeros((0, 4)), np.zeros((0, 3)), np.ma.masked,
    np.array([(1.0, 2)], dtype=[("a", "f8"), ("b", "i4")]), [[1.0], [1.0, 2.0]], [1.0, None],
    ["a", "b", "c", "d"], [[[]]], [math.nan], np.eye(3).view(np.matrix), {"q": 1.0},
    slice(3), memoryview(b"12345678"), bytearray(8), frozenset({1}), "a\nb", Exception("x\ny"),
)  # fmt: skip
WORDS: tuple[Any, ...] = (
    "", "RK4", "rk4 ", "rk4\n", "magnus4", "quat", "dcm", "output", "body", "hold", "exact",
    "\u2028", "x" * 5000, b"rk4", 4, None, ("rk4",), ["rk4"], True, Anything, {}, np.str_("rk4"),
)  # fmt: skip


NO_METHODS = [w for w in WORDS if not (w is None or (isinstance(w, str) and w in fa.METHODS))]


class Call(NamedTuple):
    """Something to be tried: what is called, with what, and what is wrong with its result."""

    function: Callable[..., Any]
    arguments: tuple[Any, ...]
    options: Mapping[str, Any]
    judge: Callable[[Any], str | None]
    names: tuple[str, ...]
    refusals: tuple[type[BaseException], ...] = REFUSALS


class Draw:
    """Hostile values, of one seed."""

    def __init__(self, seed: int) -> None:
        self.rng = np.random.default_rng(seed)
        self.random = random.Random(seed)

    def one(self, values: Iterable[Any]) -> Any:
        return self.random.choice(list(values))

    def chance(self, p: float) -> bool:
        return self.random.random() < p

    def numbers(self, shape: tuple[int, ...]) -> NDArray[np.float64]:
        """Floats of a shape: tame, of wild sizes, or with a special number among them."""
        x = np.asarray(self.rng.standard_normal(shape))
        kind = self.random.random()
        if kind < 0.15:
            x *= 10.0 ** self.rng.uniform(-308, 307)
        elif kind < 0.25:
            x *= 10.0 ** self.rng.integers(-300, 300, size=shape)
        elif kind < 0.5 and x.size:
            for _ in range(self.one((1, 1, 2, x.size))):
                x.flat[self.random.randrange(x.size)] = self.one(SPECIAL)
        elif kind < 0.55:
            x[...] = self.one(SPECIAL)
        elif kind < 0.6:
            x = np.asarray(np.round(x))
        return x

    def shape(self, shapes: Iterable[tuple[int, ...]]) -> tuple[int, ...]:
        """One of the shapes, or one with an axis more, less, longer or empty."""
        shape = list(self.one(shapes))
        if self.chance(0.12):
            how = self.random.randrange(5)
            at = self.random.randrange(len(shape) + 1)
            if how == 0:
                shape.insert(at, self.one((0, 1, 2, 3)))
            elif how == 1 and shape:
                shape.pop(at - 1)
            elif how == 2 and shape:
                shape[at - 1] += 1
            elif how == 3 and shape:
                shape[at - 1] = 0
            else:
                shape.reverse()
        return tuple(shape)

    def array(self, *shapes: tuple[int, ...]) -> Any:
        """Numbers of about one of these shapes, in any dress, or something that is none."""
        if self.chance(0.06):
            return self.one(ODD)
        return self.dressed(self.numbers(self.shape(shapes)))

    def dressed(self, x: NDArray[np.float64]) -> Any:
        dress = self.random.randrange(40)
        with np.errstate(all="ignore"):
            if dress < 12:
                return x
            if dress < 20:
                return x.tolist()
            if dress in _DRESSES:
                return _DRESSES[dress](x)
        if dress == 36 and x.ndim and x.size:
            ragged = x.tolist()
            ragged[self.random.randrange(len(ragged))] = self.one(([], None, "x", [1.0]))
            return ragged
        if dress == 37:
            return np.ma.array(x, mask=self.rng.random(x.shape) < 0.5)
        return x

    def real(self, tame: float = 0.1) -> Any:
        """A number of about the size of ``tame``, or not."""
        kind = self.random.random()
        if kind < 0.55:
            return tame * self.random.uniform(0.1, 3.0)
        if kind < 0.7:
            return self.one(SPECIAL)
        if kind < 0.8:
            return self.random.choice((-1, 1)) * 10.0 ** self.random.uniform(-308, 308)
        if kind < 0.9:
            return self.one((np.float32, np.float64, np.float16, Decimal, str, np.array))(tame)
        return self.one(ODD)

    def whole(self, most: int = 5) -> Any:
        """A whole number of at most ``most``, or not a number."""
        if self.chance(0.8):
            return self.one((int, int, np.int64, np.uint8))(self.random.randrange(1, most + 1))
        return self.one((0, -1, -(2**70), 2.0, 1.5, "3", None, True, math.nan, Indexed(), 1j, [1]))

    def word(self, *words: str) -> Any:
        return self.one(words) if self.chance(0.9) else self.one(WORDS)


_DRESSES: dict[int, Callable[[NDArray[Any]], Any]] = {
    20: lambda x: x.astype(np.float32),
    21: lambda x: x.astype(np.float16),
    22: lambda x: x.astype(np.longdouble),
    23: lambda x: x.astype(">f8"),
    24: lambda x: x.astype(">f4"),
    25: lambda x: np.asfortranarray(x),
    26: lambda x: np.repeat(x, 2, axis=-1)[..., ::2] if x.ndim else x,
    27: lambda x: x[::-1] if x.ndim else x,
    28: lambda x: _read_only(x),
    29: lambda x: np.nan_to_num(x, posinf=9, neginf=-9).clip(-9, 9).astype(np.int64),
    30: lambda x: x.astype(object),
    31: lambda x: x.astype(complex),
    32: lambda x: x > 0,
    33: lambda x: x.astype(str),
    34: lambda x: tuple(x) if x.ndim else x,
    35: lambda x: np.nan_to_num(x).clip(0, 9).astype("M8[s]"),
    38: lambda x: x.astype(np.longdouble) * np.longdouble("1e4000"),
    39: lambda x: np.broadcast_to(x, (2, *x.shape)),
}


def _read_only(x: NDArray[Any]) -> NDArray[Any]:
    x.flags.writeable = False
    return x


def floats(x: Any) -> NDArray[np.float64] | None:
    """What was given as finite floats, or None."""
    try:
        if np.ma.isMaskedArray(x) and np.ma.is_masked(x):
            return None
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            found = np.asarray(x)
            found = found.astype(np.float64) if found.dtype.kind in "fiu" else None
    except (TypeError, ValueError, OverflowError):
        return None
    return found if found is not None and np.isfinite(found).all() else None


# judges: what is wrong with a result, or None


def unit(q: Any, tolerance: float | None = None) -> str | None:
    if not isinstance(q, np.ndarray) or q.shape[-1:] != (4,):
        return "no array of quaternions"
    if not np.isfinite(q).all():
        return "attitudes not finite"
    with np.errstate(all="ignore"):
        far = np.abs(np.linalg.norm(q.astype(np.float64), axis=-1) - 1.0).max(initial=0.0)
    allowed = tolerance or 64.0 * float(np.finfo(q.dtype).eps)
    return f"attitudes not unit, by {far:.0e}" if far > allowed else None


def trajectory(traj: Any, *, raw: bool = False) -> str | None:
    """Every body with status 0 is finite, and its attitudes are unit, but for ``raw`` ones."""
    bodies = np.flatnonzero(traj.status == 0)
    if not bodies.size:
        return None
    q = traj.q[:, None] if traj.one_body else traj.q
    for name in ("q", "w", *[n for n in ("v", "r") if n in traj.carried]):
        x = q if name == "q" else getattr(traj, name)
        x = x[:, None] if traj.one_body and name != "q" else x
        if not np.isfinite(x[:, bodies]).all():
            return f"status 0, {name} not finite"
    return unit(q[:, bodies], 1e-2 if raw else None)


def _same_angle(traj: Any, q0: Any, w: Any, steps: int, inertial: bool) -> str | None:
    """Of a constant rate: the closed form, where its argument is well-conditioned."""
    start, rate = floats(q0), floats(w)
    if start is None or rate is None or not (traj.status == 0).any():
        return None
    start, rate = np.atleast_2d(start), np.atleast_2d(rate)
    with np.errstate(all="ignore"):
        turn = rate * (traj.dt * steps)
        sane = (np.abs(turn) < 1e3).all() & (np.abs(start).max(-1) > 1e-30).all()
        sane &= (np.abs(start) < 1e30).all()
        if not sane:
            return None
        half = 0.5 * np.linalg.norm(turn, axis=-1, keepdims=True)
        u = np.concatenate([np.cos(half), 0.5 * np.sinc(half / np.pi) * turn], axis=-1)
    q0 = start / np.linalg.norm(start, axis=-1, keepdims=True)
    right = fa.quat_multiply(u, q0) if inertial else fa.quat_multiply(q0, u)
    q = np.atleast_2d(traj.q[-1])
    off = np.asarray(fa.angle_between(q.astype(np.float64), right))
    off = off[np.broadcast_to(traj.status == 0, off.shape)].max(initial=0.0)
    allowed = 1e-10 if q.dtype == np.float64 else 3e-3
    if traj.method != "magnus4":
        allowed = 0.3
    return f"status 0, wrong by {off:.0e} rad" if off > allowed else None


def _free_invariants(q: Any, w: Any, moments: Any, ok: Any) -> str | None:
    """|I w| and energy are those of the start: (S, N, 3)."""
    with np.errstate(all="ignore"):
        m = w.astype(np.longdouble) * moments
        for name, x in (("energy", (m * w).sum(-1)), ("momentum", (m * m).sum(-1))):
            far = np.abs(x - x[:1])[:, ok] > 0.05 * np.abs(x[:1])[:, ok]
            if far.any():
                return f"status 0, {name} changed"
    return None


def anything(result: Any) -> str | None:
    return None


# targets


def run_options(d: Draw, kinds: tuple[str | None, ...] = (None,)) -> dict[str, Any]:
    options: dict[str, Any] = {"dt": d.real(), "n_steps": d.whole(), "n_threads": 1}
    if d.chance(0.6):
        options["save_every"] = d.one((1, 2, None, d.whole()))
    for name, p, value in (
        ("t0", 0.1, lambda: d.real(1.0)),
        ("n_threads", 0.05, d.whole),
        ("invalid", 0.2, lambda: d.word("raise", "flag")),
        ("normalise", 0.1, lambda: d.one(("output", "never", 2, d.whole(), d.one(WORDS)))),
        ("representation", 0.03, lambda: d.one(WORDS)),
        ("compensated", 0.02, lambda: d.one((False, 0, None))),
        ("sink", 0.02, lambda: d.one((str, 3, "x"))),
    ):
        if d.chance(p):
            options[name] = value()
    options["dtype"] = d.one(kinds) if d.chance(0.97) else d.one((int, "f2", "x", 7, [], object))
    return options


class Run(NamedTuple):
    """A scene that is propagated: its model, the method and its representation are compiled."""

    scene: Callable[[Draw], fa.Scene]
    method: str
    representation: str = "quat"
    kinds: tuple[str | None, ...] = ("float64",)


def moments(d: Draw, *shape: int) -> NDArray[np.float64]:
    """Principal moments that a body can have, of wild sizes too."""
    scale = 10.0 ** d.rng.uniform(-300, 300) if d.chance(0.3) else 1.0
    return scale * d.rng.uniform(1.0, 1.6, size=shape)


def constant_rate(d: Draw) -> fa.Scene:
    frame = d.one(("body", "inertial"))
    return fa.Scene(rate=fa.rates.Constant(d.numbers(d.one(((3,), (2, 3))))), frame=frame)


def free_body(d: Draw) -> fa.Scene:
    return fa.Scene(inertia=moments(d, *d.one(((3,), (2, 3)))))


def damped_body(d: Draw) -> fa.Scene:
    return fa.Scene(inertia=moments(d, 3), torque=fa.torques.Damping(float(d.numbers(()))))


def moving_body(d: Draw) -> fa.Scene:
    mass = float(moments(d))
    return fa.Scene(inertia=moments(d, 3), mass=mass, force=d.numbers((3,)))


RUNS = (
    Run(constant_rate, "magnus4", kinds=("float64", "float32", None)),
    Run(constant_rate, "rk4", "euler313"),
    Run(free_body, "exact"),
    Run(free_body, "dmv4"),
    Run(free_body, "strang2"),
    Run(damped_body, "rk4", "dcm"),
    Run(moving_body, "rk8"),
)
ARGUMENTS = (
    "scene", "q0", "w0", "v0", "r0", "dt", "n_steps", "method", "representation", "save_every",
    "dtype", "n_threads", "t0", "compensated", "normalise", "invalid", "sink", "rate", "inertia",
    "params", "frame", "torque", "mass", "force", "every",
)  # fmt: skip


def propagated(d: Draw, runs: tuple[Run, ...]) -> Call:
    run = d.one(runs)
    scene: Any = None
    while scene is None:
        with contextlib.suppress(ValueError), np.errstate(all="ignore"):
            scene = run.scene(d)
    q0 = d.array((4,), (2, 4), (2, 4))
    options = {"method": run.method, "representation": run.representation}
    options |= run_options(d, run.kinds)
    if options["representation"] is None or options["representation"] != run.representation:
        options["method"] = None if d.chance(0.5) else run.method
        options["representation"] = "matrix"
    if d.chance(0.04):
        options["method"] = d.one(NO_METHODS)
    w0 = None
    if scene.kind != "rate" or d.chance(0.02):
        w0 = d.array((3,), (2, 3))
    if scene.moves or d.chance(0.02):
        options["v0"] = d.array((3,), (2, 3))
    if d.chance(0.02):
        scene = d.one((scene.rate, None, "scene", fa.Scene, 3))

    def judge(traj: Any) -> str | None:
        if traj is None:
            return "gave None"
        wrong = trajectory(traj, raw=options.get("normalise") == "never")
        if wrong is None and isinstance(scene.rate, fa.rates.Constant):
            wrong = _same_angle(
                traj, q0, scene.rate.w, int(options["n_steps"]), scene.frame == "inertial"
            )
        if wrong is None and scene.kind in ("free", "symmetric", "spherical"):
            w = traj.w[:, None] if traj.one_body else traj.w
            wrong = _free_invariants(None, w, scene.principal.moments, traj.status == 0)
        return wrong

    return Call(fa.propagate, (scene, q0, w0), options, judge, ARGUMENTS)


def directed(d: Draw, runs: tuple[Run, ...]) -> Call:
    w = np.nan_to_num(d.numbers((3,)), posinf=1.0, neginf=-1.0)
    options = run_options(d)
    options = {
        k: options[k] for k in ("dt", "n_steps", "n_threads", "save_every", "t0") if k in options
    }
    options["dtype"] = np.float64
    options["method"] = "magnus4" if d.chance(0.95) else d.one(NO_METHODS)
    v0 = d.array((3,), (2, 3), (1, 2, 3))
    return Call(
        fa.propagate_directions,
        (fa.Scene(rate=fa.rates.Constant(w)), v0),
        options,
        anything,
        ARGUMENTS,
    )


MODELS = {
    module: [getattr(module, name) for name in module.__all__]
    for module in (fa.rates, fa.torques, fa.forces)
}
_SHAPES = ((), (3,), (2, 3), (4,), (2,), (2, 2, 3))


def modelled(d: Draw, module: Any) -> Any:
    """A model with hostile numbers, in the shapes that its fields have or not."""
    if d.chance(0.05):
        return d.one((*ODD, fa.rates.Constant, fa.rates.Constant(ONE[:3]), fa.torques.Free()))
    cls = d.one(MODELS[module])
    if cls.__name__ == "Sum":
        terms = [modelled(d, module) for _ in range(d.random.randrange(3))]
        return cls(d.one((terms, tuple(terms), tuple(terms), (3,), None, "ab", 5)))
    if cls.__name__ == "Custom":
        return cls(d.one((3, None, "f", len, Anything, Anything())), d.array((2,), (2, 2)))
    names = cls._fields
    by_name = {
        "w": ((3,), (2, 3)), "coefficients": ((3,), (2, 3), (2, 2, 3)), "bias": ((3,), (2, 3)),
        "amplitude": ((3,),), "rotation": ((3,), (2, 3)), "torque": ((3,), (2, 3)),
        "force": ((3,), (2, 3)), "radial": ((3,),), "along": ((3,),), "arm": ((3,),),
        "dipole": ((3,), (2, 3)), "field": ((3,),), "target": ((4,), (2, 4)),
        "momentum": ((3,), (2, 3)), "torques": ((4, 3), (1, 3)),
    }  # fmt: skip
    return cls(
        *[d.array(*by_name.get(n, ((), (), (2,))) if d.chance(0.9) else _SHAPES) for n in names]
    )


def inertia(d: Draw) -> Any:
    kind = d.random.random()
    if kind < 0.4:
        return d.dressed(moments(d, *d.one(((3,), (2, 3)))))
    if kind < 0.7:
        a = d.rng.standard_normal(d.one(((3, 3), (2, 3, 3))))
        tensor = np.eye(3) * 3.0 + 0.2 * (a + np.swapaxes(a, -1, -2))
        if d.chance(0.3):
            tensor = tensor * d.numbers((3, 3))
        return d.dressed(tensor * (10.0 ** d.rng.uniform(-300, 300) if d.chance(0.3) else 1.0))
    return d.array((3,), (2, 3), (3, 3), (2, 3, 3))


def scened(d: Draw) -> Call:
    options: dict[str, Any] = {}
    if d.chance(0.5):
        options["rate"] = modelled(d, fa.rates)
    if not options or d.chance(0.05):
        options["inertia"] = inertia(d)
        if d.chance(0.5):
            options["torque"] = modelled(d, fa.torques)
        if d.chance(0.3):
            options["mass"] = d.array((), (), (2,))
            options["force"] = modelled(d, fa.forces) if d.chance(0.5) else d.array((3,))
    for name, p, value in (
        ("params", 0.04, lambda: d.array((2,), (2, 2))),
        ("frame", 0.1, lambda: d.word("body", "inertial")),
        ("allow_unphysical", 0.1, lambda: d.one((True, False, None, 1))),
    ):
        if d.chance(p):
            options[name] = value()

    def judge(scene: Any) -> str | None:
        if scene.kind not in ("rate", "spherical", "symmetric", "free", "torqued"):
            return f"kind {scene.kind}"
        params = scene.packed(None).params
        return None if np.isfinite(params).all() else "parameters not finite"

    names = (*ARGUMENTS, *[m.__name__ for own in MODELS.values() for m in own])
    return Call(fa.Scene, (), options, judge, names)


def closed_form(d: Draw) -> Call:
    top = d.chance(0.3)
    function = fa.exact.symmetric_top if top else fa.exact.free_body
    q0, w0 = d.array((4,), (2, 4)), d.array((3,), (2, 3))
    body = inertia(d)
    if top and d.chance(0.6):
        body = moments(d) * np.array(d.one(((1.0, 1.0, 0.7), (0.8, 1.0, 1.0), (1, 1, 1))))
    t = d.array((), (), (3,))
    options: dict[str, Any] = {"n_threads": 1, "dtype": np.float64}
    if d.chance(0.1):
        options["dtype"] = d.one(("f8", int, "x", 3))
    if d.chance(0.3):
        options["invalid"] = d.word("raise", "flag")
    if d.chance(0.1):
        options["allow_unphysical"] = d.one((True, False, 1, None))

    def judge(result: Any) -> str | None:
        q, w = result
        given = [floats(x) for x in (q0, w0, t)]
        if any(x is None for x in given):
            return None  # flagged by NaN
        if not np.abs(given[0]).max(-1).all():
            return None
        bad = ~(np.isfinite(q).all(-1) & np.isfinite(w).all(-1))
        with np.errstate(all="ignore"):
            fastest = np.abs(given[1]).max()
            turn = fastest * np.abs(given[2]).max(initial=0.0)
        if bad.any():  # squares of momenta overflow, and so does the angle
            return None if fastest > 1e50 or turn > 1e16 else "not finite"
        return unit(q)

    names = ("q0", "w0", "inertia", "t", "dtype", "n_threads", "invalid", "allow_unphysical")
    return Call(function, (q0, w0, body, t), options, judge, names)


CONVERSIONS: tuple[tuple[Callable[..., Any], tuple[tuple[int, ...], ...], str, str], ...] = (
    (fa.quat_to_dcm, ((4,), (5, 4), (2, 3, 4)), "q", ""),
    (fa.dcm_to_quat, ((3, 3), (2, 3, 3)), "C", ""),
    (fa.euler313_to_quat, ((3,), (2, 3)), "angles", "unit"),
    (fa.quat_to_euler313, ((4,), (2, 4)), "q", "finite"),
    (fa.rotation_vector_to_quat, ((3,), (2, 3)), "u", "unit"),
    (fa.quat_to_rotation_vector, ((4,), (2, 4)), "q", "turn"),
)


def converted(d: Draw) -> Call:
    function, shapes, name, promise = d.one(CONVERSIONS)
    x = d.array(*shapes)

    def judge(result: Any) -> str | None:
        given = floats(x)
        if given is None or not promise:
            return None
        if name == "q" and not np.abs(given).max(-1, initial=0.0).all():
            return None
        if promise == "finite" and unit(given, 1e-3):
            return None
        if promise == "unit":
            return unit(result)
        if not np.isfinite(result).all():
            return "not finite"
        most = np.linalg.norm(result.astype(float), axis=-1).max(initial=0.0)
        return f"{most} rad" if promise == "turn" and most > math.pi * (1.0 + 1e-6) else None

    return Call(function, (x,), {}, judge, (name,))


def combined(d: Draw) -> Call:
    function, names = d.one((
        (fa.quat_multiply, ("p", "q")), (fa.rotate, ("q", "v")), (fa.rotate_inverse, ("q", "v")),
        (fa.angle_between, ("a", "b")), (fa.angle_between, ("a", "b")),
    ))  # fmt: skip
    second = (3,) if "v" in names else (4,)
    shapes = ((4,), (2, 4), (3, 1, 4), (3, 3)) if names[0] == "a" else ((4,), (2, 4), (3, 1, 4))
    a = d.array(*shapes)
    b = d.array(second, (2, *second), (1, 2, *second))

    def judge(result: Any) -> str | None:
        given = floats(a), floats(b)
        if names[0] != "a" or any(x is None or x.shape[-1:] != (4,) for x in given):
            return None
        if not all(np.abs(x).max(-1, initial=0.0).all() for x in given):
            return None
        good = np.isfinite(result) & (result >= 0.0) & (result <= math.pi * (1.0 + 1e-6))
        return None if np.all(good) else f"angle {result}"

    return Call(function, (a, b), {}, judge, names)


METHODS = ("hold", "trapezoid", "previous", "coning2", "coning3")


def integrated(d: Draw, methods: tuple[str, ...] = METHODS) -> Call:
    n = d.one((1, 2, 3, 5, 8))
    rates = d.array((n, 3), (n, 3), (2, n, 3))
    options: dict[str, Any] = {"n_threads": 1, "dtype": np.float64}
    options["method"] = d.one(methods) if d.chance(0.95) else d.one((*WORDS, "rk4"))
    if options["method"] not in methods:
        options["method"] = d.one(("rk4", "", None, 3, "x\ny"))
    dt = d.real() if d.chance(0.6) else d.array((n - 1,), (n,))
    for name, p, value in (
        ("q0", 0.3, lambda: d.array((4,), (2, 4))),
        ("max_gap", 0.2, lambda: d.real(10.0)),
        ("n_threads", 0.05, d.whole),
        ("dtype", 0.03, lambda: d.one((int, "x", "f2"))),
        ("out", 0.1, lambda: d.one((np.empty((n, 4)), np.empty((n, 4), "f4"), 3, [], "x"))),
        ("increments", 0.05, lambda: d.one((0, None, False))),
    ):
        if d.chance(p):
            options[name] = value()
    names = ("rates", "dt", "q0", "method", "dtype", "n_threads", "max_gap", "out")
    return Call(fa.integrate_rates, (rates, dt), options, unit, names)


def differentiated(d: Draw) -> Call:
    n = d.one((3, 5, 6, 9))
    q = d.array((n, 4), (n, 4), (n, 2, 4))
    dt = d.real() if d.chance(0.7) else d.array((n - 1,), (n,))
    options: dict[str, Any] = {}
    if d.chance(0.3):
        options["frame"] = d.word("body", "inertial")
    if d.chance(0.3):
        options["order"] = d.whole()

    def judge(w: Any) -> str | None:
        step = floats(dt)
        if step is None or not ((step > 1e-100) & (step < 1e100)).all():
            return None
        return None if np.isfinite(w).all() else "not finite"

    return Call(fa.angular_velocity, (q, dt), options, judge, ("q", "dt", "frame", "order"))


def energetic(d: Draw) -> Call:
    which = d.random.randrange(4)
    w, body = d.array((3,), (2, 3), (4, 2, 3)), inertia(d)
    names: tuple[str, ...] = ("w", "inertia", "q")
    if which == 0:
        q = {"q": d.array((4,), (2, 4))} if d.chance(0.5) else {}
        return Call(fa.angular_momentum, (w, body), q, anything, names)
    if which == 1:
        return Call(fa.kinetic_energy, (w, body), {}, anything, names)
    if which == 2:
        args = (d.array((3,), (2, 3)), d.array((3,), (2, 3)), d.array((2,)))
        names = ("angles", "rates", "inertia")
        return Call(fa.kinetic_energy_symmetric, args, {}, anything, names)
    scene = d.one((TOP, TOP, NO_POTENTIAL, None, 3))
    t = {"t": d.array((), (2,))} if d.chance(0.5) else {}
    args = (scene, d.array((4,), (2, 4), (2, 2, 4)))
    return Call(fa.potential_energy, args, t, anything, ("scene", "q", "t"))


TOP = fa.Scene(inertia=(1.0, 1.0, 0.6), torque=fa.torques.HeavyTop((0.0, 0.0, 0.1), 2.0))
NO_POTENTIAL = fa.Scene(inertia=(1.0, 1.0, 0.6), torque=fa.torques.Damping(0.1))


def drifted(d: Draw) -> Call:
    odd = d.one((*ODD, TOP))
    return Call(fa.drift, (odd, d.one((TOP, *ODD))), {}, anything, ("trajectory", "scene"))


def listed(d: Draw) -> Call:
    scene = d.one((TOP, NO_POTENTIAL, fa.Scene(rate=fa.rates.Constant((0.0, 0.0, 1.0)))))
    if d.chance(0.3):
        scene = d.one(ODD)
    if d.chance(0.5):
        return Call(fa.methods_for, (scene, d.word("quat", "dcm")), {}, anything, ARGUMENTS)
    options = {
        "method": d.word("rk4", "rk8"),
        "representation": d.word("quat", "dcm"),
        "dtype": d.one((np.float64, "f4", "x", None, 3, [])),
    }
    return Call(fa.single_step, (scene,), options, anything, ("scene", *ARGUMENTS))


# logs


class Log(NamedTuple):
    """A log as written: its bytes, how it is read, and what was meant (None: not known)."""

    content: bytes
    options: Mapping[str, Any]
    rates: NDArray[np.float64] | None
    t: NDArray[np.float64] | None


_NAMES = (
    ("Gyr_X", "Gyr_Y", "Gyr_Z"), ("gyro x", "gyro y", "gyro z"), ("wx", "wy", "wz"),
    ("Gyroscope X (deg/s)", "Gyroscope Y (deg/s)", "Gyroscope Z (deg/s)"),
    ("Gyr_X [mdps]", "Gyr_Y [mdps]", "Gyr_Z [mdps]"), ("wx (deg/h)", "wy (deg/h)", "wz (deg/h)"),
    ("omega_x", "omega_y", "omega_z"), ("rate_x (rad/s)", "rate_y (rad/s)", "rate_z (rad/s)"),
    ("gx\u2028", "gy\x0b", "gz"), ("a", "b", "c"),
)  # fmt: skip
_CLOCKS = {"t": 1.0, "Time (s)": 1.0, "t_ms": 1e-3, "timestamp us": 1e-6, "time [ns]": 1e-9}
_DEGREES = math.pi / 180.0
# rad/s, where the names say
_SCALES = {"deg/s": _DEGREES, "mdps": 1e-3 * _DEGREES, "deg/h": _DEGREES / 3600.0}


def log_file(d: Draw) -> Log:
    """A log of some dialect, that means what it says."""
    n = d.one((2, 3, 5, 12, 17))
    rates = np.round(d.rng.standard_normal((n, 3)), d.one((2, 6, 17)))
    names = d.one(_NAMES)
    clock = d.one((*_CLOCKS, None))
    stamps = np.cumsum(d.rng.integers(1, 4, size=n)) * d.one((1.0, 10.0, 0.25))
    columns = [list(map(repr, x.tolist())) for x in rates.T]
    head = list(names)
    if clock:
        head.insert(0, clock)
        columns.insert(0, list(map(repr, stamps.tolist())))
    if d.chance(0.15):  # an index without a name, as data frames write it
        head.insert(0, "")
        columns.insert(0, [str(i) for i in range(n)])
    if d.chance(0.15):
        head.append("note")
        columns.append([d.one(("1", "", "0.0")) for _ in range(n)])
    # between blanks a column without a name or a number does not show
    whole = "" not in head and "note" not in head
    separator = d.one((",", ",", ";", "\t", " ", "  ") if whole else (",", ";", "\t"))
    quote = '"' if d.chance(0.1) else ""
    lines = [
        separator.join(f"{quote}{x}{quote}" for x in row) for row in zip(*columns, strict=True)
    ]
    if d.chance(0.05):
        lines = [x.replace(".", ",") for x in lines]
    if d.chance(0.2):
        lines = [x + separator for x in lines]
    for _ in range(d.one((0, 0, 1, 5))):
        lines.insert(d.random.randrange(len(lines)), d.one(("", "# note", "   ", "// x", "%")))
    has_names = d.chance(0.9)
    if has_names:
        lines.insert(0, separator.join(f"{quote}{x}{quote}" for x in head))
    rate = None
    if d.chance(0.2):
        text, rate = d.one(_RATES)
        lines.insert(0, f"// Sample rate: {text}")
    end = d.one(("\n", "\n", "\r\n", "\r"))
    text = end.join(lines) + (end if d.chance(0.7) else "")
    encoding = d.one(("utf-8", "utf-8", "utf-8", "utf-8-sig", "latin-1", "utf-16"))
    options: dict[str, Any] = {}
    if d.chance(0.3) or (clock is None and rate is None):
        options["rate"], rate = 50.0, 50.0
    elif clock:
        rate = None
    t = stamps * _CLOCKS[clock] if clock and rate is None else None
    if t is None and rate:
        t = np.arange(n) / rate
    scale = next((k for name, k in _SCALES.items() if name in names[0]), 1.0)
    return Log(text.encode(encoding, "replace"), options, rates * scale, t)


_RATES = (
    ("50.0Hz", 50.0), ("100 Hz", 100.0), ("1e3 Hz", 1e3), ("1,000 Hz", 1e3), ("0.1 kHz", 100.0),
    ("1..5", None), (".", None), ("fast", None), ("0", None), ("-50 Hz", None),
    ("\u0665\u0660", 50.0), ("9" * 400, None),
)  # fmt: skip
_BYTES = (
    b"", b"\x00", b"\n", b"\x00" * 300, b"\xff\xfe", b"\xef\xbb\xbf", b"1", b"1,2,3",
    b"1,2,3\n" * 2,
    b"nan,nan,nan\n", b"1e999,1,1\n", b",,,\n,,,\n", b"#\n" * 50, b'"1","2","3"\n', b"1;2;3\r1;2;3",
    b"1\n2\n3\n", b"\x1f\x8b" + bytes(40), b"1,2,3\n# end", b"1_0,2,3\n", b"0x1p3,2,3\n",
    "١,٢,٣\n".encode(), b"1e308,-1e308,1e308\n" * 3, b"wx,wy,wz\n", b"a" * 100_000,
    b"1," * 20_000 + b"1\n", b"t,wx,wy,wz\n-1e308,0,0,0\n1e308,0,0,0\n",
    b"t,wx,wy,wz\n0,0,0,0\n5e-324,0,0,0\n", b"t_ns,wx,wy,wz\n0,0,0,0\n1e-320,0,0,0\n",
    b"t,wx,wy,wz\n1,0,0,0\n1.0000000000000001,0,0,0\n",
)  # fmt: skip


def mutated(d: Draw, content: bytes) -> bytes:
    x = bytearray(content)
    for _ in range(d.one((1, 1, 2, 5))):
        how = d.random.randrange(7)
        at = d.random.randrange(len(x) + 1)
        to = min(len(x), at + d.one((1, 1, 3, 20)))
        if how == 0 and at < len(x):
            x[at] ^= 1 << d.random.randrange(8)
        elif how == 1:
            del x[at:to]
        elif how == 2:
            del x[at:]
        elif how == 3:
            x[at:at] = x[at:to]
        elif how == 4:
            x[at:at] = d.one((b",", b"\n", b'"', b"\x00", b"#", b"-", b"e", b"nan", b"\r", b"\t"))
        elif how == 5:
            x[at:at] = d.one(_BYTES)[:50]
        else:
            x[at:to] = bytes(d.random.randrange(256) for _ in range(to - at))
    return bytes(x)


def hostile_log(d: Draw) -> Log:
    kind = d.random.random()
    if kind < 0.45:
        return log_file(d)
    log = log_file(d)
    if kind < 0.9:
        content = mutated(d, log.content)
    elif kind < 0.92:
        content = gzip.compress(log.content)
    elif kind < 0.96:
        content = d.one(_BYTES)
    else:
        content = d.rng.bytes(d.random.randrange(300))
    options = dict(log.options)
    if d.chance(0.2):
        options["columns"] = ["1", "2", "3"]
    return Log(content, options, None, None)


def written(folder: Path, content: bytes) -> Path:
    path = folder / "log.csv"
    path.write_bytes(content)
    return path


def read_wrong(log: Any, meant: Log) -> str | None:  # noqa: PLR0911
    """What is wrong with a log that was read."""
    n = len(log.rates)
    if log.rates.shape != (n, 3) or not np.isfinite(log.rates).all():
        return "rates not finite"
    dt = np.asarray(log.dt)
    if not (np.isfinite(dt).all() and (dt > 0.0).all()) or dt.shape not in ((), (n - 1,)):
        return "intervals not finite or not above 0"
    if log.t.shape != (n,) or not np.isfinite(log.t).all():
        return "times not finite"
    if not log.rate > 0.0:
        return "sample rate not above 0"
    if log.attitudes is not None and not np.isfinite(log.attitudes).all():
        return "attitudes not finite"
    if meant.rates is None:
        return None
    if log.rates.shape != meant.rates.shape:
        return f"{n} rows of {len(meant.rates)}"
    if not np.allclose(log.rates, meant.rates, rtol=1e-14, atol=0.0):
        return "other rates than written"
    if meant.t is None or not np.allclose(log.t, meant.t - meant.t[0], rtol=1e-9, atol=1e-15):
        return "other times than written"
    return None


READER = (
    "path", "columns", "unit", "rate", "time_column", "attitude_columns", "time column",
    "attitude columns", "log.csv",
)  # fmt: skip


def read(d: Draw, folder: Path) -> Call:
    meant = hostile_log(d)
    path: Any = written(folder, meant.content)
    options = dict(meant.options)
    if d.chance(0.1):
        meant = Log(b"", {}, None, None)
        for name, value in (
            ("rate", lambda: d.real(50.0)),
            ("unit", lambda: d.word("rad/s", "deg/s")),
            ("columns", lambda: _chosen(d, 3)),
            ("time_column", lambda: d.one(("1", "t", 1, 0, "", None, *ODD[:30]))),
            ("attitude_columns", lambda: _chosen(d, 4)),
        ):
            if d.chance(0.4):
                options[name] = value()
    if d.chance(0.01):
        path = d.one(
            (folder, folder / "none.csv", "", "a\x00b", str(path), os.fsencode(path), *ODD)
        )
        path = folder if isinstance(path, bool) else path  # no file descriptors

    def judge(log: Any) -> str | None:
        return read_wrong(log, meant)

    return Call(gyrolog.read_log, (path,), options, judge, READER, (*REFUSALS, OSError))


def _chosen(d: Draw, n: int) -> Any:
    names = ("1", "2", "3", "4", "5", "wx", "wy", "wz", "0", "-1", "99", "²", "", 1, 2, 3, None)
    return d.one(
        ([d.one(names) for _ in range(n)], ["2", "3", "4", "5"][:n], "xyz", 5, [], *ODD[:9])
    )


def commanded(d: Draw, folder: Path, methods: tuple[str, ...] = METHODS) -> Call:
    meant = hostile_log(d)
    path = written(folder, meant.content)
    out = folder / d.one(("out.csv", "out.csv", "out.npy"))
    arguments = ["integrate", str(path), "-o", str(out), "--no-compare", "-q"]
    arguments += ["-m", d.one(methods)]
    for name, value in meant.options.items():
        arguments += [f"--{name}", ",".join(value) if name == "columns" else str(value)]
    odd = (
        "nan",
        "0",
        "-1",
        "1e-320",
        "1e308",
        "x",
        "",
        "1,2,3",
        "\x00",
        "0,0,0,0",
        "1,0,0,0",
        "inf",
    )
    for name in ("--rate", "--q0", "--max-gap", "--columns", "--unit", "-m", "-o", "--time-column"):
        if d.chance(0.04):
            meant = Log(b"", {}, None, None)
            arguments += (
                [name, d.one(odd)] if name != "-o" else ["-o", str(folder / d.one(odd[5:8]))]
            )
    if d.chance(0.02):
        arguments[1] = d.one((str(folder), str(folder / "none"), "a\x00b", ""))

    def run() -> int:
        said, failed = io.StringIO(), io.StringIO()
        with contextlib.redirect_stdout(said), contextlib.redirect_stderr(failed):
            try:
                code = cli.main(arguments)
            except SystemExit as left:  # argparse
                code = 2 if left.code == 2 and "error: " in failed.getvalue() else -1
                failed = io.StringIO("fastatt: refused")
        if code == 2:
            text = failed.getvalue().rstrip("\n")
            if not text.startswith("fastatt: ") or len(text.splitlines()) != 1 or len(text) > 2000:
                raise AssertionError(f"refusal: {text[:200]!r}")
        return Refused(code) if code == 2 else code

    def judge(code: Any) -> str | None:
        if code == 2:
            return None
        if code != 0:
            return f"code {code}"
        found = np.load(out) if out.suffix == ".npy" else np.loadtxt(out, delimiter=",", skiprows=1)
        wrong = unit(np.atleast_2d(found)[:, 1:])
        if (
            wrong is None
            and meant.rates is not None
            and len(np.atleast_2d(found)) != len(meant.rates)
        ):
            wrong = f"{len(found)} rows of {len(meant.rates)}"
        return wrong

    return Call(run, (), {}, judge, READER)


class Refused(int):
    """The exit status of a command that refused its input."""


class Finding(NamedTuple):
    """A class of findings: where, what, and the first example."""

    target: str
    what: str
    example: str


def _shown(call: Call) -> str:
    path = call.arguments[0] if call.arguments else None
    if isinstance(path, Path) and path.is_file():
        return f"{path.read_bytes()[:600]!r}, {dict(call.options)}"
    given = [repr(a) for a in call.arguments] + [f"{k}={v!r}" for k, v in call.options.items()]
    return f"{getattr(call.function, '__name__', call.function)}({', '.join(given)})"


def tried(call: Call) -> tuple[str, str | None]:
    """("returned" or "refused", what is wrong or None)."""
    began = time.perf_counter()
    outcome, wrong, result = "returned", None, None
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        try:
            result = call.function(*call.arguments, **call.options)
        except call.refusals as error:
            outcome, text = "refused", str(error)
            if isinstance(error, OSError):
                pass
            elif len(text.splitlines()) != 1:
                wrong = f"{type(error).__name__} of several lines: {text[:10]!r}"
            elif len(text) > 1500:
                wrong = f"{type(error).__name__} of {len(text)} characters: {text[:10]!r}"
            elif not any(re.search(rf"(?<!\w){re.escape(n)}(?!\w)", text) for n in call.names):
                wrong = f"{type(error).__name__} names no argument: {text[:90]!r}"
        except (Exception, SystemExit) as error:  # noqa: BLE001
            outcome = "refused"
            wrong = f"{type(error).__name__}: {str(error)[:110]!r}"
        took = time.perf_counter() - began
        if isinstance(result, Refused):
            outcome = "refused"
        elif wrong is None and outcome == "returned":
            wrong = call.judge(result)
    others = [w for w in said if not issubclass(w.category, fa.StepWarning)]
    if wrong is None and others:
        wrong = f"{others[0].category.__name__}: {str(others[0].message)[:60]!r}"
    if wrong is None and took > SLOW:
        began = time.perf_counter()
        with contextlib.suppress(Exception), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            call.function(*call.arguments, **call.options)
        if time.perf_counter() - began > SLOW:
            wrong = f"takes {took:.0f} s"
    return outcome, wrong


Target = tuple[str, float, Callable[[Draw], Call]]


def targets(
    folder: Path, runs: tuple[Run, ...] = RUNS, methods: tuple[str, ...] = METHODS
) -> list[Target]:
    """Name, weight and maker of calls."""
    return [
        ("propagate", 4.0, lambda d: propagated(d, runs)),
        ("propagate_directions", 1.0, lambda d: directed(d, runs)),
        ("Scene", 4.0, scened),
        ("exact", 2.0, closed_form),
        ("conversions", 2.0, converted),
        ("products, angle_between", 2.0, combined),
        ("integrate_rates", 3.0, lambda d: integrated(d, methods)),
        ("angular_velocity", 1.0, differentiated),
        ("energies", 1.0, energetic),
        ("drift", 0.1, drifted),
        ("methods_for, single_step", 0.4, listed),
        ("read_log", 5.0, lambda d: read(d, folder)),
        ("fastatt integrate", 1.5, lambda d: commanded(d, folder, methods)),
    ]  # fmt: skip


def fuzz(
    inputs: int, seed: int, chosen: list[Target], progress: Callable[[int], object] = anything
) -> tuple[dict[str, Counter[str]], Counter[tuple[str, str]], list[Finding]]:
    """Outcomes by target, counts of findings by class, and each class once."""
    d = Draw(seed)
    outcomes: dict[str, Counter[str]] = {name: Counter() for name, _, _ in chosen}
    counts: Counter[tuple[str, str]] = Counter()
    found: list[Finding] = []
    weights = [w for _, w, _ in chosen]
    rows = gyrolog._ROWS
    try:
        for i in range(inputs):
            name, _, make = d.random.choices(chosen, weights)[0]
            with np.errstate(all="ignore"), warnings.catch_warnings():
                warnings.simplefilter("ignore")
                call = make(d)
            gyrolog._ROWS = d.one((rows, 1, 4))  # blocks end anywhere
            faulthandler.dump_traceback_later(HUNG, exit=True)
            outcome, wrong = tried(call)
            outcomes[name][outcome] += 1
            if wrong is not None:
                kind = name, re.sub(r"\bfound .*|'.*?'|-?\d+(\.\d+)?(e[+-]?\d+)?", "#", wrong)[:90]
                counts[kind] += 1
                if counts[kind] == 1:
                    found.append(Finding(name, wrong, f"input {i}: {_shown(call)[:1500]}"))
            progress(i)
    finally:
        faulthandler.cancel_dump_traceback_later()
        gyrolog._ROWS = rows
    return outcomes, counts, found


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--inputs", type=int, default=100_000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", help="one target by the start of its name")
    parser.add_argument(
        "--examples", action="store_true", help="show the first input of each class"
    )
    arguments = parser.parse_args()
    began = time.perf_counter()

    def progress(i: int) -> None:
        if sys.stderr.isatty() and i % 1000 == 0:
            print(f"\r{i} of {arguments.inputs}", end="", file=sys.stderr)

    with tempfile.TemporaryDirectory() as folder:
        chosen = targets(Path(folder))
        if arguments.only:
            chosen = [t for t in chosen if t[0].startswith(arguments.only)]
        outcomes, counts, found = fuzz(arguments.inputs, arguments.seed, chosen, progress)
    print(
        f"seed {arguments.seed}: {arguments.inputs} inputs in {time.perf_counter() - began:.0f} s"
    )
    print(f"{'target':26}{'inputs':>8}{'returned':>10}{'refused':>9}{'findings':>10}{'classes':>9}")
    for name, own in outcomes.items():
        classes = [n for (target, _), n in counts.items() if target == name]
        print(
            f"{name:26}{own.total():8}{own['returned']:10}{own['refused']:9}{sum(classes):10}"
            f"{len(classes):9}"
        )
    for (name, what), n in counts.most_common():
        print(f"{n:6}  {name}: {what}")
    if arguments.examples:
        for finding in found:
            print(f"\n{finding.target}: {finding.what}\n    {finding.example}")
    return 1 if counts else 0


if __name__ == "__main__":
    sys.exit(main())
