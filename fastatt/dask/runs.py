"""Runs in chunks: attitudes as Dask arrays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fastatt import arrays, checks
from fastatt.attitudes import Attitude
from fastatt.dask.chunks import Bodies, like, nothing
from fastatt.methods import METHODS, Method
from fastatt.propagation import closed_form
from fastatt.propagation.choice_of_method import chosen
from fastatt.propagation.options import Clock
from fastatt.propagation.propagate import propagate as run_chunk
from fastatt.scene.scene import Scene, as_scene


@dataclass(frozen=True, eq=False)
class LazyTrajectory:
    """What a run will give, as Dask arrays in chunks of bodies.

    ``t`` (S,) s is known. ``q`` (S, N, 4), ``w`` (S, N, 3) rad/s in body axes, ``status`` (N,), of
    a scene with mass ``v`` (S, N, 3) m/s and, given r0, ``r`` (S, N, 3) m, else None.
    ``dask.compute`` takes all of it at once, and gives the same with numpy arrays.
    """

    t: NDArray[np.float64]
    q: Any
    w: Any
    status: Any
    method: str
    v: Any = None
    r: Any = None
    #: the matrices, where they are what is propagated
    matrix: Any = None

    @property
    def dcm(self) -> Any:
        """Direction cosine matrices (S, N, 3, 3), body to inertial."""
        if self.matrix is not None:
            return self.matrix
        if isinstance(self.q, np.ndarray):
            return arrays.quat_to_dcm(self.q)
        chunks = (*self.q.chunks[:2], (3,), (3,))
        return self.q.map_blocks(
            arrays.quat_to_dcm, chunks=chunks, new_axis=3, meta=nothing(4, self.q.dtype)
        )


def propagate(
    scene: Scene,
    q0: Any = None,
    w0: Any = None,
    *,
    v0: Any = None,
    r0: Any = None,
    dt: float,
    n_steps: int,
    chunks: int | Sequence[int] | None = None,
    method: str | Method | None = None,
    representation: str | Attitude = "quat",
    save_every: int | None = None,
    dtype: Any = None,
    t0: float = 0.0,
    compensated: bool = False,
    normalise: str | int = "output",
    invalid: str = "raise",
) -> LazyTrajectory:
    """Propagate an ensemble in chunks of bodies, when it is computed.

    Parameters
    ----------
    scene : what acts; where bodies have their own numbers, each chunk is sent its own.
    q0, w0, v0, r0 : as of :func:`fastatt.propagate`, numpy or Dask arrays, one of them with a row
        for each body. Numpy arrays travel with the graph; what is large is better made by Dask.
    chunks : bodies of a chunk, or of each; None takes those of the first Dask array, else 100 000.
    dt, n_steps : numbers, the same for all bodies.
    method, representation, save_every, dtype, t0, compensated, normalise, invalid : as of
        :func:`fastatt.propagate`. With ``invalid`` "raise" a bad body in a Dask array
        fails its chunk, and the error has a note of which bodies those are.

    Returns
    -------
    LazyTrajectory : Dask arrays with the bits that ``fastatt.propagate`` gives.

    Raises
    ------
    ValueError, TypeError : an argument that does not fit, by name, with what is accepted.

    Examples
    --------
    >>> import fastatt as fa
    >>> from fastatt import dask as fd
    >>> scene = fa.Scene(inertia=(2.0, 1.0, 2 / 3))
    >>> lazy = fd.propagate(scene, [[1, 0, 0, 0]] * 5, [0.1, 0.2, 0.3], dt=0.1, n_steps=9, chunks=2)
    >>> lazy.q.chunks
    ((1,), (2, 2, 1), (4,))
    >>> lazy.q.compute().shape
    (1, 5, 4)
    """
    record, named = sent(scene, method, representation, compensated, normalise)
    clock = Clock.of(dt, n_steps, save_every)
    begin = checks.real("t0", t0)
    flag = checks.choice("invalid", invalid, closed_form.INVALID) == "flag"
    bodies = Bodies.of(scene, (q0, w0, v0, r0), chunks, flag=flag)
    kind = checks.precision(dtype, *map(like, (q0, w0, v0, r0)))
    options = {
        "dt": dt, "n_steps": n_steps, "save_every": save_every, "method": named, "dtype": kind,
        "representation": representation, "compensated": compensated, "normalise": normalise,
        "invalid": invalid, "t0": begin,
    }  # fmt: skip
    is_matrix = chosen(scene, record, representation, False, normalise).attitude.to_dcm_array
    shapes: dict[str, tuple[int, ...]] = {"q": (4,), "w": (3,)}
    shapes |= {"dcm": (3, 3)} if is_matrix is not None else {}
    shapes |= {"v": (3,)} if scene.moves else {}
    shapes |= {"r": (3,)} if r0 is not None else {}
    t = clock.times(begin)
    runs = bodies.mapped(partial(_propagated, names=(*shapes, "status"), options=options))
    found = {name: bodies.array(runs, name, (t.size,), kind, shapes[name]) for name in shapes}
    status = bodies.array(runs, "status", (), np.uint8, ())
    matrix = found.pop("dcm", None)
    return LazyTrajectory(t, status=status, method=record.name, matrix=matrix, **found)


def sent(
    scene: Scene,
    method: str | Method | None,
    representation: str | Attitude,
    compensated: bool = False,
    normalise: str | int = "output",
) -> tuple[Method, str | Method]:
    """A method that fits the whole ensemble, and how it is sent."""
    record = chosen(as_scene(scene), method, representation, compensated, normalise).method
    return record, record.name if METHODS.get(record.name) is record else record


def _propagated(
    scene: Scene, states: Sequence[Any], names: Sequence[str], options: dict[str, Any]
) -> dict[str, Any]:
    q0, w0, v0, r0 = states
    run = run_chunk(scene, q0, w0, v0=v0, r0=r0, n_threads=1, **options)
    return {name: getattr(run, name) for name in names}
