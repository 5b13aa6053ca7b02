"""Tracing: formulas are called once with numbers that record the operations on them."""
