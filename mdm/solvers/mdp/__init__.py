"""Solvers of MDPs: value iteration, policy iteration and prioritised sweeping, over one stacked matrix."""
