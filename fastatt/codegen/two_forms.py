"""A generated function in two forms: the small-angle form, and the any-angle form."""

from __future__ import annotations

import threading
from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any

from numba.core.compiler_lock import global_compiler_lock
from numpy.typing import NDArray

from fastatt.codegen.memory import address_of


class TwoForms(ABC):
    """The function that a loop calls; its any-angle form is compiled when first needed.

    ``entry`` and ``any_angle`` are addresses, or Python functions if ``plain``; ``any_angle`` is 0
    until ``compile_any_angle``. With ``one_form`` both are the same.
    """

    def __init__(self, *, plain: bool, one_form: bool = False) -> None:
        self.plain = plain
        made = self._compiled(small_angle=True)
        #: the forms that are compiled
        self.functions = [made]
        self.entry = made if plain else made.address
        self.any_angle: Any = self.entry if one_form else 0
        self._memory = threading.local()

    @abstractmethod
    def _compiled(self, *, small_angle: bool) -> Any:
        """One of the forms: a function of Numba's, or of Python if ``plain``."""

    @abstractmethod
    def _new_memory(self) -> Sequence[NDArray[Any]]:
        """Arrays for one thread's calls of the loop."""

    def compile_any_angle(self) -> None:
        """Compile the any-angle form, if it is not compiled."""
        with global_compiler_lock:  # a fork waits for it
            if self.any_angle == 0:
                made = self._compiled(small_angle=False)
                self.functions.append(made)
                self.any_angle = made if self.plain else made.address

    def memory(self) -> list[Any]:
        """The calling thread's memory, in the form that the loop takes."""
        own = self._memory
        if not hasattr(own, "places"):
            own.arrays = self._new_memory()
            own.places = own.arrays if self.plain else [address_of(x) for x in own.arrays]
        return own.places  # type: ignore[no-any-return]
