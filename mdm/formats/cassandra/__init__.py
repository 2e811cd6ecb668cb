"""The formats of Cassandra's pomdp-solve: models (`.pomdp`, `.mdp`), alpha vectors and policy graphs."""
