"""Safety and liveness: the modes of an ensemble, and the layers' part in them."""
