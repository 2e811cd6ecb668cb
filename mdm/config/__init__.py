"""Configuration of a system of ensembles by a TOML file, equivalent to the Python API."""

from mdm.config.builder import load_system
from mdm.config.system import System

__all__ = ["System", "load_system"]
