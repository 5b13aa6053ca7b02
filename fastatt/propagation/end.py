"""The end of a run, from which another run continues as if it had not been interrupted.

A restart from a saved attitude and rate is another run: the state was projected, the compensation
of rounding is lost, and the invariants are measured from a new start.
"""

from __future__ import annotations

import hashlib
import io
import json
import math
import os
import zipfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fastatt import checks
from fastatt.engine.run import Run
from fastatt.engine.status import DIAGNOSTICS
from fastatt.engine.tape import Piece
from fastatt.files import target, writing
from fastatt.propagation.initial import Initial

# the layout of the arrays
_FORMAT = f"15 {' '.join(of.name for of in DIAGNOSTICS)}"
# s between two checkpoints
_WRITTEN = 10.0
# what the options of a run are
_TYPES = {
    "dt": float, "t0": float, "done": int, "one_body": bool, "compensated": bool, "r0": bool,
    "method": str, "representation": str, "equations": str, "events": str,
}  # fmt: skip
#: the largest number of bodies of which a trajectory holds its end
MOST = 1 << 18
#: the rest of a message about a trajectory without its end
NO_END = (
    "a trajectory that does not hold its end; accepted: one of propagate or resume by a method "
    f"that takes steps, of at most {MOST} bodies (of more with checkpoint=), with one step size "
    "and a whole last step (t_end a multiple of dt away)"
)


