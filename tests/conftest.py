"""Shared settings of the tests: hypothesis profiles and the corpus, where it is present."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

import pytest
from hypothesis import HealthCheck, settings
from places import CORPUS

if TYPE_CHECKING:
    from pathlib import Path

settings.register_profile("default", deadline=None, max_examples=100, suppress_health_check=[HealthCheck.too_slow])
settings.register_profile("thorough", parent=settings.get_profile("default"), max_examples=2000)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "default"))


@pytest.fixture(scope="session")
def corpus() -> Path:
    """The folder of real model and policy files that may stand beside a checkout."""
    if not CORPUS.is_dir():
        pytest.skip("the corpus of real models is not beside this checkout (../shared/corpus)")
    return CORPUS
