"""Predicates and events on sensors: their declarations, reports, values and formulas."""
