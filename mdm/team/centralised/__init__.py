"""Centralised teams: one agent decides for all, and the others propose their input and carry out its decisions."""
