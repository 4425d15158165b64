"""Occupancy maps in the ROS map_server format: reading, writing, and derived quantities.

Rows count from the bottom of the map, so row and column grow with y and x of the map's own axes. The origin is the pose
in {W} of the lower-left corner of the lower-left cell. With a yaw the map's axes are rotated in {W}.
"""

from __future__ import annotations

import io
import warnings
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_validator
from scipy.ndimage import binary_dilation, distance_transform_edt

from shmoo_mjx.arrays import Array, Bool, Float, Int, Numbers, Shaped
from shmoo_mjx.base.files import write_whole
from shmoo_mjx.base.schema import Angle, Number, validated
from shmoo_mjx.base.yaml_input import read_mapping, yaml_text
from shmoo_mjx.errors import ShmooError
from shmoo_mjx.geometry import se2
from shmoo_mjx.planning.distance_field import DistanceField
from shmoo_mjx.planning.walls import cover_rectangles

FREE = 0
OCCUPIED = 100
UNKNOWN = -1

_MOST_CELLS = 25_000_000
"""Maximum number of cells of a map file: 250 m by 250 m at 0.05 m."""
_MAP_SAVER_UNKNOWN = 205
"""Grey value that map_saver writes for an unknown cell."""


@dataclass(frozen=True, eq=False)
class OccupancyGrid:
    """A map of square cells. Only cells that are exactly FREE may be driven on.

    Raises:
        ShmooError: the cells or the resolution are invalid.
    """

    cells: Int[np.ndarray, "H W"]
    """int8, row 0 at the bottom: FREE 0, OCCUPIED 100, UNKNOWN -1, intermediate values 1..99."""
    resolution: float
    """Side of a cell [m]."""
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Pose (x, y, yaw) in {W} of the map's lower-left corner [m, m, rad]."""
    source: str | None = None
    """The YAML file of the map, if any."""

    def __post_init__(self) -> None:
        cells, name, fault = np.asarray(self.cells), self.source or "OccupancyGrid", ""
        if cells.ndim != 2 or not cells.size or not np.issubdtype(cells.dtype, np.integer):
            fault = f"is an array of shape {cells.shape} and type {cells.dtype}"
        elif cells.min() < UNKNOWN or cells.max() > OCCUPIED:
            fault = f"has values from {cells.min()} to {cells.max()}"
        elif cells.max() == 1:  # almost certainly a mask of the walls, and 1 is no wall here
            fault = "has no value above 1"
        if fault:
            raise ShmooError(
                f"{name}: 'cells' {fault}; give a 2-D array of whole numbers in which {OCCUPIED} is occupied, {FREE} "
                f"is free and {UNKNOWN} is unknown."
            )
        if not 0 < self.resolution < np.inf:
            raise ShmooError(f"{name}: 'resolution' is {self.resolution}; give the side of a cell [m], above 0.")
        object.__setattr__(self, "cells", cells.astype(np.int8, copy=False))

    @property
    def free(self) -> Bool[np.ndarray, "H W"]:
        """Mask of the cells known to be free."""
        return self.cells == FREE

    @property
    def occupied(self) -> Bool[np.ndarray, "H W"]:
        """Mask of the cells known to be occupied."""
        return self.cells >= OCCUPIED

    def world_to_cell(self, points: Numbers | Float[Array, "*p 2"]) -> Int[np.ndarray, "*p 2"]:
        """(row, column) of the cells that contain ``points`` in {W}. They may lie off the map."""
        local = se2.inverse_transform_point(np.asarray(self.origin), np.asarray(points, dtype=float))
        # Coordinates such as 1e308 overflow int. The result is off the map, so NumPy's warning would only distract from
        # the error message that follows.
        with np.errstate(invalid="ignore", over="ignore"):
            return np.floor(local[..., ::-1] / self.resolution).astype(int)

    def cell_to_world(self, cells: Numbers | Shaped[Array, "*c 2"]) -> Float[np.ndarray, "*c 2"]:
        """Points in {W} of the cell centres (row, column). Fractions are allowed."""
        local = (np.asarray(cells, dtype=float)[..., ::-1] + 0.5) * self.resolution
        return se2.transform_point(np.asarray(self.origin), local)

    def inside(self, cells: Numbers | Shaped[Array, "*c 2"]) -> np.bool | Bool[np.ndarray, "*c"]:
        """Whether the cells (row, column) are on the map."""
        cells = np.asarray(cells)
        return ((cells >= 0) & (cells < np.array(self.cells.shape))).all(axis=-1)

    def values_at(self, points: Numbers | Float[Array, "*p 2"]) -> Int[np.ndarray, "*p"]:
        """Cell values at ``points`` in {W}; UNKNOWN off the map."""
        cells = self.world_to_cell(points)
        inside = np.asarray(self.inside(cells))
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
    resolution: Number = Field(gt=0)
    origin: tuple[Number, Number, Angle]
    negate: bool = False
    occupied_thresh: Number = Field(default=0.65, ge=0, le=1)
    free_thresh: Number = Field(default=0.196, ge=0, le=1)
    mode: Literal["trinary", "scale", "raw"] = "trinary"

    @model_validator(mode="after")
    def _thresholds_in_order(self) -> _MapYaml:
        if self.free_thresh > self.occupied_thresh:
            raise ValueError("'free_thresh' must not be larger than 'occupied_thresh'; exchange or correct them.")
        return self


