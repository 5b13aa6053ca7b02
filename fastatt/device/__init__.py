"""A run on a GPU: the same formulas as a CUDA kernel, and the memory that it works on."""
