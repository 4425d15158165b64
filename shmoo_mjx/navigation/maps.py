"""Occupancy maps in the ROS map_server format: reading, writing, and what else is derived from the cells.

Rows count from the bottom of the map, so row and column grow with y and x of the map's own axes. The origin is the pose
in {W} of the lower-left corner of the lower-left cell; with a yaw the map's axes are turned in {W}.
"""

from __future__ import annotations

import io
import warnings
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
import yaml
from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, model_validator
from scipy.ndimage import binary_dilation, distance_transform_edt

from shmoo_mjx import se2
from shmoo_mjx.arrays import Array, Bool, Float, Int, Numbers, Scalar, Shaped
from shmoo_mjx.errors import ShmooError
from shmoo_mjx.files import write_whole
from shmoo_mjx.navigation.clearance import ClearanceField
from shmoo_mjx.navigation.walls import cover_rectangles
from shmoo_mjx.navigation.yaml_input import read_mapping, validated

FREE = 0
OCCUPIED = 100
UNKNOWN = -1

_MOST_CELLS = 25_000_000
"""Largest map that is read: 250 m by 250 m at 0.05 m."""


@dataclass(frozen=True, eq=False)
class OccupancyGrid:
    """A map of square cells. Only cells that are exactly FREE may be driven on."""

    cells: Int[np.ndarray, "H W"]
    """int8, row 0 at the bottom: FREE 0, OCCUPIED 100, UNKNOWN -1, shades 1..99 in between."""
    resolution: float
    """Side of a cell [m]."""
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Pose (x, y, yaw) in {W} of the map's lower-left corner [m, m, rad]."""
    source: str | None = None
    """The YAML file it was read from, if any."""

    @property
    def free(self) -> Bool[np.ndarray, "H W"]:
        """Known to be free."""
        return self.cells == FREE

    @property
    def occupied(self) -> Bool[np.ndarray, "H W"]:
        """Certainly occupied."""
        return self.cells >= OCCUPIED

    def world_to_cell(self, points: Numbers | Float[Array, "*p 2"]) -> Int[np.ndarray, "*p 2"]:
        """(row, column) of the cells that hold ``points`` in {W}; may lie off the map."""
        local = se2.inverse_transform_point(np.asarray(self.origin), np.asarray(points, dtype=float))
        # No int holds 1e308: what becomes of it is off the map, and no warning stands beside the sentence that says so.
        with np.errstate(invalid="ignore", over="ignore"):
            return np.floor(local[..., ::-1] / self.resolution).astype(int)

    def cell_to_world(self, cells: Numbers | Shaped[Array, "*c 2"]) -> Float[np.ndarray, "*c 2"]:
        """Centres in {W} of the cells (row, column); fractions are allowed."""
        local = (np.asarray(cells, dtype=float)[..., ::-1] + 0.5) * self.resolution
        return se2.transform_point(np.asarray(self.origin), local)

    def inside(self, cells: Numbers | Shaped[Array, "*c 2"]) -> Scalar | Bool[np.ndarray, "*c"]:
        """Are the cells (row, column) on the map."""
        cells = np.asarray(cells)
        return ((cells >= 0) & (cells < np.array(self.cells.shape))).all(axis=-1)

    def values_at(self, points: Numbers | Float[Array, "*p 2"]) -> Int[np.ndarray, "*p"]:
        """The cells under ``points`` in {W}; UNKNOWN off the map."""
        cells = self.world_to_cell(points)
        inside = self.inside(cells)
        rows, cols = np.moveaxis(np.where(inside[..., None], cells, 0), -1, 0)
        return np.where(inside, self.cells[rows, cols], UNKNOWN).astype(np.int8)

    @property
    def centres(self) -> Float[np.ndarray, "H W 2"]:
        """Centres of all cells in {W} [m]."""
        rows, cols = np.indices(self.cells.shape)
        return self.cell_to_world(np.stack([rows, cols], axis=-1))

    @property
    def bounds(self) -> tuple[float, float, float, float]:
        """Axis-aligned box (x_min, y_min, x_max, y_max) of the map in {W} [m]."""
        height, width = self.cells.shape
        local = np.array([[0, 0], [width, 0], [0, height], [width, height]]) * self.resolution
        corners = se2.transform_point(np.asarray(self.origin), local)
        return (*corners.min(axis=0).tolist(), *corners.max(axis=0).tolist())


