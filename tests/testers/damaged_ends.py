"""Ends of runs whose files are damaged or crafted: refused in one line, or the right numbers."""

from __future__ import annotations

import io
import json
import random
import warnings
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

import fastatt as fa
from fastatt.propagation.end import End

Q0, W0 = [1.0, 0.1, 0.2, 0.3], [0.1, 0.3, -0.2]


def plunge(t, q, w, p):
    return w[1]


GRAVITY = fa.Scene(inertia=(2.0, 1.5, 1.0), torque=fa.torques.GravityGradient(0.3))
RUNS = {
    "a body": (GRAVITY, {"q0": Q0, "w0": W0}),
    "bodies": (GRAVITY, {"q0": [Q0] * 70, "w0": W0}),
    "events": (GRAVITY, {"q0": [Q0] * 3, "w0": W0, "events": fa.event(plunge, terminal=True)}),
    "low parts": (GRAVITY, {"q0": [Q0], "w0": W0, "compensated": True}),
}


@cache
def known(name: str) -> tuple[bytes, list[bytes]]:
    """The file of a run's end, and the numbers of the run that goes on from it."""
    scene, arguments = RUNS[name]
    run = fa.propagate(scene, **arguments, dt=0.1, n_steps=5, method="rk4")
    with TemporaryDirectory() as folder:
        file = Path(folder, "end")
        run.save_end(file)
        return file.read_bytes(), numbers(resumed(name, file))


def resumed(name: str, path: Path) -> fa.Trajectory:
    scene, arguments = RUNS[name]
    events = {"events": arguments["events"]} if "events" in arguments else {}
    return fa.resume(scene, path, n_steps=5, n_threads=1, **events)


def numbers(run: fa.Trajectory) -> list[bytes]:
    return [x.tobytes() for x in (run.t, run.q, run.w, run.norm_error, run.status)]


ODD = (
    None, True, -5, 0, 1.5, 2**70, 1e308, float("nan"), float("inf"), "", "x", "nan", [], {}, [1],
)  # fmt: skip
CHANGES = {
    "big-endian": lambda r, x: x.astype(x.dtype.newbyteorder(">")),
    "single": lambda r, x: x.astype(np.float32),
    "whole": lambda r, x: np.nan_to_num(x).astype(np.int64),
    "text": lambda r, x: x.astype(str),
    "complex": lambda r, x: x.astype(complex),
    "a scalar": lambda r, x: np.array(0.3),
    "empty": lambda r, x: x[:0],
    "an axis more": lambda r, x: x[None],
    "flat": lambda r, x: x.ravel(),
    "a row more": lambda r, x: np.concatenate([x, x[:1]]) if x.ndim else x,
    "columns turned": lambda r, x: np.ascontiguousarray(x.T) if x.ndim > 1 else x[::-1],
    "fortran": lambda r, x: np.asfortranarray(x),
    "nan": lambda r, x: np.full_like(x, np.nan),
    "infinite": lambda r, x: np.full_like(x, np.inf),
    "another number": lambda r, x: x + r.choice((1e-9, 0.25, -3.0)),
}


def crafted(r: random.Random, content: bytes) -> tuple[str, bytes]:
    """One header or array of a file is another."""
    arrays = dict(np.load(io.BytesIO(content)))
    name = r.choice(sorted(arrays))
    if name != "header":
        how = r.choice(sorted(CHANGES))
        arrays[name] = CHANGES[how](r, arrays[name])
        if r.random() < 0.1:
            how, arrays = "gone", {k: x for k, x in arrays.items() if k != name}
    else:
        header = json.loads(str(arrays["header"]))
        name, value = r.choice(sorted(header)), r.choice(ODD)
        how = f"{header[name]!r} is {value!r}"
        header[name] = value
        if r.random() < 0.1:
            how = "gone"
            del header[name]
        arrays["header"] = np.array(json.dumps(header))
    if r.random() < 0.5:  # by someone who knows what the file says of itself
        name, header = f"{name}, forged", json.loads(str(arrays["header"]))
        known_keys = {k: x for k, x in header.items() if k not in ("format", "digest")}
        rest = {k: x for k, x in arrays.items() if k != "header"}
        arrays["header"] = np.array(json.dumps(header | {"digest": End(known_keys, rest).digest}))
    file = io.BytesIO()
    np.savez(file, **arrays)
    return f"{name}: {how}", file.getvalue()


def damaged(r: random.Random, content: bytes) -> tuple[str, bytes]:
    """Some bytes of a file are others."""
    at = r.randrange(len(content))
    kind = r.choice(("cut", "flipped", "zeros", "bytes", "twice", "nothing"))
    new = {
        "cut": content[:at],
        "flipped": content[:at] + bytes([content[at] ^ 1 << r.randrange(8)]) + content[at + 1 :],
        "zeros": content[:at] + bytes(64) + content[at + 64 :],
        "bytes": content[:at] + r.randbytes(16) + content[at + 16 :],
        "twice": content + content[at:],
        "nothing": b"",
    }[kind]
    return f"{kind} at {at}", new


def of_ends(seed: int, folder: Path) -> tuple[str, str]:
    """A file of an end, damaged or crafted, from which a run goes on."""
    r = random.Random(seed)
    run = r.choice(sorted(RUNS))
    content, wanted = known(run)
    change = r.choice((crafted, crafted, damaged))
    about, content = change(r, content)
    path = folder / "end"
    path.write_bytes(content)
    kind = change.__name__
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            made = numbers(resumed(run, path))
        except ValueError as error:
            text = str(error)
            fine = len(text.splitlines()) == 1 and text.startswith(
                ("run: ", "scene: ", "method: ", "dt: ")
            )
            return f"{kind}: refused", "" if fine else f"{run}, {about}: ValueError: {text}"
        except TimeoutError:
            raise
        except Exception as error:  # noqa: BLE001
            return kind, f"{run}, {about}: {type(error).__name__}: {error}"
    return (
        f"{kind}: right",
        "" if made == wanted or "forged" in about else f"{run}, {about}: other numbers, unsaid",
    )
