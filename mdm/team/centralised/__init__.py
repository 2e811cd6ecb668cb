"""Centralised teams: one agent decides for all, and the others propose what they see and carry out its decisions."""
