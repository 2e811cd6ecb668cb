"""Agents that decide on what they know: what each knows, and when to tell it."""
