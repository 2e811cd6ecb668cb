"""Cassandra's text formats of models and their dialects: `.pomdp`, `.mdp`, MADP's `.dpomdp` and `.toi-dpomdp`."""
