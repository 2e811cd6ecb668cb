"""Configuration of a system of ensembles, or of a team, by a TOML file, equivalent to the Python API."""

from mdm.config.builder import System, load_system, load_team, load_team_file, look_over

__all__ = ["System", "load_system", "load_team", "load_team_file", "look_over"]
