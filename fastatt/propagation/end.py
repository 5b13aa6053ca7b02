"""The end of a run, from which another run continues as if it had not been interrupted.

A restart from a saved attitude and rate is another run: the state was projected, the compensation
of rounding is lost, and the invariants are measured from a new start.
"""

from __future__ import annotations

import io
import json
import os
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fastatt import checks
from fastatt.engine.run import Run
from fastatt.engine.tape import Piece
from fastatt.files import target, writing
from fastatt.propagation.initial import Initial

_FORMAT = 12
# s between two checkpoints
_WRITTEN = 10.0
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

    def check(self, equations: str, params: NDArray[np.float64], events: str) -> None:
        """Refuse to resume with another scene, or with other events where bodies have stopped."""
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

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the end to a file, completely or not at all."""
        header = np.array(json.dumps({"format": _FORMAT, **self.options}))
        arrays: dict[str, Any] = {"header": header, **self.arrays}
        whole = io.BytesIO()  # the archive needs a place in the file, which devices have not
        np.savez(whole, **arrays)
        with writing("path", path) as file:
            file.write(whole.getbuffer())


def loaded(path: str | os.PathLike[str]) -> End:
    """Read the end of a run from a file.

    Raises ``ValueError`` for a folder and another kind of file, ``OSError`` if it can't be read.
    """
    source = target("run", path)
    try:
        with source.open("rb") as opened, np.load(opened, allow_pickle=False) as file:
            options = json.loads(str(file["header"]))
            if options.pop("format") != _FORMAT:
                raise KeyError("format")
            return End(options, {name: file[name] for name in file if name != "header"})
    except (KeyError, TypeError, ValueError, zipfile.BadZipFile):
        raise ValueError(
            f"run: {str(path)!r} is not the end of a run; accepted: a file that "
            "Trajectory.save_end or checkpoint= of this version wrote"
        ) from None


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
