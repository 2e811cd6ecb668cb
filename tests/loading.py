"""Models of files whose numbers are known to be inexact, without the warnings that tell of it."""

from __future__ import annotations

import warnings

from mdm import load_model
from mdm.errors import ModelWarning


def load(path, **options):
    """Return a file's model; a factored one is flattened."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ModelWarning)
        model = load_model(path, **options)
        model.flatten()
        return model