class _MapYaml(BaseModel):
    """The fields of a map_server YAML. Unknown keys are ignored, as map_server does."""

    model_config = ConfigDict(extra="ignore")
    image: str = Field(min_length=1)
    resolution: FiniteFloat = Field(gt=0)
    origin: tuple[FiniteFloat, FiniteFloat, FiniteFloat]
    negate: bool = False
    occupied_thresh: FiniteFloat = Field(default=0.65, ge=0, le=1)
    free_thresh: FiniteFloat = Field(default=0.196, ge=0, le=1)
    mode: Literal["trinary", "scale", "raw"] = "trinary"

    @model_validator(mode="after")
    def _thresholds_in_order(self) -> _MapYaml:
        if self.free_thresh > self.occupied_thresh:
            raise ValueError("'free_thresh' must not be larger than 'occupied_thresh'; exchange or correct them.")
        return self


def load_map(yaml_path: str | Path) -> OccupancyGrid:
    """Reads a map_server YAML and its image (PGM, PNG or what else Pillow reads).

    The rules are those of nav2's map_server. With shade = mean of the colour channels / 255 and occ = 1 - shade (shade
    if ``negate``), trinary gives occ > occupied_thresh occupied, occ < free_thresh free, else unknown, and averages an
    alpha channel in with the colours; scale keeps the shades between the thresholds as 1..99 and takes any transparency
    as unknown; raw keeps pixel values 0..100 and takes all others as unknown. The image path is relative to the YAML.

    Raises:
        ShmooError: names the file, the field and the remedy.
    """
    path = Path(yaml_path)
    meta = validated(_MapYaml, read_mapping(path, "map"), path)
    image_path = path.parent / meta.image
    if not image_path.is_file():
        raise ShmooError(f"{path}: 'image' names {meta.image}, which does not exist beside it; correct the path.")
    cells = _interpret(_pixels(image_path, path), meta)
    return OccupancyGrid(np.ascontiguousarray(cells[::-1]), float(meta.resolution), meta.origin, str(path))


def _pixels(image_path: Path, yaml_path: Path) -> Float[np.ndarray, "H W C"]:
    """The image as RGBA in 0..1, or RGB where it has no alpha channel."""
    import imageio.v3 as iio

    try:
        content = image_path.read_bytes()  # not the path: of a damaged image the library leaves the file open
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # Pillow's, of large images
            height, width = iio.improps(content).shape[:2]
        small = height * width <= _MOST_CELLS
        image = np.atleast_2d(iio.imread(content)) if small else np.zeros((0, 0))
    except Exception as error:  # Pillow raises many kinds for damaged files, none of which says more to the user
        if type(error).__name__ != "DecompressionBombError":
            raise ShmooError(
                f"{yaml_path}: 'image' names {image_path.name}, which is no readable image; "
                "give a whole PGM or PNG file."
            ) from None
        image = np.zeros((0, 0))
    if not image.size:
        raise ShmooError(
            f"{yaml_path}: 'image' names {image_path.name}, which has more pixels than the {_MOST_CELLS // 10**6} "
            "million that are read; crop it or make it coarser."
        )
    if image.ndim > 3:
        raise ShmooError(f"{yaml_path}: 'image' names {image_path.name}, which holds several frames; give a still one.")
    scale = 1.0 if image.dtype == bool else float(np.iinfo(image.dtype).max)
    if image.dtype.itemsize > 2:  # Pillow widens 16-bit grey images to 32 bits without rescaling
        scale = 65535.0
    channels = image.reshape(*image.shape[:2], -1) / scale
    if channels.shape[2] <= 2:
        channels = np.concatenate([channels[..., :1].repeat(3, axis=2), channels[..., 1:]], axis=2)
    return channels


