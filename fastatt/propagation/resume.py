"""The end of a run, from which another run continues as if it had not been interrupted.

A restart from a saved attitude and rate is another run: the state was projected, the compensation
of rounding is lost, and the invariants are measured from a new start.
"""

from __future__ import annotations

import json
import os
import tempfile
import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fastatt import checks
from fastatt.propagation.initial import Given

if TYPE_CHECKING:
    from fastatt.propagation.plan import Plan

_FORMAT = 6
#: the largest number of bodies of which a trajectory holds its end
MOST = 1 << 18


@dataclass(frozen=True)
class Checkpoint:
    """A file that holds the end of a run so far; :func:`checkpoint` makes it.

    Attributes
    ----------
    path : Path
        The file.
    """

    path: Path


def checkpoint(path: str | os.PathLike[str]) -> Checkpoint:
    """A file from which the same call continues after a crash: ``resume=fa.checkpoint(path)``.

    The run writes its state to the file every ten seconds; a file is replaced only by a complete
    one. If the file exists, the run continues from there, with the same bits as an uninterrupted
    run. With ``save_every``, the saves must go to ``on_save``; those since the last checkpoint may
    reach a function twice.

    Parameters
    ----------
    path : str or os.PathLike
        The file. The run creates it; it may be removed when the run is over.

    Returns
    -------
    Checkpoint
        For the argument ``resume`` of :func:`fastatt.propagate`.

    Raises
    ------
    TypeError
        If ``path`` is not a path.

    Examples
    --------
    >>> import fastatt as fa
    >>> fa.checkpoint("job").path.name
    'job'
    """
    return Checkpoint(checks.path("path", path))


@dataclass(frozen=True, eq=False)
class End:
    """The last state of a run as the engine carries it, its initial values, and its options."""

    given: Given
    states: NDArray[Any]
    diagnostics: NDArray[Any]
    done: int
    t0: float
    about: dict[str, Any]
    params: NDArray[np.float64]
    #: a hash of the operations of a step, and one of the events
    equations: str
    watched: str
    #: what the run keeps of its events: their last values, found times, states of stopped bodies
    events: list[NDArray[Any]]

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the end to a file, completely or not at all."""
        target = Path(path)
        given = self.given
        header = {
            "format": _FORMAT,
            "done": self.done,
            "t0": self.t0.hex(),
            "equations": self.equations,
            "watched": self.watched,
            "one_body": given.one_body,
            **self.about,
        }
        events: dict[str, Any] = {f"events_{i}": x for i, x in enumerate(self.events)}
        handle, name = tempfile.mkstemp(prefix=target.name, dir=target.parent)
        try:
            with os.fdopen(handle, "wb") as file:
                np.savez(
                    file,
                    header=np.array(json.dumps(header)),
                    q=given.q,
                    y=given.y,
                    states=self.states,
                    diagnostics=self.diagnostics,
                    params=self.params,
                    **events,
                )
                file.flush()
                os.fsync(file.fileno())
            Path(name).replace(target)
        except BaseException:
            Path(name).unlink(missing_ok=True)
            raise


def loaded(path: str | os.PathLike[str]) -> End:
    """Read the end of a run from a file.

    Raises ``ValueError`` for another kind of file, ``OSError`` if it can't be read.
    """
    try:
        with Path(path).open("rb") as opened, np.load(opened, allow_pickle=False) as file:
            about = json.loads(str(file["header"]))
            if about.pop("format") != _FORMAT:
                raise KeyError("format")
            return End(
                given=Given(file["q"], file["y"], about.pop("one_body")),
                states=file["states"],
                diagnostics=file["diagnostics"],
                done=about.pop("done"),
                t0=float.fromhex(about.pop("t0")),
                equations=about.pop("equations"),
                watched=about.pop("watched"),
                events=[file[name] for name in sorted(file) if name.startswith("events_")],
                params=file["params"],
                about=about,
            )
    except (KeyError, TypeError, ValueError, zipfile.BadZipFile) as error:
        raise ValueError(
            f"resume: {str(path)!r} is not the end of a run ({error}); accepted: "
            "one that Trajectory.save_end or fa.checkpoint wrote"
        ) from None


def end_of(resume: Any) -> End:
    """The end that a trajectory or a file holds.

    Raises ``TypeError`` and ``ValueError`` if there is none.
    """
    if isinstance(resume, (str, os.PathLike)):
        return loaded(resume)
    end = getattr(resume, "end", None)
    if isinstance(end, End):
        return end
    if hasattr(resume, "status"):
        raise ValueError(
            "resume: found a trajectory that does not hold its end; accepted: one of propagate by "
            f"a method that steps, of at most {MOST} bodies, with one step size, whole steps "
            "(t_end a multiple of dt) and without save_at; a file that fa.checkpoint wrote, of any "
            "number"
        )
    raise TypeError(
        f"resume: found {checks.brief(resume)}; accepted: a trajectory, a file's path or "
        "fa.checkpoint(path)"
    )


def check(end: End, plan: Plan, *, is_same_run: bool) -> None:
    """Refuse to resume with other options, another scene or another method.

    ``is_same_run`` says that an interrupted run goes on, so that its events must be the same too.
    """
    for name, value in plan.about.items():
        if end.about[name] != value:
            raise ValueError(
                f"{name}: found {_plain(value)}; accepted: {_plain(end.about[name])}, as in the "
                "earlier run"
            )
    if not np.array_equal(end.params, plan.packed.params) or end.equations != plan.equations:
        raise ValueError("scene: differs from that of the run that is resumed; accepted: the same")
    if end.watched != plan.watched and (is_same_run or any(map(np.size, end.events[3:]))):
        raise ValueError(
            "events: found others than those of the run that is resumed; accepted: the same, since "
            + ("the run is not over" if is_same_run else "bodies stop at terminal ones")
        )


def check_begin(end: End, given: Given, t0: float, n_steps: int) -> None:
    """Refuse a checkpoint of a run with other initial values, or one of a later step."""
    begin = end.given
    pairs = ((begin.q, given.q), (begin.y, given.y))
    if end.t0 != t0 or not all(np.array_equal(a, b, equal_nan=True) for a, b in pairs):
        raise ValueError(
            "resume: the checkpoint is of a run from other initial values; accepted: the same call "
            "again, or no file"
        )
    if end.done > n_steps:
        raise ValueError(
            f"n_steps: found {n_steps}; accepted: at least {end.done}, after which the checkpoint "
            "was written"
        )


def _plain(value: Any) -> Any:
    return float.fromhex(value) if isinstance(value, str) and value[:3] in ("0x1", "-0x") else value
