"""A generated function in two forms: the small-angle form, and the any-angle form."""

from __future__ import annotations

import threading
from abc import ABC, abstractmethod
from typing import Any

from fastatt._store import alone
from fastatt.codegen.modules import MachineCode


class TwoForms(ABC):
    """The function that a loop calls; its any-angle form is compiled when first needed.

    ``entry`` and ``any_angle`` are addresses; ``any_angle`` is 0 until ``compile_any_angle``. With
    ``one_form`` both are the same.
    """

    def __init__(self, *, one_form: bool = False) -> None:
        made = self._compiled(small_angle=True)
        #: the compiled forms; their machine code lives as long as these
        self.functions = [made]
        self.entry = made.address
        self.any_angle: int = self.entry if one_form else 0
        self._memory = threading.local()

    @abstractmethod
    def _compiled(self, *, small_angle: bool) -> MachineCode:
        """One of the forms."""

    @abstractmethod
    def _new_memory(self) -> Any:
        """The memory of one thread."""

    def compile_any_angle(self) -> None:
        """Compile the any-angle form, if it is not compiled."""
        with alone():
            if self.any_angle == 0:
                made = self._compiled(small_angle=False)
                self.functions.append(made)
                self.any_angle = made.address

    def memory(self) -> Any:
        """The calling thread's memory."""
        own = self._memory
        if not hasattr(own, "made"):
            own.made = self._new_memory()
        return own.made
