"""File formats of models and policies, one module each; `load_model` and `load_policy` choose by content."""

from mdm.formats.loader import load_model, load_policy, load_rewards

__all__ = ["load_model", "load_policy", "load_rewards"]
