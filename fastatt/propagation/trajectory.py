"""What a run gives back."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fastatt import arrays, checks
from fastatt.attitudes import Attitude
from fastatt.codegen.rows import rows
from fastatt.engine.double_states import joined_array
from fastatt.engine.status import Status
from fastatt.methods import METHODS
from fastatt.scene.equations import PrescribedRate
from fastatt.scene.models import Law, Packed
from fastatt.scene.scene import Scene

if TYPE_CHECKING:
    from fastatt.methods.method import Method
    from fastatt.propagation.resume import End


@dataclass(frozen=True, eq=False, repr=False)
class Trajectory:
    """Saved attitudes of one body or of an ensemble, time first.

    At a prompt it prints its summary, in a notebook also a table of the last save.

    ``t`` (S,) s; ``q`` (S, N, 4) or (S, 4) for one body; ``dcm`` (S, N, 3, 3); ``w`` (S, N, 3)
    rad/s in body axes; of a scene with mass ``v`` (S, N, 3) m/s in body axes and, where given one,
    ``r`` (S, N, 3) m in inertial axes; of one with n states ``s`` (S, N, n); ``status`` (N,), one
    :class:`Status` a body; ``norm_error`` (S, N), how far the state had left its group before
    it was brought back for output: |q| − 1, or ‖C Cᵀ − 1‖ of a matrix.
    """

    t: NDArray[np.float64]
    state: NDArray[Any]
    norm_error: NDArray[Any]
    status: NDArray[np.uint8]
    #: the step size, s, or per-body step sizes
    dt: Any
    one_body: bool
    #: the model's numbers, or the scene that has them; None where w is carried
    packed: Packed | Scene | None = field(repr=False)
    attitude: Attitude = field(repr=False)
    record: Method = field(repr=False)
    #: w, v and r where the scene carries them, each (S, N, 3), states s (S, N, n)
    carried: Mapping[str, NDArray[Any]] = field(default_factory=dict, repr=False)
    #: where another run may go on
    end: End | None = field(default=None, repr=False)
    #: times of events (N, E), of a run with some
    found: NDArray[np.float64] | None = field(default=None, repr=False)

    def __getstate__(self) -> dict[str, Any]:
        """All fields, for a copy elsewhere: a given rate as numbers."""
        state = {name: getattr(self, name) for name in self.__dataclass_fields__}
        rates = self.w.reshape(*self.state.shape[:2], 3)
        state["carried"] = {"w": rates, **self.carried}
        record = self.record
        if METHODS.get(record.name) is not record:  # one's own, of functions within functions
            record = replace(record, steps=None)
        return {**state, "packed": None, "record": record}

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
        """Unit quaternions, body to inertial."""
        if self.attitude.to_quat_array is not None:
            return self._shaped(self.attitude.to_quat_array(self.state))
        if self.attitude.to_dcm_array is not None:
            return arrays.quaternions_of(self.dcm)
        return self._shaped(self.state)

    @cached_property
    def dcm(self) -> NDArray[Any]:
        """Direction cosine matrices, body to inertial."""
        if self.attitude.to_dcm_array is not None:
            return self._shaped(self.attitude.to_dcm_array(self.state))
        return arrays.quat_to_dcm(self.q)

    @cached_property
    def euler313(self) -> NDArray[Any]:
        """3-1-3 Euler angles (φ, θ, ψ), rad."""
        if self.attitude.to_euler313_array is not None:
            return self._shaped(self.attitude.to_euler313_array(self.state))
        return arrays.quat_to_euler313(self.q)

    @cached_property
    def w(self) -> NDArray[Any]:
        """Angular velocity in body axes at the saved times, rad/s."""
        if "w" in self.carried:
            return self._shaped(self.carried["w"])
        packed = self.packed
        if isinstance(packed, Scene):
            packed = packed.packed(self.status.size)
        assert packed is not None
        turning = packed.structure.turning
        assert isinstance(turning, PrescribedRate)
        law = turning.law
        n, params = law.states, packed.params[..., : law.count]
        rates = rows(_rate_of(law), {"t": None, "s": n, "p": law.count}, (3,), key=law)
        states = self.carried["s"] if n else np.zeros(0)
        (found,) = rates(self.t[:, None], states, params, tables=packed.tables)
        w = self._shaped(np.broadcast_to(found, (*self.state.shape[:2], 3)))
        if turning.inertial:
            w = np.einsum("...ji,...j->...i", self.dcm, w)
        with np.errstate(over="ignore"):
            return w.astype(self.state.dtype, copy=False)

    @property
    def v(self) -> NDArray[Any]:
        """Velocity in body axes, m/s, of a scene with mass."""
        return self._shaped(self._carried("v", "mass"))

    @property
    def r(self) -> NDArray[Any]:
        """Position in inertial axes, m, of a scene with mass where r0 was given."""
        return self._shaped(self._carried("r", "mass, propagated from an r0"))

    @property
    def s(self) -> NDArray[Any]:
        """States of a scene that has some, as their function orders them."""
        return self._shaped(self._carried("s", "states"))

    @property
    def reduced(self) -> NDArray[Any]:
        """What ``propagate``'s ``reduce`` made of every body, float64: (N, k), or (k,) of one."""
        if "reduced" not in self.carried:
            raise ValueError(
                "reduced: the run had no reduce; accepted: one with propagate(reduce=)"
            )
        last = np.asarray(self._shaped(self.carried["reduced"])[-1])
        return last if last.dtype == np.float64 else joined_array(last)

    @property
    def event_times(self) -> NDArray[np.float64]:
        """When each of ``propagate``'s ``events`` was first found, s: (N, E), or (E,) of one body.

        NaN where it was not.
        """
        if self.found is None:
            raise ValueError("event_times: the run had no events; accepted: propagate(events=)")
        return self.found[0] if self.one_body else self.found

    def _carried(self, name: str, needs: str) -> NDArray[Any]:
        if name not in self.carried:
            raise ValueError(f"{name}: is not carried; it is in a scene with {needs}")
        return self.carried[name]

    def pointing_error(self, target: Any) -> NDArray[Any]:
        """Angle between the attitude and a target, rad in [0, π]: (S, N), or (S,) of one body.

        Parameters
        ----------
        target : array_like or Trajectory
            Quaternions that broadcast against ``q``: (4,) for all times and bodies, (N, 4) of each
            body, (S, 1, 4) at each save, (S, N, 4), and of one body (S, 4). Of rotation matrices
            the same with (3, 3) in place of (4,). A run with the same saved times stands for its
            attitudes.

        Raises
        ------
        ValueError
            For shapes that do not broadcast, other saved times and matrices of no rotation.
        """
        return np.asarray(arrays.angle_between(self.q, self._reference("target", target)))

    def rotation_vector_to(self, reference: Any) -> NDArray[Any]:
        """Rotation vector u, rad, body axes, from the attitude to a reference: q∘exp(u).

        Its length is ``pointing_error``, at most π; its components are the errors about each body
        axis, as feedback takes them.

        Parameters
        ----------
        reference : array_like or Trajectory
            As ``pointing_error``'s target.

        Returns
        -------
        ndarray
            (S, N, 3), or (S, 3) of one body.

        Raises
        ------
        ValueError
            As ``pointing_error``.
        """
        wanted = self._reference("reference", reference)
        between = arrays.quat_multiply(self.q * np.array([1, -1, -1, -1], self.q.dtype), wanted)
        return arrays.quat_to_rotation_vector(between)

    def body_axis(self, axis: Any) -> NDArray[Any]:
        """Direction of a body axis at the saved times, a unit vector along inertial axes.

        Parameters
        ----------
        axis : array_like
            A vector along body axes, of any length but zero: (3,), or (N, 3) of each body.

        Returns
        -------
        ndarray
            (S, N, 3), or (S, 3) of one body.

        Raises
        ------
        ValueError
            For another shape, and for vectors that are 0 or not finite.
        """
        given = arrays.floats("axis", axis, (3,)).astype(self.q.dtype)
        size = np.linalg.norm(given, axis=-1, keepdims=True)
        checks.refuse("axis: its length", size, ~((size > 0.0) & np.isfinite(size)), "above 0")
        return arrays.quat_rotate(self.q, given / size)

    def _reference(self, name: str, value: Any) -> NDArray[Any]:
        """Quaternions of a target that broadcast against q, in its precision."""
        if isinstance(value, Trajectory):
            if not np.array_equal(value.t, self.t):
                raise ValueError(
                    f"{name}: found a run with other saved times; accepted: the same times, or "
                    "attitudes of fa.interpolate at run.t"
                )
            q = value.q[:, None] if value.one_body and not self.one_body else value.q
        else:
            q = arrays.as_quat(name, value)
        shapes = zip(q.shape[::-1], self.q.shape[::-1], strict=False)
        if q.ndim > self.q.ndim or any(a not in (1, b) for a, b in shapes):
            raise ValueError(
                f"{name}: has shape {q.shape}, q {self.q.shape}; accepted: shapes that broadcast "
                "to that of q"
            )
        return q.astype(self.q.dtype, copy=False)

    def to_csv(self, path: str | Path) -> None:
        """Write a row for each save and body: ``t``, ``body``, q, w, v, r, s, ``status``.

        See :func:`fastatt.interchange.write_csv`.
        """
        from fastatt.interchange import write_csv

        write_csv(self, path)

    def to_dataframe(self) -> Any:
        """A pandas DataFrame of a row for each save and body, its columns those of ``to_csv``.

        Raises ``ImportError`` without pandas.
        """
        from fastatt.interchange import dataframe

        return dataframe(self)

    def to_aem(self, path: str | Path, **options: Any) -> None:
        """Write one body as an attitude ephemeris message of the CCSDS.

        ``options`` are those of :func:`fastatt.interchange.aem_of`: ``epoch`` and ``frame`` at
        least.
        """
        from fastatt.interchange import aem_of

        aem_of(self, **options).write(path)

    def plot(self, path: str | Path, scene: Scene | None = None) -> None:
        """Draw attitude, |w| and drift over time to a file; of many bodies percentiles.

        See :func:`fastatt.plots.history`. Needs matplotlib.
        """
        from fastatt import plots

        plots.history(self, path, scene)

    def __repr__(self) -> str:
        return self.summary()

    def _repr_html_(self) -> str:
        from fastatt.interchange.tables import table

        return table(self)

    @property
    def has_flags(self) -> bool:
        """Whether any body has a status."""
        return bool(self.status.any())

    def status_counts(self) -> dict[str, int]:
        """How many bodies carry each flag; empty when all are fine."""
        found = {f.name or "": int(np.count_nonzero(self.status & f)) for f in Status if f}
        return {name: count for name, count in found.items() if count}

    def summary(self) -> str:
        """What was run and what went wrong, in a few lines."""
        n = self.status.size
        bodies = "1 body" if n == 1 else f"{n} bodies"
        far = np.nan_to_num(np.abs(self.norm_error)).max()
        first = (
            f"{self.method} on {self.representation}, {self.state.dtype}: {bodies} to "
            f"t = {self.t[-1]:g} s by {self._step} s, {self.t.size} saves; largest departure from "
            f"the group {far:.1e}"
        )
        lines = [first]
        for flag in (f for f in Status if f):
            where = np.flatnonzero(self.status & flag)
            if where.size:
                shown = ", ".join(str(b) for b in where[:5]) + (", …" if where.size > 5 else "")
                lines.append(f"{flag.name} ({int(flag)}): {where.size} of {n}, body {shown}")
        return "\n".join(lines)

    def save_end(self, path: str | os.PathLike[str]) -> None:
        """Write where the run ended to a file, whole or not at all: for ``propagate(resume=path)``.

        Raises ``ValueError`` where the trajectory does not hold it.
        """
        if self.end is None:
            raise ValueError("end: this trajectory does not hold it; accepted: one of propagate")
        self.end.save(path)

    @property
    def _step(self) -> str:
        steps = np.atleast_1d(self.dt)
        few = f"{steps.min():g}"
        return few if np.ptp(steps) == 0.0 else f"{few} to {steps.max():g}"

    def _shaped(self, value: NDArray[Any]) -> NDArray[Any]:
        return value[:, 0] if self.one_body else value


def _rate_of(law: Law) -> Callable[..., Any]:
    """The angular velocity of a law, (t, states, parameters)."""
    return lambda t, s, p: (law.formula(t, p, states=s)[:3],)
