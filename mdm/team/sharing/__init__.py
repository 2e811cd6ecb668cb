"""What agents share beside their decisions: channels, predicates, and calls to each other's ensembles."""
