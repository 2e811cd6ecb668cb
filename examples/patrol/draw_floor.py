"""Draw the demo's floor: six rooms as an occupancy grid, the image of their labels, and the graph of their goals.

The files are part of the example; run this again after moving a wall: ``python draw_floor.py``. A real floor comes from
a robot's mapping: ``mdm map draft`` makes the first image of labels of it, and a paint program the last.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mdm.maps import Labels, load_graph, load_grid, save_labels

HERE = Path(__file__).parent
RESOLUTION, WIDTH, HEIGHT, WALL = 0.05, 16.5, 15.0, 0.15

ROOMS = {  # left, low, right, high: from wall to wall, in metres
    "ElevatorHallway": (9.0, 0.25, 16.25, 3.5),
    "WestCorridor": (13.0, 3.5, 16.25, 8.0),
    "CoffeeRoom": (4.5, 10.75, 11.5, 14.75),
    "SouthCorridor": (0.25, 8.0, 16.25, 10.75),
    "LRM": (0.25, 3.75, 8.5, 8.0),
    "SoccerField": (0.25, 0.25, 8.5, 3.75),
}
DOORS = (
    (13.1, 7.9, 16.15, 8.1),  # between the corridors there is no wall
    (13.8, 3.3, 15.2, 3.7),
    (7.4, 10.5, 8.8, 11.0),
    (2.0, 7.8, 3.4, 8.2),
    (3.2, 3.5, 5.4, 4.0),
)
FURNITURE = ((5.2, 13.2, 7.0, 14.2), (5.5, 5.6, 7.6, 6.6), (9.3, 0.5, 10.8, 1.1), (9.6, 12.4, 10.6, 13.4))
GOALS = {  # x, y, yaw; and where each way leads to
    "ElevatorHallway": ((12.4, 1.9, 3.1416), {"Up": "WestCorridor"}),
    "WestCorridor": ((14.6, 5.8, -1.5708), {"Down": "ElevatorHallway", "Left": "SouthCorridor"}),
    "CoffeeRoom": ((8.1, 12.8, 1.5708), {"Down": "SouthCorridor"}),
    "SouthCorridor": ((8.0, 9.4, 3.1416), {"Down": "LRM", "Right": "WestCorridor", "Up": "CoffeeRoom"}),
    "LRM": ((3.0, 5.9, 1.5708), {"Down": "SoccerField", "Up": "SouthCorridor"}),
    "SoccerField": ((4.3, 1.9, 0.0), {"Up": "LRM"}),
}


def draw() -> tuple[np.ndarray, np.ndarray]:
    """Return what is free, and the room of each cell counted from 1: arrays with the uppermost row first."""
    rows, columns = round(HEIGHT / RESOLUTION), round(WIDTH / RESOLUTION)
    x = (np.arange(columns) + 0.5) * RESOLUTION
    y = HEIGHT - (np.arange(rows)[:, None] + 0.5) * RESOLUTION

    def inside(left: float, low: float, right: float, high: float, margin: float = 0.0) -> np.ndarray:
        return (x > left + margin) & (x < right - margin) & (y > low + margin) & (y < high - margin)

    free, rooms = np.zeros((rows, columns), dtype=bool), np.zeros((rows, columns), dtype=np.uint16)
    for number, room in enumerate(ROOMS.values(), 1):
        free |= inside(*room, WALL / 2)
        rooms[inside(*room)] = number
    for door in DOORS:
        free |= inside(*door)
    for thing in FURNITURE:
        free &= ~inside(*thing)
    return free, np.where(free, rooms, 0).astype(np.uint16)


def main() -> None:
    """Write the files."""
    free, rooms = draw()
    shades = np.where(free, 254, np.where(rooms > 0, 205, 0)).astype(np.uint8)
    (HERE / "floor.pgm").write_bytes(f"P5 {free.shape[1]} {free.shape[0]} 255\n".encode() + shades.tobytes())
    (HERE / "floor.yaml").write_text(
        f"image: floor.pgm\nresolution: {RESOLUTION}\norigin: [0.0, 0.0, 0.0]\n"
        "negate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n"
    )
    lines = ["<TopologicalMap>"]
    for name, (goal, ways) in GOALS.items():
        lines += [f'  <Node name="{name}">', f"    <Goal>{' '.join(map(str, goal))}</Goal>", "    <Connections>"]
        lines += [f'      <Connection label="{label}">{target}</Connection>' for label, target in ways.items()]
        lines += ["    </Connections>", "  </Node>"]
    (HERE / "floor.xml").write_text("\n".join([*lines, "</TopologicalMap>"]) + "\n")
    grid, graph = load_grid(HERE / "floor.yaml"), load_graph(HERE / "floor.xml")
    names = tuple(ROOMS)
    assert set(names) == set(graph.names)
    save_labels(Labels(grid.frame, rooms, names), HERE / "labels.png")


if __name__ == "__main__":
    main()
