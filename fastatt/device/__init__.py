"""Runs on a GPU: the formulas as a CUDA kernel, and the memory of the device."""
