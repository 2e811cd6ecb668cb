"""How long tests wait for what does come: for processes, threads and sessions, be the machine as busy as it may."""

PATIENCE = 120.0
"""Seconds after which a test has failed; nothing waits so long."""
