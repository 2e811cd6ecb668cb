"""Safety and liveness: the modes of an ensemble, and what carries them out."""
