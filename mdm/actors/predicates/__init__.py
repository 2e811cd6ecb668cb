"""Predicates and events on sensors: what is declared, told, kept and derived."""
