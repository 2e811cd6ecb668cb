"""Cassandra's text formats for models and MADP's dialects: `.pomdp`, `.mdp`, `.dpomdp` and `.toi-dpomdp`."""
