"""Configuration of a system of ensembles, or of a team, by a TOML file, equivalent to the Python API."""

from mdm.config.builder import System, load_system, load_team, load_team_file, look_over
from mdm.config.readers import Reading, TableReader

__all__ = ["Reading", "System", "TableReader", "load_system", "load_team", "load_team_file", "look_over"]
