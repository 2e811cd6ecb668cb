"""A floor's files, as arguments of the command."""

from __future__ import annotations

import shutil

import pytest
from floor_file import write_floor


@pytest.fixture
def floor(tmp_path):
    return [str(path) for path in write_floor(tmp_path / "floor")]


@pytest.fixture
def original(corpus, tmp_path):
    """The files of the original's demo, in the folders that they name."""
    for folder, name in (("config", "ISR_rviz_map.yaml"), ("maps", "ISR_rviz_map.pgm")):
        (tmp_path / folder).mkdir()
        shutil.copy(corpus / "topology" / name, tmp_path / folder)
    files = corpus / "topology"
    return [tmp_path / "config" / "ISR_rviz_map.yaml", files / "ISR_label_map.png", files / "topological_map.xml"]
