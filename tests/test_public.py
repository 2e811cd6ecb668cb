"""The public names: listed, importable, documented."""

from __future__ import annotations

import inspect

import pytest

import mdm
import mdm.actors
import mdm.config
import mdm.formats
import mdm.logic
import mdm.messages
import mdm.models
import mdm.policies
import mdm.runtime
import mdm.simulation
import mdm.testing

PACKAGES = [mdm, mdm.actors, mdm.config, mdm.formats, mdm.logic, mdm.messages, mdm.models, mdm.policies, mdm.runtime]
PACKAGES += [mdm.simulation, mdm.testing]


@pytest.mark.parametrize("package", PACKAGES, ids=lambda package: package.__name__)
def test_every_listed_name_is_there_and_documented(package):
    for name in package.__all__:
        thing = getattr(package, name)
        if inspect.isclass(thing) or inspect.isfunction(thing):
            assert thing.__doc__, f"{package.__name__}.{name} has no docstring"


def test_every_public_name_of_the_packages_is_listed():
    for package in PACKAGES:
        public = {
            name
            for name, thing in vars(package).items()
            if not name.startswith("_") and getattr(thing, "__module__", "").startswith(f"{package.__name__}.")
        }
        assert public <= set(package.__all__), package.__name__