def _interpret(pixels: Float[np.ndarray, "H W C"], meta: _MapYaml) -> Int[np.ndarray, "H W"]:
    has_alpha = pixels.shape[2] == 4
    used = pixels if meta.mode == "trinary" else pixels[..., :3]
    shade = used.mean(axis=2)
    occ = shade if meta.negate else 1.0 - shade
    cells = np.full(occ.shape, UNKNOWN, dtype=np.int8)
    if meta.mode == "raw":
        value = np.rint(shade * 255)
        return np.where(value <= OCCUPIED, value, UNKNOWN).astype(np.int8)
    if meta.mode == "scale":
        span = max(meta.occupied_thresh - meta.free_thresh, 1e-9)
        cells = np.clip(np.rint((occ - meta.free_thresh) / span * 100), 1, 99).astype(np.int8)
    cells[occ > meta.occupied_thresh] = OCCUPIED
    cells[occ < meta.free_thresh] = FREE
    if meta.mode == "scale" and has_alpha:
        cells[pixels[..., 3] < 1.0] = UNKNOWN
    return cells


def save_map(grid: OccupancyGrid, yaml_path: str | Path) -> OccupancyGrid:
    """Writes the YAML and a PNG of the same name beside it, to be read back cell by cell as they are.

    Trinary where there are only free, occupied and unknown cells, raw otherwise. Returns the grid with its new source.
    """
    import imageio.v3 as iio

    path = Path(yaml_path)
    image_path = path.with_suffix(".png")
    trinary = np.isin(grid.cells, (FREE, OCCUPIED, UNKNOWN)).all()
    cells = grid.cells.astype(np.int16)
    shades = np.where(cells < 0, 205, np.where(cells == FREE, 254, 0) if trinary else cells)
    buffer = io.BytesIO()
    iio.imwrite(buffer, shades[::-1].astype(np.uint8), extension=".png")
    meta = {
        "image": image_path.name,
        "mode": "trinary" if trinary else "raw",
        "resolution": float(grid.resolution),
        "origin": [float(v) for v in grid.origin],
        "negate": 0,
        "occupied_thresh": 0.65,
        "free_thresh": 0.196,
    }
    write_whole(image_path, buffer.getvalue())
    write_whole(path, yaml.safe_dump(meta, sort_keys=False).encode())
    return replace(grid, source=str(path))


def clearance(grid: OccupancyGrid) -> Float[np.ndarray, "H W"]:
    """Distance [m] from each cell's centre to the nearest cell that is not free; zero in such cells.

    Measured to the near face of that cell (too large by at most 0.21 cell sides on a diagonal). Off the map counts as
    not free.
    """
    padded = np.pad(grid.free, 1, constant_values=False)
    distance = distance_transform_edt(padded)[1:-1, 1:-1]
    return np.maximum(distance - 0.5, 0.0) * grid.resolution


def clearance_field(grid: OccupancyGrid) -> ClearanceField:
    """``clearance`` with the frame that is needed to look it up at points of {W}; its values can't be written to."""
    values = clearance(grid)
    values.flags.writeable = False
    return ClearanceField(values, np.array(grid.origin), grid.resolution)


def inflate(grid: OccupancyGrid, radius: float) -> Bool[np.ndarray, "H W"]:
    """Cells where a disc of ``radius`` [m] about the cell's centre touches only free cells."""
    return grid.free & (clearance(grid) >= radius)


def occupied_rectangles(
    grid: OccupancyGrid, window: tuple[float, float, float, float] | None = None, unknown_borders: bool = False
) -> list[tuple[float, float, float, float]]:
    """Few boxes that cover the occupied cells exactly: wall geoms.

    Args:
        grid: the map.
        window: (x_min, y_min, x_max, y_max) in {W} [m]; only cells whose centre lies in it.
        unknown_borders: also cover unknown cells that touch free ones. In a scanned map the floor ends there at a
            surface that the scan was too faint to call occupied; without it a simulated robot could drive through.

    Returns:
        ``[(centre x, centre y, half size x, half size y)]`` [m]: centres in {W}, half sizes along the map's axes, which
        in {W} are turned by ``grid.origin[2]``.
    """
    mask = grid.occupied
    if unknown_borders:
        mask = mask | (~grid.free & binary_dilation(grid.free, np.ones((3, 3))))
    if window is not None:
        centres = grid.centres
        low, high = np.array(window[:2]), np.array(window[2:])
        mask = mask & ((centres >= low) & (centres <= high)).all(axis=-1)
    boxes = cover_rectangles(mask)
    middle = grid.cell_to_world((boxes[:, ::2] + boxes[:, 1::2] - 1) / 2)
    half = (boxes[:, 1::2] - boxes[:, ::2])[:, ::-1] * grid.resolution / 2
    return [tuple(row) for row in np.concatenate([middle, half], axis=1).tolist()]
