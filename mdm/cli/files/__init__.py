"""Verbs that look at what a file holds, write it in another format, or make it."""
