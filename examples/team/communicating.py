"""What the robots of communicating.toml would get for how many messages, by communication policy.

Run it with ``python communicating.py``; ``--episodes 1000`` for narrower intervals.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import mdm
from mdm.simulation import evaluate_communication
from mdm.team import Always, Budget, Never, OnChange, ValueOfCommunication

HERE = Path(__file__).parent
POLICIES = {
    "Always()": Always(),
    "OnChange()": OnChange(),
    "Budget(0.5)": Budget(0.5),
    "ValueOfCommunication(0.05)": ValueOfCommunication(0.05),
    "ValueOfCommunication(0.5)": ValueOfCommunication(0.5),
    "ValueOfCommunication(2.0)": ValueOfCommunication(2.0),
    "Never()": Never(),
}


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--episodes", type=int, default=100, help="for each of them (100)")
    episodes = parser.parse_args().episodes
    model = mdm.load_model(HERE / "meeting.npz")
    policy = mdm.load_policy(HERE / "meeting.vf", model)
    print(f"{'communication policy':28}{'return':>8}   {'95 % interval':18}{'messages per step':>18}")
    for name, communication in POLICIES.items():
        result = evaluate_communication(
            model, policy, communication, episodes=episodes, steps=50, period=0.5, seed=1, on_impossible="predict"
        )
        low, high = result.interval
        print(f"{name:28}{result.mean:8.2f}   {f'{low:.2f} to {high:.2f}':18}{result.messages_per_step:18.2f}")


if __name__ == "__main__":
    main()
