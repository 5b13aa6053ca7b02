"""Generated formulas without LLVM's optimiser: they compile in half the time, to the same bits."""

from __future__ import annotations

import contextlib

from numba import config

from fastatt.codegen import modules

_OPTIMISED = modules.cfunc
_FULL, _NONE = config.OPT, type(config.OPT)(0)


def _quick(*signature, **options):
    compiler = _OPTIMISED(*signature, **options)

    def compiled(function):
        config.OPT = _NONE
        try:
            return compiler(function)
        finally:
            config.OPT = _FULL

    return compiled


def use():
    """Compile generated formulas without the optimiser from now on."""
    modules.cfunc = _quick


@contextlib.contextmanager
def optimised():
    """Compile them as users do, for tests that look at machine code."""
    kept, modules.cfunc = modules.cfunc, _OPTIMISED
    try:
        yield
    finally:
        modules.cfunc = kept
