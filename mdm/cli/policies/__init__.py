"""Verbs that compute policies, and tell what they are worth."""
