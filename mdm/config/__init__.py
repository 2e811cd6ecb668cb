"""Configuration of a system of ensembles, or of a team, by a TOML file, equivalent to the Python API."""

from mdm.config.builder import load_system, load_team, load_team_file, look_over
from mdm.config.system import System

__all__ = ["System", "load_system", "load_team", "load_team_file", "look_over"]
