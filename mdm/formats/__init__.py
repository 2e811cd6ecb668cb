"""File formats of models, policies and durations, in folders by the program that wrote them, one module per format."""

from mdm.formats.archive.model import load_durations, save_durations
from mdm.formats.files import check_policy_file, load_model, load_policy, load_rewards, save_model, save_policy

__all__ = [
    "check_policy_file",
    "load_durations",
    "load_model",
    "load_policy",
    "load_rewards",
    "save_durations",
    "save_model",
    "save_policy",
]
