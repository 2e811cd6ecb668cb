"""File formats of models and policies, one module per format."""

from mdm.formats.models import load_model, save_model
from mdm.formats.policies import check_policy_file, load_policy, load_rewards, save_policy

__all__ = ["check_policy_file", "load_model", "load_policy", "load_rewards", "save_model", "save_policy"]
