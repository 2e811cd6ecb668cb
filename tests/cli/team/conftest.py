"""Teams of rooms, in processes of their own."""

from __future__ import annotations

import pytest
import team_processes
from team_file import write


@pytest.fixture
def up():
    return team_processes.up


@pytest.fixture
def free(tmp_path):
    """Write the file of the team of rooms, with replacements, whose agents listen where nobody else does."""

    def make(*changes):
        path = write(tmp_path, *changes)
        path.write_text(team_processes.on_free_ports(path.read_text().replace("port = 7600\n", "")))
        return path

    return make
