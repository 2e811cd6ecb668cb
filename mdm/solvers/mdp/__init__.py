"""Solvers of MDPs: value iteration, policy iteration and prioritised sweeping, over the stacked rows of T."""
