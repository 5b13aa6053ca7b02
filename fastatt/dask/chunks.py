"""Ensembles in chunks: the tasks that are sent to workers, and Dask arrays of their results."""

from __future__ import annotations

import math
import operator
import sys
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any
from uuid import uuid4

import dask.array as da
import numpy as np
from dask import delayed
from dask.highlevelgraph import HighLevelGraph
from numpy.typing import NDArray

from fastatt import checks, rounding
from fastatt.propagation.initial import INITIAL, initial
from fastatt.scene.scene import Scene, as_scene

# bodies of a chunk, for 0.5 s of a thousand steps and 6 MB of states
_CHUNK = 100_000
#: replaces states that Dask computes
_LATER = "later"


@dataclass(eq=False)
class Part:
    """The bodies of a chunk: their scene, None for the shared one, and their states."""

    first: int
    last: int
    scene: Scene | None
    states: list[Any]


@dataclass(eq=False)
class Work:
    """The function that is applied to each chunk, with a scene that all bodies share; sent once."""

    function: Callable[..., Any]
    scene: Scene | None

    def __call__(self, part: Part, *lazy: Any) -> Any:
        """Apply the function to a chunk."""
        scene = self.scene if part.scene is None else part.scene
        computed = iter(lazy)
        states = [next(computed) if isinstance(x, str) else x for x in part.states]
        with rounding.noted() as texts:
            try:
                return self.function(scene, states)
            except Exception as error:
                error.add_note(f"in the chunk of bodies {part.first} to {part.last - 1}")
                raise
            finally:
                for text in texts:
                    _warn(f"bodies {part.first} to {part.last - 1}: {text}")


def _warn(text: str) -> None:
    """Warn here and, on a worker, in the client's process."""
    warn: Callable[..., Any] = warnings.warn
    if "distributed" in sys.modules:
        from distributed import warn
    warn(text, rounding.StepWarning)


@dataclass(frozen=True, eq=False)
class Bodies:
    """Initial states in chunks: Dask arrays, or values that all bodies share."""

    scene: Scene
    given: tuple[Any, ...]
    sizes: tuple[int, ...]

    @classmethod
    def of(cls, scene: Scene, values: Sequence[Any], chunks: Any, *, flag: bool) -> Bodies:
        """Initial states from checked NumPy arrays and Dask arrays of checked shapes.

        Raises ``ValueError`` or ``TypeError`` as ``propagate`` does.
        """
        as_scene(scene)
        lazy = {k: x for k, x in zip(INITIAL, values, strict=True) if isinstance(x, da.Array)}
        for name, x in lazy.items():
            if any(math.isnan(size) for size in x.shape):
                raise ValueError(
                    f"{name}: found chunks of unknown size; accepted: compute_chunk_sizes()"
                )
        start, beside = initial(scene, list(map(like, values)), flag=flag)
        known: dict[str, Any] = {**beside, "q0": start, **lazy}
        rows = [len(x) for x in known.values() if x.ndim == 2]
        if not rows:
            raise ValueError("q0: found one body; accepted: (N, 4), or another with N rows")
        n = max(rows)
        scene.packed(n)  # raises for another number of bodies
        sizes = _sizes(chunks, n, [x for x in lazy.values() if x.ndim == 2 and len(x) == n])
        given = tuple(_chunked(known[k], n, sizes) if k in known else None for k in INITIAL)
        return cls(scene, given, sizes)

    def mapped(self, function: Callable[..., Any]) -> Any:
        """``function(scene, states)`` of each chunk, as a Dask array with one block for each."""
        ends = np.cumsum(self.sizes).tolist()
        own = self.scene.packed(None).params.ndim == 2
        lazy = [x for x in self.given if isinstance(x, da.Array)]
        work = delayed(Work(function, None if own else self.scene), traverse=False)
        name = f"bodies-{uuid4().hex}"
        graph: dict[Any, Any] = {}
        # NumPy states are part of each task, since a further task would take milliseconds
        for i, (a, b) in enumerate(zip([0, *ends[:-1]], ends, strict=True)):
            part = Part(
                a, b, self.scene[a:b] if own else None, [_rows(x, a, b) for x in self.given]
            )
            keys = [(x.name, i, 0) if x.ndim == 2 else (x.name, 0) for x in lazy]
            graph[name, i] = (operator.call, work.key, part, *keys)
        needed = HighLevelGraph.from_collections(name, graph, dependencies=[*lazy, work])
        return da.Array(needed, name, ((1,) * len(self.sizes),), meta=_nothing(1, object))

    def array(
        self, runs: Any, name: str, saves: tuple[int, ...], kind: Any, tail: tuple[int, ...]
    ) -> Any:
        """One of the arrays of the chunks' trajectories."""
        chunks = (*((s,) for s in saves), self.sizes, *((k,) for k in tail))
        new = [k for k in range(len(chunks)) if k != len(saves)]
        meta = _nothing(len(chunks), kind)
        return runs.map_blocks(getattr, name, chunks=chunks, new_axis=new, meta=meta)

    def merged(self, merge: Callable[..., Any], function: Callable[..., Any]) -> Any:
        """``merge(results)`` of the results of all chunks, as a lazy value."""
        blocks = self.mapped(function).to_delayed().tolist()
        return delayed(merge, pure=False)(blocks)


def _sizes(chunks: Any, n: int, lazy: list[Any]) -> tuple[int, ...]:
    """The number of bodies of each chunk."""
    if chunks is None and lazy:
        return tuple(map(int, lazy[0].chunks[0]))
    if isinstance(chunks, str) or not np.iterable(chunks):
        size = _CHUNK if chunks is None else checks.whole("chunks", chunks, 1)
        return tuple(min(size, n - a) for a in range(0, n, size))
    found = tuple(checks.whole("chunks", size, 1) for size in chunks)
    if sum(found) != n:
        raise ValueError(f"chunks: found {sum(found)} bodies in all; accepted: {n}")
    return found


def _chunked(x: Any, n: int, sizes: tuple[int, ...]) -> Any:
    """An array with the chunks of the bodies, or one row, which all share."""
    if x.ndim == 2 and len(x) < n:
        x = x[0]
    return x.rechunk((sizes, -1)[2 - x.ndim :]) if isinstance(x, da.Array) else x


def _rows(x: Any, first: int, last: int) -> Any:
    """The bodies of a chunk."""
    if isinstance(x, da.Array):
        return _LATER
    return x if x is None or x.ndim == 1 else x[first:last]


def like(x: Any) -> Any:
    """An array of ones in place of one that Dask computes; anything else is returned as it is."""
    return np.broadcast_to(np.ones((), x.dtype), x.shape) if isinstance(x, da.Array) else x


def _nothing(ndim: int, kind: Any) -> NDArray[Any]:
    """An empty array with the type of the blocks, for Dask."""
    return np.empty((0,) * ndim, dtype=kind)
