"""Control: a controller with a drive, what it plans with, and what it publishes."""