def load_map(yaml_path: str | Path) -> OccupancyGrid:
    """Reads a map_server YAML and its image (PGM, PNG or another format that Pillow reads).

    The rules are those of navigation2's map server since version 1.4.0. The image is converted to 8-bit grey, colours
    by their luminance. shade = grey / 255, and occ = 1 - shade (shade if ``negate``). In the modes trinary and scale a
    cell is free if occ <= free_thresh and occupied if occ >= occupied_thresh. Between the thresholds, trinary gives
    unknown and scale gives 0..100 in proportion. In both modes a pixel that is not opaque is unknown. The mode raw
    keeps grey 0..100 and maps other values to unknown. The image path is relative to the YAML. The thresholds default
    to 0.65 and 0.196.

    Raises:
        ShmooError: the file is missing or invalid. The message names the file, the field and the remedy.
    """
    path = Path(yaml_path)
    meta, grey, opaque = _read(path)
    cells = _interpret(grey, opaque, meta)
    return OccupancyGrid(np.ascontiguousarray(cells[::-1]), float(meta.resolution), meta.origin, str(path))


def count_free_unknown(yaml_path: str | Path) -> int:
    """Number of cells with grey 205, map_saver's value for unknown, that the thresholds make free.

    Raises:
        ShmooError: as :func:`load_map`.
    """
    meta, grey, opaque = _read(Path(yaml_path))
    unknown = grey == _MAP_SAVER_UNKNOWN
    return int((unknown & (_interpret(grey, opaque, meta) == FREE)).sum()) if meta.mode != "raw" else 0


def _read(path: Path) -> tuple[_MapYaml, Shaped[np.ndarray, "H W"], Bool[np.ndarray, "H W"]]:
    """The YAML, the image's grey values 0..255, and the mask of opaque pixels; row 0 at the top."""
    meta = validated(_MapYaml, read_mapping(path, "map"), path)
    image_path = path.parent / meta.image
    if not image_path.is_file():
        raise ShmooError(f"{path}: 'image' names {meta.image}, which does not exist beside it; correct the path.")
    return meta, *_pixels(image_path, path)


def _pixels(image_path: Path, yaml_path: Path) -> tuple[Shaped[np.ndarray, "H W"], Bool[np.ndarray, "H W"]]:
    from PIL import Image

    what = f"{yaml_path}: 'image' names {image_path.name}, which"
    large = f"{what} has more pixels than the {_MOST_CELLS // 10**6} million that are read; crop it or make it coarser."
    try:
        # Pillow leaves a damaged file open, so it gets the content instead of the path.
        with warnings.catch_warnings(), Image.open(io.BytesIO(image_path.read_bytes())) as image:
            warnings.simplefilter("ignore")  # Pillow warns about large images
            if image.width * image.height > _MOST_CELLS:
                raise ShmooError(large)
            if getattr(image, "n_frames", 1) > 1:
                raise ShmooError(f"{what} holds several frames; give a still one.")
            # Pillow stretches a 16-bit PGM to the whole range. For other images in these modes the range is unknown.
            if image.mode == "F" or (image.mode == "I" and image.format != "PPM"):
                raise ShmooError(
                    f"{what} has greys whose black and white are not known; save it with 8 bits per pixel."
                )
            if image.mode.startswith("I"):
                grey = np.rint(np.asarray(image) / 257.0).astype(np.uint8)
                return grey, np.ones(grey.shape, dtype=bool)
            alpha = np.asarray(image.convert("RGBA"))[..., 3] if image.has_transparency_data else None
            # Pillow cannot convert CMYK to grey directly.
            grey = np.asarray(image.convert("RGB").convert("L") if image.mode == "CMYK" else image.convert("L"))
            return grey, np.ones(grey.shape, dtype=bool) if alpha is None else alpha == 255
    except Image.DecompressionBombError:
        raise ShmooError(large) from None
    except ShmooError:
        raise
    except Exception:  # Pillow raises many exception types for damaged files, and none tells the user more
        raise ShmooError(f"{what} is no readable image; give a whole PGM or PNG file.") from None