@dataclass(frozen=True, eq=False)
class End:
    """The last state of a run as the engine carries it, its initial values, and its options."""

    #: arguments of the run by name; ``done`` steps, hashes of the operations of a step
    #: (``equations``) and of the events (``events``), and whether it is ``one_body``'s
    options: dict[str, Any]
    #: initial attitudes ``q``, and the other initial values ``y``; ``states``, and ``params``; of a
    #: run with events also what it keeps of them
    arrays: dict[str, NDArray[Any]]

    @property
    def start(self) -> Initial:
        """The initial values."""
        return Initial(self.arrays["q"], self.arrays["y"], self.options["one_body"])

    def kept(self, events: str) -> Mapping[str, NDArray[Any]]:
        """What a run with some events goes on from: states, and what belongs to the same events."""
        if self.options["events"] == events:
            return self.arrays
        return {"states": self.arrays["states"]}

    def check(
        self, equations: str, params: NDArray[np.float64], events: str,
        shapes: Mapping[str, tuple[int, ...]],
    ) -> None:  # fmt: skip
        """Refuse to resume with another scene, or with other events where bodies have stopped.

        ``shapes`` are those of the arrays of a run with these events.
        """
        is_same = self.options["equations"] == equations
        if not (is_same and np.array_equal(self.arrays["params"], params)):
            raise ValueError(
                "scene: differs from that of the run that is resumed, or a method of one's own "
                "does; accepted: the same"
            )
        stopped = self.arrays.get("stopped", np.nan)
        if self.options["events"] != events and not np.isnan(stopped).all():
            raise ValueError(
                "events: found others than those of the run that is resumed; accepted: the same, "
                "since bodies stop at terminal ones"
            )
        needed = shapes if self.options["events"] == events else {"states": shapes["states"]}
        for name, shape in needed.items():
            array = self.arrays.get(name, np.zeros(0))
            if array.shape != shape or array.dtype.kind != "f":
                raise ValueError(
                    f"run: found {name} {array.shape} of {array.dtype}; accepted: floats {shape}"
                )

    @property
    def digest(self) -> str:
        """A hash of all that it holds."""
        read = hashlib.sha256(json.dumps(self.options, sort_keys=True).encode())
        for name, array in sorted(self.arrays.items()):
            read.update(f"{name} {array.dtype.str} {array.shape}".encode() + array.tobytes())
        return read.hexdigest()

    @property
    def is_consistent(self) -> bool:
        """Whether options and arrays have the types and sizes of those of a run."""
        options, reals = self.options, [self.arrays[name] for name in ("states", "q", "y")]
        n, params = len(reals[0]), self.arrays["params"]
        return (
            all(type(options[name]) is of for name, of in _TYPES.items())
            and type(options["normalise"]) in (str, int)
            and math.isfinite(options["t0"])
            and 0.0 < abs(options["dt"]) < math.inf
            and 0 <= options["done"] < 1 << 53
            and all(x.ndim == 2 and len(x) in (1, n) for x in reals)
            and len({x.dtype for x in reals}) == 1
            and reals[0].dtype in (np.float32, np.float64)
            and reals[1].shape[1] == 4
            and params.dtype == np.float64
            and params.ndim in (1, 2)
            and n == max(map(len, reals)) == (1 if options["one_body"] else n)
        )

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the end to a file, completely or not at all."""
        marked = {"format": _FORMAT, "digest": self.digest, **self.options}
        header = np.array(json.dumps(marked))
        arrays: dict[str, Any] = {"header": header, **self.arrays}
        whole = io.BytesIO()  # the archive needs a place in the file, which devices have not
        np.savez(whole, **arrays)
        with writing("path", path) as file:
            file.write(whole.getbuffer())


def end_of(run: Any) -> End:
    """The end that a trajectory or a file holds.

    Raises ``TypeError`` and ``ValueError`` if there is none.
    """
    if isinstance(run, (str, os.PathLike)):
        return loaded(run)
    end = getattr(run, "end", None)
    if isinstance(end, End):
        return end
    if hasattr(run, "status"):
        raise ValueError(f"run: found {NO_END}")
    raise TypeError(f"run: found {checks.brief(run)}; accepted: a trajectory or a file's path")


def loaded(path: str | os.PathLike[str]) -> End:
    """Read the end of a run from a file.

    Raises ``ValueError`` for a folder and another kind of file, ``OSError`` if it can't be read.
    """
    content = target("run", path).read_bytes()  # its errors are those of the disk
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as file:
            arrays = {x.filename.removesuffix(".npy"): _array(file, x) for x in file.infolist()}
        options = json.loads(str(arrays.pop("header")))
        number, digest = options.pop("format"), options.pop("digest", "")
        end = End(options, arrays)
        is_whole = digest == end.digest and end.is_consistent
    except Exception:  # noqa: BLE001 (archives, arrays and texts that are damaged raise any)
        reason = "is not the end of a run"
    else:
        if number != _FORMAT:
            reason = f"has the format {checks.brief(number)} of another version"
        elif not is_whole:
            reason = "is damaged"
        else:
            return end
    raise ValueError(
        f"run: {str(path)!r} {reason}; accepted: a file that Trajectory.save_end or checkpoint= of "
        "this version wrote"
    )


def _array(file: zipfile.ZipFile, member: zipfile.ZipInfo) -> NDArray[Any]:
    """An array of an archive; raises ``ValueError`` if it is not as long as it says."""
    if member.compress_size != member.file_size:
        raise ValueError(member.filename)
    content = io.BytesIO(file.read(member))
    if np.lib.format.read_magic(content) != (1, 0):
        raise ValueError(member.filename)
    shape, _, dtype = np.lib.format.read_array_header_1_0(content)
    if math.prod(shape) * dtype.itemsize != member.file_size - content.tell():
        raise ValueError(member.filename)
    content.seek(0)
    return np.asarray(np.lib.format.read_array(content, allow_pickle=False))


class Checkpoints:
    """Writes a file with the state of a run, after some seconds and at the end.

    ``end`` makes it of a run after whole steps. The last one is written only if it is ``whole``.
    """

    def __init__(self, path: Path, end: Callable[[Run, int], End], *, whole: bool) -> None:
        self._path, self._end, self._whole, self._written = path, end, whole, perf_counter()

    def take(self, run: Run, piece: Piece) -> None:
        """Write the file after a piece, if it is due."""
        is_last = piece.position == run.steps.length
        is_due = self._whole if is_last else perf_counter() - self._written > _WRITTEN
        if is_due and piece.whole >= 0:
            self._end(run, piece.whole).save(self._path)
            self._written = perf_counter()
