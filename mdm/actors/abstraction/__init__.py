"""From predicates and events to the states and observations that are decided on."""
