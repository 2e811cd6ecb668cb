"""Sharing beside decisions: channels, predicates, and calls to each other's ensembles."""
