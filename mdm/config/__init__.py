"""The TOML file that describes a system of ensembles; it means what the Python API means."""

from mdm.config.builder import load_system
from mdm.config.system import System

__all__ = ["System", "load_system"]
