"""A run on a GPU: its memory there, the launches of its kernel, and values that lie there."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fastatt import checks
from fastatt.device import Device
from fastatt.device.kernel import kernel_of
from fastatt.engine.layout import BLOCK
from fastatt.engine.plain import judged

if TYPE_CHECKING:
    from fastatt.engine.ensemble import Span
    from fastatt.engine.job import Job

_THREADS = 128  # of a block
# of a launch, between two of which Ctrl-C is answered: about 0.1 s of many bodies, and of few
_BODY_STEPS, _STEPS = 1_000_000_000, 65_536
_INPUTS = ("q0", "y0", "p", "x", "watch", "known", "stages")


class DeviceProgram:
    """What ``fastatt.engine.plain.PlainProgram`` is, on a GPU: all bodies at once.

    Raises ``ValueError`` for formulas that no kernel can run.
    """

    def __init__(self, job: Job, device: Device) -> None:
        self.formulas, self.job, self._device = job.formulas, job, device
        # a kernel knows of no tiles
        self._kernel = kernel_of(replace(job, width=1))

    def run(
        self, arrays: Mapping[str, Any], numbers: Mapping[str, float], span: Span,
        tiles: tuple[int, int], tables: Mapping[Any, Any],
    ) -> tuple[float, float]:  # fmt: skip
        """Steps of a span, from the arrays of the host and back to them; as of ``PlainProgram``."""
        from numba import cuda

        named = [np.ravel(tables[name]) for name in self.formulas.resources]
        begins, saved = _slots(span)
        host = {**arrays, "out": arrays["out"][saved], "defect": arrays["defect"][saved]}
        needed = sum(x.nbytes for x in (*host.values(), *named))
        _check_room(needed, cuda.current_context().get_memory_info().free)
        there = {name: cuda.to_device(_rows(arrays[name], name)) for name in _INPUTS}
        for name in ("out", "defect"):
            there[name] = cuda.device_array(host[name].shape, host[name].dtype)
        arguments = [
            *(there[name] for name in ("q0", "y0", "p", "x", "out", "defect", "watch", "known")),
            there["stages"],
            *(float(numbers[name]) for name in ("t0", "h", "edge", "quiet")),
        ]
        slot = span.slot - saved.start
        constant = (span.n_steps, span.save_every, slot, span.restore, span.origin)
        last = [cuda.to_device(table) for table in named]
        bodies = len(arrays["x"])
        threads = min(_THREADS, bodies)
        launch = self._kernel[-(-bodies // threads), threads]
        steps = max(1, min(_STEPS, _BODY_STEPS // bodies) // BLOCK) * BLOCK
        n = span.first
        while True:
            until = min(n + steps, span.last)
            launch(*arguments, n, until, *constant, int(begins and n == span.first), *last)
            cuda.synchronize()
            n = until
            if n == span.last:
                break
        for name in ("x", "watch", "defect"):
            _fetch(there[name], host[name])
        if self._device.wrap is None:
            _fetch(there["out"], host["out"])
        else:
            self._device.saves = self._device.wrap(there["out"])
        return judged(self.job, arrays, numbers, np.arange(bodies))


def _slots(span: Span) -> tuple[bool, slice]:
    """(whether the initial state is saved, slots of the saves) of a span."""
    begins = span.first == span.origin and (span.slot == 1 or span.n_steps == span.origin)
    gone, reached, every = span.first - span.origin, span.last - span.origin, span.save_every
    first = 0 if begins else gone // every + span.slot
    if span.first == span.last:
        return begins, slice(first, first + begins)
    saves = -(-reached // every) if span.last == span.n_steps else reached // every
    return begins, slice(first, max(first + begins, saves + span.slot))


def _fetch(there: Any, host: NDArray[Any]) -> None:
    if host.size:
        there.copy_to_host(host)


def _rows(array: NDArray[Any], name: str) -> NDArray[Any]:
    return np.atleast_2d(array) if name in ("q0", "y0") else array


def _check_room(needed: int, free: float) -> None:
    """Raises ``MemoryError`` where a run's arrays do not fit the device."""
    if needed > free:
        raise MemoryError(
            f"device: the run takes {needed / 1e9:.3g} GB, {free / 1e9:.3g} GB are free; accepted: "
            "fewer bodies or saves, or a sink, which keeps few of them"
        )


def taken(device: object, given: Sequence[Any], *, stays: bool) -> tuple[Device, list[Any]]:
    """(the device, initial values in the host's memory).

    Where one of the values lies on the device and ``stays``, what is handed out does too: as CuPy's
    arrays if one is, else as Numba's.

    Raises ``ValueError`` for a device other than "cuda", and where there is none.
    """
    checks.choice("device", device, ("cuda",))
    try:
        from numba import cuda

        reason = "" if cuda.is_available() else str(cuda.cuda_error() or "no GPU is there")
    except ImportError as error:
        reason = str(error)
    if reason:
        reason = " ".join(reason.split())
        raise ValueError(
            f'device: found "cuda", which Numba cannot use ({reason}); accepted: '
            "None, or on a machine with an NVIDIA GPU pip install 'fastatt[cuda]'"
        )
    there = [x for x in given if _lies_there(x)]
    wrap: Callable[[Any], Any] | None = None
    if there and stays:
        wrap = _as_it_is
        if any(type(x).__module__.partition(".")[0] == "cupy" for x in there):
            import cupy

            wrap = cupy.asarray
    return Device(wrap), [_on_host(x) if _lies_there(x) else x for x in given]


def _lies_there(value: Any) -> bool:
    return hasattr(value, "__cuda_array_interface__") or hasattr(value, "copy_to_host")


def _on_host(value: Any) -> NDArray[Any]:
    from numba import cuda

    if not hasattr(value, "copy_to_host"):
        value = cuda.as_cuda_array(value)
    return np.asarray(value.copy_to_host())


def _as_it_is(x: Any) -> Any:
    return x
