"""The end of a run, from which another run continues as if it had not been interrupted.

A restart from a saved attitude and rate is another run: the state was projected, the compensation
of rounding is lost, and the invariants are measured from a new start.
"""

from __future__ import annotations

import io
import json
import os
import zipfile
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fastatt import checks
from fastatt.files import target, writing
from fastatt.propagation.initial import Initial

if TYPE_CHECKING:
    from fastatt.propagation.plan import Plan

_FORMAT = 10
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
    #: (``equations``) and of the events (``watched``), and whether it is ``one_body``'s
    about: dict[str, Any]
    #: initial attitudes ``q``, and the other initial values ``y``; ``states``, and ``params``; of a
    #: run with events also what it keeps of them
    arrays: dict[str, NDArray[Any]]

    @property
    def start(self) -> Initial:
        """The initial values."""
        return Initial(self.arrays["q"], self.arrays["y"], self.about["one_body"])

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the end to a file, completely or not at all."""
        header = np.array(json.dumps({"format": _FORMAT, **self.about}))
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
            about = json.loads(str(file["header"]))
            if about.pop("format") != _FORMAT:
                raise KeyError("format")
            return End(about, {name: file[name] for name in file if name != "header"})
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


def check(end: End, plan: Plan) -> None:
    """Refuse to resume with another scene, or with other events where bodies have stopped."""
    is_same = end.about["equations"] == plan.equations
    if not (is_same and np.array_equal(end.arrays["params"], plan.packed.params)):
        raise ValueError(
            "scene: differs from that of the run that is resumed, or a method of one's own does; "
            "accepted: the same"
        )
    stopped = end.arrays.get("stopped", np.nan)
    if end.about["watched"] != plan.watched and not np.isnan(stopped).all():
        raise ValueError(
            "events: found others than those of the run that is resumed; accepted: the same, since "
            "bodies stop at terminal ones"
        )
