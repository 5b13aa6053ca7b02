"""A run on a GPU: its memory there, the launches of its kernel, and values that lie there."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fastatt import checks
from fastatt.device.kernel import kernel_of
from fastatt.engine.program import Layout

if TYPE_CHECKING:
    from fastatt.engine.job import Job
    from fastatt.engine.run import Run, Span

_THREADS = 128  # of a block
# of a launch, between two of which Ctrl-C is answered: about 0.1 s of many bodies, and of few
_BODY_STEPS, _STEPS = 1_000_000_000, 65_536


class Device:
    """A GPU, for the runs of one call.

    ``wrap`` makes the result's arrays of the device's; without it they are copied to the host.
    """

    def __init__(self, wrap: Callable[[Any], Any] | None = None) -> None:
        self.wrap = wrap
        #: the saves of the last run, where they were not copied
        self.saves: Any = None

    def program(self, job: Job) -> DeviceProgram:
        """The program of a job. Raises ``ValueError`` for formulas that no kernel can run."""
        return DeviceProgram(job, self)


class DeviceProgram:
    """A job's program on a GPU: all bodies at once.

    Raises ``ValueError`` for formulas that no kernel can run.
    """

    #: there is no machine code of the processor's
    entry = any_angle = 0

    def __init__(self, job: Job, device: Device) -> None:
        self.formulas, self.job, self._device = job.formulas, job, device
        self.layout = Layout(self.formulas)
        # a kernel knows of no tiles
        self._kernel = kernel_of(replace(job, width=1))

    def run(self, run: Run, span: Span) -> None:
        """Steps of a span, from the run's arrays on the host and back to them."""
        from numba import cuda

        setup = run.setup
        t0, h, share = run.times
        named = [np.ravel(table) for _, table in setup.tables]
        begins, saved = _slots(span)
        saves, norm_errors = run.results[:2]
        stages = np.array(self.job.method.stages, dtype=np.float64).reshape(-1, 3)
        sources = (*run.start, setup.bodies.params, run.states)
        written = (saves[saved], norm_errors[saved])
        needed = sum(
            x.nbytes for x in (*sources, *written, *named, setup.bodies.known, run.diagnostics)
        )
        _check_room(needed, cuda.current_context().get_memory_info().free)
        states, diagnostics = cuda.to_device(run.states), cuda.to_device(run.diagnostics)
        out, errors = (cuda.device_array(x.shape, x.dtype) for x in written)
        arguments = [
            *map(cuda.to_device, sources[:3]), states, out, errors, diagnostics,
            cuda.to_device(setup.bodies.known), cuda.to_device(stages),
            *map(float, (t0, h, share * h, setup.bounds[0])),
        ]  # fmt: skip
        slot = span.slot - saved.start
        constant = (span.n_steps, span.save_every, slot, span.projection, span.origin, span.block)
        last = [cuda.to_device(table) for table in named]
        bodies = len(run.states)
        threads = min(_THREADS, bodies)
        launch = self._kernel[-(-bodies // threads), threads]
        n = span.first
        while True:
            until = min(span.end_of_piece(n, min(_STEPS, _BODY_STEPS // bodies)), span.last)
            launch(*arguments, n, until, *constant, int(begins and n == span.first), *last)
            cuda.synchronize()
            n = until
            if n == span.last:
                break
        for there, host in (
            (states, run.states),
            (diagnostics, run.diagnostics),
            (errors, written[1]),
        ):
            _fetch(there, host)
        if self._device.wrap is None:
            _fetch(out, written[0])
        else:
            self._device.saves = self._device.wrap(out)


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


def _check_room(needed: int, free: float) -> None:
    """Raises ``MemoryError`` where a run's arrays do not fit the device."""
    if needed > free:
        raise MemoryError(
            f"device: the run takes {needed / 1e9:.3g} GB, {free / 1e9:.3g} GB are free; accepted: "
            "fewer bodies or saves, or on_save, which keeps few of them"
        )


def taken(device: object, given: Sequence[Any], *, stays: bool) -> tuple[Device, list[Any]]:
    """(the device, initial values in the host's memory).

    Where one of the values lies on the device and ``stays``, the saves stay there too: as CuPy's
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
