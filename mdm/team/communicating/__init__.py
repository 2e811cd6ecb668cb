"""Agents that decide by their own knowledge: its computation, and when to share it."""
