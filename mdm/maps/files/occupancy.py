"""Occupancy grids as ROS keeps them: a YAML file that says how to read the image beside it.

How numbers become free and occupied is as in Nav2's map_server, whose modes are kept:

* `trinary` (the default): darkness of `free_thresh` or less is free, else of `occupied_thresh` or more occupied, in
  between unknown. A pixel that is not opaque is unknown.
* `scale`: the same. Numbers in between, which are for planners, are unknown here.
* `raw`: brightness is the occupancy itself, in hundredths; the two thresholds tell it apart, and above 100 is unknown.

ROS 1's map_server leaves a darkness that meets a threshold exactly unknown, and in `trinary` counts opacity as a fourth
colour.
"""

from __future__ import annotations

import difflib
import warnings
from typing import TYPE_CHECKING

import numpy as np

from mdm.errors import MapError, MapWarning
from mdm.formats.source import Source
from mdm.maps.files.image import read_image
from mdm.maps.files.yaml_tree import read_yaml
from mdm.maps.raster import Frame, Grid

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from mdm.maps.files.yaml_tree import Entry

_MODES = ("trinary", "scale", "raw")
_KEYS = ("image", "resolution", "origin", "negate", "occupied_thresh", "free_thresh", "mode")
_TRUTH = {"0": False, "1": True, "false": False, "true": True, "no": False, "yes": True}
_WHAT = "the map"
_GREY, _MANY = 0.1, 0.01
"""How dark a grey is at least, and the share of cells that are many."""
_ROUNDING = 1e-6
"""A threshold that is met but for rounding is met; neighbouring brightnesses of 16 bits differ by more."""


def load_grid(path: str | Path) -> Grid:
    """Load an occupancy grid from ROS's `map.yaml` and its image.

    The path of the image is relative to the YAML file. `negate` may be missing, and is then 0, and `mode`.

    Raises:
        FormatError: If a file is missing or malformed.
        MapError: If the resolution is not positive, or PyYAML, or Pillow for a PNG, is not installed.
    """
    return _read(path)[0]


def free_grey(path: str | Path) -> tuple[float, int, float] | None:
    """Return the grey that a threshold makes free though there is a brighter free colour: most likely the unknown.

    Returns:
        Its brightness of 255, the number of its cells, and the threshold; None where there is no such grey.
    """
    grid, darkness, free = _read(path)
    shades, counts = np.unique(darkness[grid.free].round(3), return_counts=True)
    many = counts >= _MANY * darkness.size
    if many.sum() < 2 or shades[many][-1] < _GREY:
        return None
    grey = shades[many][-1]
    return round(float(255 * (1 - grey)), 1), int(counts[many][-1]), free


def _read(path: str | Path) -> tuple[Grid, NDArray[np.float64], float]:
    """Return the grid, how dark each cell is, and the threshold below which it is free."""
    source = Source(path)
    root = read_yaml(source)
    for key, entry in root.mapping(_WHAT).items():
        if key not in _KEYS:
            close = difflib.get_close_matches(key, _KEYS, n=1)
            hint = f": did you mean {close[0]!r}?" if close else ""
            warnings.warn(MapWarning(f"{path}:{entry.line}: the key {key!r} is not read{hint}"), stacklevel=2)
    picture = root.need("image", _WHAT).string("image")
    origin = root.need("origin", _WHAT)
    corner = [number.number("origin") for number in origin.list("origin")]
    if len(corner) != 3:
        origin.fail(f"origin: x, y and yaw of the lower left corner were expected, not {len(corner)} numbers")
    resolution = root.need("resolution", _WHAT)
    side = resolution.number("resolution")
    occupied, free = (_threshold(root.need(key, _WHAT), key) for key in ("occupied_thresh", "free_thresh"))
    if free > occupied:
        root.need("free_thresh", _WHAT).fail(f"free_thresh, {free:g}, is above occupied_thresh, {occupied:g}")
    mode, negate = "trinary", False
    if (given := root.get("mode", _WHAT)) is not None and (mode := given.string("mode")) not in _MODES:
        given.fail(f"mode: one of {', '.join(_MODES)} was expected, not {mode!r}")
    if (given := root.get("negate", _WHAT)) is not None:
        truth = _TRUTH.get(given.string("negate").lower())
        negate = given.fail(f"negate: 0 or 1 was expected, not {given.content!r}") if truth is None else truth
    image = read_image(source.path.parent / picture)
    try:
        frame = Frame(*image.shape, side, *corner)
    except MapError as error:
        resolution.fail(str(error))
    if mode == "raw" and negate:
        root.need("negate", _WHAT).fail("with the mode raw servers differ on negate: invert the image instead")
    if mode == "raw":
        hundredths = np.rint(image.brightness * (255 / image.most))
        darkness, known = hundredths / 100, hundredths <= 100
    else:
        darkness = (image.brightness if negate else image.most - image.brightness) / image.most
        opaque = image.opacity
        known = np.ones(image.shape, dtype=bool) if opaque is None else opaque == image.most
    free_cells = known & (darkness <= free + _ROUNDING)
    return Grid(frame, free_cells, known & ~free_cells & (darkness >= occupied - _ROUNDING)), darkness, free


def image_of(path: str | Path) -> Path:
    """Return the path of the image of ROS's `map.yaml`."""
    source = Source(path)
    return source.path.parent / read_yaml(source).need("image", _WHAT).string("image")


def _threshold(entry: Entry, key: str) -> float:
    value = entry.number(key)
    return value if 0 <= value <= 1 else entry.fail(f"{key}: a number from 0 to 1 was expected, not {value:g}")
