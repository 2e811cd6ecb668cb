"""An interpreter that has Storm, which is installed once in a run of the tests by pip as it is configured.

MDM_STORM_PYTHON names an interpreter that has stormpy.
"""

from __future__ import annotations

import fcntl
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

HERE = Path(__file__).parent
TEXT = {"capture_output": True, "text": True, "check": False}


def interpreter(folder):
    """Return an interpreter that has Storm, in an environment that is made in a folder; skip where it cannot be had."""
    if (given := os.environ.get("MDM_STORM_PYTHON")) is not None:
        return Path(given)
    made, said = folder / "storm", folder / "storm.said"
    with (folder / "storm.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not said.exists():
            subprocess.run([sys.executable, "-m", "venv", made], check=True)
            command = [made / "bin" / "python", "-m", "pip", "install", "-q", "--disable-pip-version-check"]
            done = subprocess.run([*command, "stormpy>=2.0"], **TEXT)
            said.write_text(done.stderr.strip().rpartition("\n")[2] if done.returncode else "")
    if why := said.read_text():
        pytest.skip(f"Storm's wheels cannot be had: {why}")
    return made / "bin" / "python"


def answers(python, questions):
    """Return the numbers of Storm, as texts: fractions, or ``inf``; a list for each question.

    One that is asked ``everywhere`` has a list of all states in place of each number.
    """
    done = subprocess.run([python, HERE / "storm_program.py"], input=json.dumps(questions), **TEXT)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)
