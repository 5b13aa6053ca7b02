"""Graphs of operations as machine code: emitted by ``llvmlite``, compiled by Numba."""