def _interpret(
    grey: Shaped[np.ndarray, "H W"], opaque: Bool[np.ndarray, "H W"], meta: _MapYaml
) -> Int[np.ndarray, "H W"]:
    if meta.mode == "raw":
        return np.where(grey <= OCCUPIED, grey.astype(np.int16), UNKNOWN).astype(np.int8)
    # navigation2 uses single precision. Using the same puts greys that just meet a threshold on the same side.
    shade = grey.astype(np.float32) / np.float32(255)
    occ = shade if meta.negate else np.float32(1) - shade
    free, occupied = np.float32(meta.free_thresh), np.float32(meta.occupied_thresh)
    between = np.full(occ.shape, UNKNOWN, dtype=np.int8)
    if meta.mode == "scale" and free < occupied:
        part = np.clip((occ - free) / (occupied - free), 0, 1)
        between = np.floor(part * 100 + np.float32(0.5)).astype(np.int8)
    cells = np.select([occ <= free, occ >= occupied], [FREE, OCCUPIED], between)
    return np.where(opaque, cells, UNKNOWN).astype(np.int8)


def save_map(grid: OccupancyGrid, yaml_path: str | Path) -> OccupancyGrid:
    """Writes the YAML and a PNG of the same name beside it. Reading them back gives the same cells.

    The mode is trinary if there are only free, occupied and unknown cells, and raw otherwise.

    Returns:
        The grid with its new ``source``.
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
    write_whole(path, yaml_text(meta))
    return replace(grid, source=str(path))


def obstacle_distance(grid: OccupancyGrid) -> Float[np.ndarray, "H W"]:
    """Distance [m] from each cell's centre to the nearest cell that is not free; zero in such cells.

    The distance is measured to the near face of that cell (too large by at most 0.21 cell sides on a diagonal). Cells
    off the map count as not free.
    """
    padded = np.pad(grid.free, 1, constant_values=False)
    distance = distance_transform_edt(padded)[1:-1, 1:-1]
    return np.maximum(distance - 0.5, 0.0) * grid.resolution


def distance_field(grid: OccupancyGrid) -> DistanceField:
    """`obstacle_distance` as a `DistanceField` in {W}. Its values are read-only."""
    values = obstacle_distance(grid)
    values.flags.writeable = False
    return DistanceField(values, np.array(grid.origin), grid.resolution)


def inflate(grid: OccupancyGrid, radius: float) -> Bool[np.ndarray, "H W"]:
    """Mask of the cells where a disc of ``radius`` [m] around the cell's centre touches only free cells."""
    return grid.free & (obstacle_distance(grid) >= radius)


def occupied_rectangles(
    grid: OccupancyGrid, window: tuple[float, float, float, float] | None = None, unknown_borders: bool = False
) -> list[tuple[float, float, float, float]]:
    """A small set of boxes that exactly covers the occupied cells, for use as wall geoms.

    Args:
        grid: the map.
        window: (x_min, y_min, x_max, y_max) in {W} [m]; only cells whose centre lies in it.
        unknown_borders: also cover unknown cells that touch free ones. In a scanned map the floor ends there at a
            surface that was too faint to count as occupied. Otherwise a simulated robot could drive through it.

    Returns:
        ``[(centre x, centre y, half size x, half size y)]`` [m]. Centres are in {W}. Half sizes are along the map's
        axes, which are rotated by ``grid.origin[2]`` in {W}.
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
