"""Markov decision making for real agents: the public names, and nothing else."""
