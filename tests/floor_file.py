"""A floor of three rooms as files: a map, an image of labels, a graph."""

from __future__ import annotations

import numpy as np

COLOURS = {"hall": (0, 255, 0), "office": (255, 0, 0), "store": (0, 0, 255)}
NUMBERS = {"hall": 255 << 8, "office": 255, "store": 255 << 16}
YAML = """image: {image}
resolution: 0.1
origin: [-1.0, 2.0, {yaw}]
negate: 0
occupied_thresh: 0.65
free_thresh: 0.196
"""
GRAPH = """<TopologicalMap>
    <Node name="hall">
        <Goal>0.0 3.0 0</Goal>
        <Connections>
            <Connection label="Up">office</Connection>
            <Connection label="Right">store</Connection>
        </Connections>
    </Node>
    <Node name="office">
        <Goal>0.0 5.0 1.5707963</Goal>
        <Connections><Connection label="Down">hall</Connection></Connections>
    </Node>
    <Node name="store">
        <Goal>2.0 3.5 -1.0</Goal>
        <Connections><Connection label="Left">hall</Connection></Connections>
    </Node>
</TopologicalMap>
"""


def rooms():
    """Return for each of 40 x 40 cells its room: a hall, an office above, a store to the right; "" in walls."""
    raster = np.full((40, 40), "", dtype="U8")
    raster[21:39, 1:19] = "hall"
    raster[1:20, 1:19] = "office"
    raster[1:39, 20:39] = "store"
    raster[20, 8:12] = "hall"  # a door
    raster[28:33, 19] = "hall"  # and another one
    return raster


def free():
    """Return for each cell whether it is free."""
    return rooms() != ""


def write_pgm(path, pixels, most=255):
    rows, columns = pixels.shape
    kind = ">u1" if most < 256 else ">u2"
    path.write_bytes(f"P5\n# a comment\n{columns} {rows}\n{most}\n".encode() + pixels.astype(kind).tobytes())


def write_floor(folder, *, yaw=0.0, raster=None, graph=GRAPH):
    """Write map.yaml, map.pgm, labels.ppm and graph.xml; return their paths, the image of the map left out."""
    folder.mkdir(exist_ok=True)
    raster = rooms() if raster is None else raster
    write_pgm(folder / "map.pgm", np.where(raster != "", 254, 0))
    (folder / "map.yaml").write_text(YAML.format(image="map.pgm", yaw=yaw))
    pixels = np.full((*raster.shape, 3), 200, dtype=np.uint8)
    for name, colour in COLOURS.items():
        pixels[raster == name] = colour
    rows, columns = raster.shape
    (folder / "labels.ppm").write_bytes(f"P6 {columns} {rows} 255\n".encode() + pixels.tobytes())
    (folder / "graph.xml").write_text(graph)
    return folder / "map.yaml", folder / "labels.ppm", folder / "graph.xml"
