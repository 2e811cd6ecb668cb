"""Verbs that run ensembles: in the world, or on given stimuli."""
