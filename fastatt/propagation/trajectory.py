"""The results of a run."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fastatt import arrays, checks
from fastatt._cached import cached_property
from fastatt.attitudes import QUATERNION, Attitude
from fastatt.codegen.rows import rows
from fastatt.engine.marks import Event
from fastatt.engine.status import FLAGS, Status, count_flags
from fastatt.methods import METHODS
from fastatt.propagation.breakpoints import Divisions
from fastatt.propagation.end import NO_END, End
from fastatt.scene.equations import PrescribedRate
from fastatt.scene.law import Law
from fastatt.scene.models import Packed

if TYPE_CHECKING:
    from datetime import datetime

    from fastatt.methods.method import Method
    from fastatt.scene.scene import Scene


class Crossings(NamedTuple):
    """What ``Trajectory.crossings`` gives, with a row for each crossing."""

    body: NDArray[np.int64]
    t: NDArray[np.float64]
    q: NDArray[Any]
    w: NDArray[Any] | None
    v: NDArray[Any] | None
    r: NDArray[Any] | None
    s: NDArray[Any] | None


@dataclass(frozen=True, eq=False, repr=False)
class Trajectory:
    """The saved states of one body or of an ensemble, time first.

    S is the number of saves and N the number of bodies. Arrays of one body have no axis N: ``q`` is
    (S, 4) if ``q0`` was (4,). At a Python prompt a trajectory prints its summary; a notebook also
    shows a table of the last save. :func:`propagate` and plans make trajectories.

    Attributes
    ----------
    t : ndarray of shape (S,)
        Times of the saves, s.
    status : ndarray of uint16 of shape (N,)
        A :class:`Status` for each body; 0 if nothing went wrong.
    norm_error : ndarray of shape (S, N)
        The norm error of the propagated state before it was renormalised: |q| − 1 for
        quaternions, ‖C Cᵀ − 1‖ for matrices.
    state : ndarray of shape (S, N, k)
        The k numbers of the attitude in the run's representation.
    dt : float or ndarray of shape (N,)
        Step size, or per-body step sizes, s.
    one_body : bool
        Whether the initial values were those of one body, without an axis N.
    parts : dict of str to slice
        Where the states of each named term of the torque are in ``s``, as ``Scene.parts``.

    Examples
    --------
    >>> import fastatt as fa
    >>> body = fa.Scene(inertia=(2.0, 1.0, 2 / 3))
    >>> run = fa.propagate(body, [1, 0, 0, 0], [0.1, 0.3, -0.2], dt=0.1, n_steps=100, save_every=50)
    >>> run.t, run.q.shape, run.status
    (array([ 0.,  5., 10.]), (3, 4), array([0], dtype=uint16))
    """

    t: NDArray[np.float64]
    state: NDArray[Any]
    norm_error: NDArray[Any]
    status: NDArray[FLAGS]
    #: the step size, s, or per-body step sizes (N,)
    dt: Any
    one_body: bool
    #: the structure and the parameters of the scene; None if w is ``carried``
    packed: Packed | None = field(repr=False)
    attitude: Attitude = field(repr=False)
    record: Method = field(repr=False)
    #: w, v and r, each (S, N, 3), and states s (S, N, n), as far as the scene has them
    carried: Mapping[str, NDArray[Any]] = field(default_factory=dict, repr=False)
    #: the final state as ``resume`` needs it
    end: End | None = field(default=None, repr=False)
    #: times of events (N, E); None for a run without events
    first_crossings: NDArray[np.float64] | None = field(default=None, repr=False)
    #: the events, whose functions are in their sources
    events: tuple[Event, ...] = field(default=(), repr=False)
    #: the numbers of events and switches whose crossings are all ``located``, by number or name
    crossing_numbers: Mapping[int | str, int] = field(default_factory=dict, repr=False)
    located: tuple[tuple[int, Any, Any, Any], ...] = field(default=(), repr=False)
    #: the columns of each carried quantity in the values of a save
    columns: Mapping[str, slice] = field(default_factory=dict, repr=False)
    #: what divided its steps
    divisions: Divisions = field(default=Divisions(), repr=False)
    #: the quaternions of the save before, whose sign goes on; None of the first save
    q_before: NDArray[Any] | None = field(default=None, repr=False)
    #: where the states of terms with names are in ``s``
    parts: Mapping[str, slice] = field(default_factory=dict, repr=False)

    def __getstate__(self) -> dict[str, Any]:
        """All fields, for pickling; a prescribed rate is stored as numbers."""
        state = {name: getattr(self, name) for name in self.__dataclass_fields__}
        rates = self.w.reshape(*self.state.shape[:2], 3)
        state["carried"] = {"w": rates, **self.carried}
        record = self.record
        if METHODS.get(record.name) is not record:  # its nested functions can't be pickled
            record = replace(record, steps=None)
        return {**state, "packed": None, "record": record}

    @property
    def terminal(self) -> list[bool]:
        """Which of the events are terminal."""
        return [x.terminal for x in self.events]

    @property
    def method(self) -> str:
        """Name of the method."""
        return self.record.name

    @property
    def representation(self) -> str:
        """Name of the representation."""
        return self.attitude.name

    @cached_property
    def q(self) -> NDArray[Any]:
        """Unit quaternions from body to inertial axes, scalar first: (S, N, 4).

        Their sign is continuous from the initial one on in the representation "quat". In others
        each save of this trajectory has the sign that is nearer to the save before.
        """
        if self.attitude.to_quat_array is None:
            q = arrays.quaternions_of(self.dcm)
        else:
            q = self._shaped(self.attitude.to_quat_array(self.state))
        if self.attitude.family == "quaternion":
            return q
        if self.q_before is None:
            return arrays.make_continuous(q)
        return arrays.make_continuous(np.concatenate([self.q_before, q]))[1:]

    @property
    def last_taken(self) -> NDArray[Any] | None:
        """The last attitudes, if ``q`` was asked for: then their sign goes on."""
        return self.__dict__["q"][-1:].copy() if "q" in self.__dict__ else None

    @cached_property
    def dcm(self) -> NDArray[Any]:
        """Direction cosine matrices from body to inertial axes: (S, N, 3, 3)."""
        if self.attitude.to_dcm_array is not None:
            return self._shaped(self.attitude.to_dcm_array(self.state))
        return arrays.quat_to_dcm(self.q)

    @cached_property
    def euler313(self) -> NDArray[Any]:
        """3-1-3 Euler angles (φ, θ, ψ), rad: (S, N, 3)."""
        if self.attitude.to_euler313_array is not None:
            return self._shaped(self.attitude.to_euler313_array(self.state))
        return arrays.quat_to_euler313(self.q)

    @cached_property
    def w(self) -> NDArray[Any]:
        """Angular velocities along body axes, rad/s: (S, N, 3)."""
        if "w" in self.carried:
            return self._shaped(self.carried["w"])
        packed = self.packed
        assert packed is not None
        rotation = packed.structure.rotation
        assert isinstance(rotation, PrescribedRate)
        law = rotation.law
        n, params = law.states, packed.params[..., : law.count]
        rates = rows(_rate_of(law), {"t": None, "s": n, "p": law.count}, (3,), key=law)
        states = self.carried["s"] if n else np.zeros(0)
        t = self.t[:, None]
        if self.first_crossings is not None and any(self.terminal):  # a body stays at its event
            earlier = np.fmin if np.min(self.dt) > 0.0 else np.fmax
            t = earlier(t, earlier.reduce(self.first_crossings[:, self.terminal], axis=1))
        (w,) = rates(t, states, params, tables=packed.tables)
        w = self._shaped(np.broadcast_to(w, (*self.state.shape[:2], 3)))
        if rotation.inertial:
            w = np.einsum("...ji,...j->...i", self.dcm, w)
        with np.errstate(over="ignore"):
            return w.astype(self.state.dtype, copy=False)

    @property
    def v(self) -> NDArray[Any]:
        """Velocities along body axes, m/s: (S, N, 3). ``ValueError`` for a scene without mass."""
        return self._shaped(self._carried("v", "mass"))

    @property
    def r(self) -> NDArray[Any]:
        """Positions along inertial axes, m: (S, N, 3). ``ValueError`` for a run without ``r0``."""
        return self._shaped(self._carried("r", "mass, propagated from an r0"))

    @property
    def s(self) -> NDArray[Any]:
        """States in the order of the user-defined function: (S, N, n)."""
        return self._shaped(self._carried("s", "states"))

    @property
    def event_times(self) -> NDArray[np.float64]:
        """Time of the first crossing of each event by each body, s: (N, E), or (E,) for one body.

        NaN if there was none. ``ValueError`` for a run without ``events``.
        """
        if self.first_crossings is None:
            raise ValueError("event_times: the run had no events; accepted: propagate(events=)")
        return self.first_crossings[0] if self.one_body else self.first_crossings

    def crossings(self, event: Event | int | str) -> Crossings:
        """Give all crossings of an event or of a switch, in the order of the bodies and times.

        A run that was resumed has those from then on, and a trajectory that ``on_save`` takes those
        since the one before.

        Parameters
        ----------
        event : Event, int or str
            What ``fa.event(every=True)`` made, or its number among ``events``, by which a pickled
            trajectory knows it; or the name of a ``torques.Switch``, or of a model that divides
            steps, whose further signs have their number in ``s`` too: "wheels", "wheels.4".

        Returns
        -------
        Crossings
            A named tuple of arrays with a row for each crossing: ``body``, ``t``, ``q``, ``w``,
            which is None for a prescribed rate after pickling, and as far as the scene has them
            ``v``, ``r`` and ``s``, else None. The side in ``s`` is that from before the crossing.

        Raises
        ------
        ValueError
            If there is no such event or switch.
        """
        numbers, shown = self.crossing_numbers, checks.brief(event)
        if isinstance(event, Event):
            sources = [x.source for x in self.events]
            event = sources.index(event) if event in sources else -1
        if event not in numbers:
            known = ", ".join(map(repr, numbers)) or "an event(every=True), or a Switch"
            raise ValueError(f"event: found {shown}; accepted: {known}")
        which, stored = numbers[event], self.attitude.stored
        width = max([stored, *(x.stop for x in self.columns.values())]) + 1
        nothing = np.zeros(0, np.int64), np.zeros(0), np.zeros((0, width))
        parts = zip(nothing, *(x[1:] for x in self.located if x[0] == which), strict=True)
        body, t, saved = map(np.concatenate, parts)
        order = np.lexsort((t if np.min(self.dt) > 0.0 else -t, body))
        body, t, saved = body[order], t[order], saved[order][:, None].astype(self.state.dtype)
        carried = {name: saved[..., part] for name, part in self.columns.items()}
        packed = self.packed
        if packed is not None and packed.params.ndim == 2:
            packed = packed._replace(params=packed.params[body][:, None])
        crossed = replace(
            self, t=t, state=saved[..., :stored], one_body=True, packed=packed, carried=carried,
            first_crossings=None,
        )  # fmt: skip
        q, named = crossed.q, {name: getattr(crossed, name) for name in carried}
        if self.attitude is not QUATERNION:  # of neither sign, since these are many bodies
            q = q * np.copysign(1.0, q[:, :1])
        if packed is not None:  # a prescribed rate
            named["w"] = crossed.w
        return Crossings(body, t, q, *(named.get(name) for name in ("w", "v", "r", "s")))

    def _carried(self, name: str, needs: str) -> NDArray[Any]:
        if name not in self.carried:
            raise ValueError(f"{name}: is not carried; it is in a scene with {needs}")
        return self.carried[name]

    def to_csv(self, path: str | Path) -> None:
        """Write a CSV file with a row for each save and body.

        The columns are ``t``, ``body``, q, w, v, r, s and ``status``.

        Parameters
        ----------
        path : str or Path
            The file.

        See Also
        --------
        fastatt.interchange.write_csv : The function that this method calls.
        """
        from fastatt.interchange import write_csv

        write_csv(self, path)

    def to_dataframe(self) -> Any:
        """Return a pandas DataFrame with a row for each save and body.

        The columns are those of :meth:`to_csv`.

        Returns
        -------
        pandas.DataFrame
            The table.

        Raises
        ------
        ImportError
            If pandas is not installed.
        """
        from fastatt.interchange import dataframe

        return dataframe(self)

    def to_aem(
        self, path: str | Path, *, epoch: str | datetime, frame: str, **options: Any
    ) -> None:
        """Write one body as an attitude ephemeris message (AEM) of the CCSDS.

        Parameters
        ----------
        path : str or Path
            The file.
        epoch : str or datetime
            Date and time of t = 0 of the run, in the TIME_SYSTEM of the metadata, which is UTC by
            default: a ``datetime``, or text such as "2026-01-01T00:00:00". From this epoch t counts
            every second, leap seconds of UTC included. "unix" states that t is Unix time, which
            skips leap seconds.
        frame : str
            Name of the inertial frame in the standard, such as "EME2000" or "ICRF".
        **options : dict
            Any of these. ``body_frame``, by default "SC_BODY_1": name of the body frame in the
            standard. ``body``: index of the body, required for an ensemble. ``version``: "2.0"
            (CCSDS 504.0-B-2, the default) or "1.0" (504.0-B-1). ``attitude_type``: "QUATERNION", or
            with the angular velocity, the default, "QUATERNION/ANGVEL" in version 2.0 and
            "QUATERNION/RATE" in 1.0. ``metadata`` and ``header``: mappings of further keywords to
            text, such as ``{"OBJECT_NAME": "SAT-1"}``; OBJECT_NAME and OBJECT_ID are "UNKNOWN" if
            they are not given.

        Raises
        ------
        ValueError
            If an argument does not fit, the frame rotates (as ITRF and LVLH do) or is the body's,
            ``body`` is missing for an ensemble, an attitude is not finite, or times are beyond 1e8
            s from an epoch before 1972, such as 1970, which Unix time and elapsed seconds interpret
            differently.
        TypeError
            If an argument has the wrong type.
        """
        from fastatt.interchange.aem import to_aem

        to_aem(self, epoch=epoch, frame=frame, **options).write(path)

    def plot(self, path: str | Path, scene: Scene | None = None) -> None:
        """Plot attitude, angular velocity and errors of conserved quantities over time.

        For many bodies percentiles are plotted.

        Parameters
        ----------
        path : str or Path
            The picture, in a format that matplotlib writes.
        scene : Scene, optional
            The scene of the run. With it, the drifts of energy and angular momentum are plotted
            too, where the motion conserves them.

        See Also
        --------
        fastatt.plots.history : The function that this method calls.
        """
        from fastatt import plots

        plots.history(self, path, scene)

    def __repr__(self) -> str:
        return self.summary()

    def status_counts(self) -> dict[str, int]:
        """Count the bodies that have each flag of :class:`Status`.

        Returns
        -------
        dict of str to int
            The name of each flag with its number of bodies; empty if no body has a flag.
        """
        return count_flags(self.status)

    def summary(self) -> str:
        """Describe the run and its flags in a few lines of text.

        Returns
        -------
        str
            The text that a trajectory prints at a Python prompt.
        """
        n = self.status.size
        bodies = "1 body" if n == 1 else f"{n} bodies"
        errors = np.abs(self.norm_error[np.isfinite(self.norm_error)])
        largest = errors.max() if errors.size else np.nan
        steps = dict.fromkeys((np.min(self.dt), np.max(self.dt)))
        step = " to ".join(f"{x:g}" for x in steps)
        first = (
            f"{self.method} on {self.representation}, {self.state.dtype}: {bodies} to "
            f"t = {self.t[-1]:g} s by {step} s, {self.t.size} saves; largest norm error "
            f"{largest:.1e}"
        )
        lines = [first]
        for flag in (f for f in Status if f):
            where = np.flatnonzero(self.status & flag)
            if where.size:
                shown = ", ".join(str(b) for b in where[:5]) + (", …" if where.size > 5 else "")
                lines.append(f"{flag.name} ({int(flag)}): {where.size} of {n}, body {shown}")
        return "\n".join(lines)

    def save_end(self, path: str | os.PathLike[str]) -> None:
        """Write the final state of the run to a file.

        :func:`resume` continues from it. The file is written completely or not at all.

        Parameters
        ----------
        path : str or os.PathLike
            The file.

        Raises
        ------
        ValueError
            If the trajectory does not hold the final state as the run had it, or the path is a
            directory.
        TypeError
            If ``path`` is not a path.
        """
        if self.end is None:
            raise ValueError(f"save_end: found {NO_END}")
        self.end.save(path)

    def _shaped(self, value: NDArray[Any]) -> NDArray[Any]:
        return value[:, 0] if self.one_body else value


def _rate_of(law: Law) -> Callable[..., Any]:
    """The angular velocity of a law as a function of (t, states, parameters)."""
    return lambda t, s, p: (law.formula(t, p, states=s)[:3],)
