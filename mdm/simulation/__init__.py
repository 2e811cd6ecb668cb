"""Worlds that a model drives: closing the loop without a robot."""
