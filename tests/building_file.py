"""A building of several floors as files."""

from __future__ import annotations

from floor_file import GRAPH, write_floor

BUILDING = """# two floors
start = "ground.hall"

[floors.ground]
map = "ground/map.yaml"
graph = "ground/graph.xml"
labels = "ground/labels.ppm"

[floors.upper]
map = "upper/map.yaml"
graph = "upper/graph.xml"
labels = "upper/labels.ppm"

[lifts.lift]
stops = ["ground.store", "upper.store"]
seconds = 12.0
"""


def write_building(folder, text=BUILDING, *, graphs=None):
    """Write a file of two floors, each of which is the one of `floor_file`, and their files; return its path."""
    folder.mkdir(exist_ok=True)
    for floor in ("ground", "upper"):
        write_floor(folder / floor, graph=(graphs or {}).get(floor, GRAPH))
    (folder / "building.toml").write_text(text)
    return folder / "building.toml"
