"""Generated formulas without LLVM's optimiser: they compile in half the time, to the same bits."""

from __future__ import annotations

import contextlib

from numba import config

from fastatt.codegen import modules

_OPTIMISED = modules.linked_code
_FULL, _NONE = config.OPT, type(config.OPT)(0)


def _quick(function, signature):
    config.OPT = _NONE
    try:
        return _OPTIMISED(function, signature)
    finally:
        config.OPT = _FULL


def use():
    """Compile generated formulas without the optimiser from now on."""
    modules.linked_code = _quick


@contextlib.contextmanager
def optimised(libraries):
    """Compile them as users do, for tests that look at machine code, into a list of libraries."""

    def listed(function, signature):
        name, library = _OPTIMISED(function, signature)
        libraries.append(library)
        return name, library

    kept, modules.linked_code = modules.linked_code, listed
    try:
        yield
    finally:
        modules.linked_code = kept
