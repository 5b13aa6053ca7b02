"""Formulas called once with numbers that record them, and what is made of the record."""
