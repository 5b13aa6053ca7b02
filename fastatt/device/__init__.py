"""A run on a GPU: the same formulas as a CUDA kernel, and the memory that it works on."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any


class Device:
    """A GPU, for the runs of one call.

    ``wrap`` makes of the device's saves what is handed out; where it is None they are copied to the
    host.
    """

    def __init__(self, wrap: Callable[[Any], Any] | None = None) -> None:
        self.wrap = wrap
        #: the saves of the last run, where they were not copied
        self.saves: Any = None

    def program(self, job: Any) -> Any:
        """What runs a job there.

        Raises ``ValueError`` for formulas that no kernel can run.
        """
        from fastatt.device.program import DeviceProgram

        return DeviceProgram(job, self)
