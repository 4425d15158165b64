"""Maps: the rules of map_server, transforms, clearance, wall boxes, and what users get wrong."""

from __future__ import annotations

import struct
import warnings
import zlib
from pathlib import Path
from typing import Any

import imageio.v3 as iio
import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from PIL import Image

from shmoo_mjx.errors import ShmooError
from shmoo_mjx.geometry import se2
from shmoo_mjx.planning import maps
from shmoo_mjx.planning.maps import FREE, OCCUPIED, UNKNOWN, OccupancyGrid

REAL_MAPS = Path(__file__).resolve().parents[3] / "shared" / "maps"


def write_map(folder: Path, pixels: np.ndarray, name: str = "m.png", **fields: Any) -> Path:
    iio.imwrite(folder / name, pixels)
    meta = {"image": name, "resolution": 0.1, "origin": [0.0, 0.0, 0.0]} | fields
    path = folder / "m.yaml"
    path.write_text(yaml.safe_dump({k: v for k, v in meta.items() if v is not None}))
    return path


def cells_of(folder: Path, pixels: list, **fields: Any) -> list:
    return maps.load_map(write_map(folder, np.array(pixels, np.uint8), **fields)).cells.tolist()


@pytest.mark.parametrize("name", ["m.png", "m.pgm"])
def test_trinary_row_zero_is_at_the_bottom(tmp_path: Path, name: str) -> None:
    assert cells_of(tmp_path, [[254, 0], [205, 254]], name=name) == [[UNKNOWN, FREE], [FREE, OCCUPIED]]


@pytest.mark.parametrize(("free_thresh", "cell"), [(0.196, UNKNOWN), (0.25, FREE), (0.1, UNKNOWN)])
def test_pixel_205_depends_on_free_thresh(tmp_path: Path, free_thresh: float, cell: int) -> None:
    assert cells_of(tmp_path, [[205]], free_thresh=free_thresh) == [[cell]]


def test_thresholds_are_inclusive(tmp_path: Path) -> None:
    # 204 gives occ = 0.2 and 51 gives occ = 0.8.
    assert cells_of(tmp_path, [[204, 51]], free_thresh=0.2, occupied_thresh=0.8) == [[FREE, OCCUPIED]]
    assert cells_of(tmp_path, [[204, 51]], free_thresh=0.1999, occupied_thresh=0.8001) == [[UNKNOWN, UNKNOWN]]
    assert cells_of(tmp_path, [[51, 204]], free_thresh=0.2, occupied_thresh=0.8, negate=1) == [[FREE, OCCUPIED]]
    assert cells_of(tmp_path, [[51, 255]], free_thresh=0.8, occupied_thresh=0.8) == [[FREE, FREE]]
    assert cells_of(tmp_path, [[255, 254, 0]], free_thresh=0.0, occupied_thresh=1.0) == [[FREE, UNKNOWN, OCCUPIED]]


@pytest.mark.parametrize("negate", [1, True])
def test_negate_as_number_or_bool(tmp_path: Path, negate: object) -> None:
    assert cells_of(tmp_path, [[254, 0]], negate=negate) == [[OCCUPIED, FREE]]


def test_scale_keeps_shades_between_the_thresholds(tmp_path: Path) -> None:
    cells = cells_of(tmp_path, [[254, 0, 128, 90]], mode="scale", free_thresh=0.2, occupied_thresh=0.8)
    middle, darker = ((1 - p / 255 - 0.2) / 0.6 * 100 for p in (128, 90))
    assert cells == [[FREE, OCCUPIED, round(middle), round(darker)]]


def test_scale_over_the_whole_range_has_free_and_occupied_cells(tmp_path: Path) -> None:
    cells = cells_of(tmp_path, [[255, 254, 1, 0, 127]], mode="scale", free_thresh=0.0, occupied_thresh=1.0)
    assert cells == [[FREE, FREE, OCCUPIED, OCCUPIED, 50]]


def test_raw_keeps_values_up_to_100(tmp_path: Path) -> None:
    assert cells_of(tmp_path, [[0, 37, 100, 101, 255]], mode="raw") == [[0, 37, 100, UNKNOWN, UNKNOWN]]


def test_colours_count_by_luminance(tmp_path: Path) -> None:
    # Grey 76, 226, 29 and 150: occ 0.70, 0.11, 0.89 and 0.41.
    colours = [[255, 0, 0], [255, 255, 0], [0, 0, 255], [0, 255, 0]]
    assert cells_of(tmp_path, [colours]) == [[OCCUPIED, FREE, OCCUPIED, UNKNOWN]]


def test_what_is_not_opaque_is_unknown_but_in_raw(tmp_path: Path) -> None:
    pixels = [[[254, 254, 254, 255], [254, 254, 254, 254], [0, 0, 0, 255], [0, 0, 0, 0]]]
    for mode in ("trinary", "scale"):
        assert cells_of(tmp_path, pixels, mode=mode) == [[FREE, UNKNOWN, OCCUPIED, UNKNOWN]]
    assert cells_of(tmp_path, [[[40, 40, 40, 0]]], mode="raw") == [[40]]
    # Alpha takes no part in the grey: with it 205 would be lighter.
    assert cells_of(tmp_path, [[[205, 205, 205, 255]]]) == [[UNKNOWN]]


GREYS = np.array([[254, 205, 100, 0]], np.uint8)
CELLS = [[FREE, UNKNOWN, UNKNOWN, OCCUPIED]]


def kinds_of_image() -> dict[str, Image.Image]:
    grey = Image.fromarray(GREYS)
    see_through = grey.convert("P")
    see_through.info["transparency"] = 0  # what is black
    wide = Image.fromarray(GREYS.astype(np.uint16) * 257)
    return {
        "grey.pgm": grey, "grey.gif": grey, "grey.bmp": grey, "grey.tif": grey, "palette.png": grey.convert("P"),
        "alpha.png": grey.convert("LA"), "rgb.ppm": grey.convert("RGB"), "rgba.png": grey.convert("RGBA"),
        "cmyk.tif": grey.convert("CMYK"), "wide.png": wide, "wide.tif": wide, "wide.pgm": wide,
        "holes.png": see_through, "holes.gif": see_through,
    }  # fmt: skip


@pytest.mark.parametrize("name", kinds_of_image())
def test_every_kind_of_image_gives_the_same_cells(tmp_path: Path, name: str) -> None:
    path = write_map(tmp_path, GREYS, image=name)
    kinds_of_image()[name].save(tmp_path / name)
    black = UNKNOWN if name.startswith("holes") else OCCUPIED
    assert maps.load_map(path).cells.tolist() == [[*CELLS[0][:3], black]]


def test_a_cmyk_jpeg_is_read_as_the_same_picture_in_grey(tmp_path: Path) -> None:
    picture = Image.fromarray(np.kron(GREYS, np.ones((16, 16), np.uint8)))
    for name, kind in (("grey.jpg", "L"), ("cmyk.jpg", "CMYK")):
        picture.convert(kind).save(tmp_path / name, quality=100, subsampling=0)
        cells = maps.load_map(write_map(tmp_path, GREYS, image=name)).cells
        assert cells[8, 8::16].tolist() == CELLS[0]


@pytest.mark.parametrize(
    ("kind", "words"),
    [("float.tif", "8 bits"), ("integers.tif", "8 bits"), ("film.gif", "several frames"), ("film.png", "frames")],
)
def test_an_image_of_unclear_meaning_is_refused_in_one_sentence(tmp_path: Path, kind: str, words: str) -> None:
    path = write_map(tmp_path, GREYS, image=kind)
    if kind.startswith("film"):
        Image.fromarray(GREYS).save(tmp_path / kind, save_all=True, append_images=[Image.fromarray(255 - GREYS)])
    else:
        Image.fromarray(GREYS.astype(np.float32 if kind == "float.tif" else np.int32)).save(tmp_path / kind)
    with pytest.raises(ShmooError, match=words) as error:
        maps.load_map(path)
    assert kind in str(error.value) and str(path) in str(error.value) and "\n" not in str(error.value)


def test_cells_that_only_the_thresholds_make_free_are_counted(tmp_path: Path) -> None:
    for free_thresh, count in ((0.196, 0), (0.25, 3)):
        path = write_map(tmp_path, np.array([[205, 205, 254], [0, 205, 204]], np.uint8), free_thresh=free_thresh)
        assert maps.count_free_unknown(path) == count


@pytest.mark.parametrize("file", ["m.yaml", "m.yml", "the (old) [map] 2.yml"])
def test_a_map_may_have_any_name(tmp_path: Path, file: str) -> None:
    path = write_map(tmp_path, GREYS, name="a picture [1].png").rename(tmp_path / file)
    assert maps.load_map(path).cells.tolist() == CELLS


def test_image_path_is_relative_to_the_yaml(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "pictures").mkdir()
    path = write_map(tmp_path, np.full((2, 3), 254, np.uint8), name="pictures/m.pgm")
    monkeypatch.chdir(tmp_path.parent)
    assert maps.load_map(path.relative_to(tmp_path.parent)).cells.shape == (2, 3)


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"resolution": None}, ("'resolution'", "missing")),
        ({"resolution": 0.0}, ("'resolution'", "greater than 0")),
        ({"resolution": "fine"}, ("'resolution'", "number")),
        ({"resolution": float("nan")}, ("'resolution'", "finite")),
        ({"resolution": "0.05"}, ("'resolution'", "quotes")),
        ({"origin": [0, 0, 90]}, ("'origin[2]'", "radians")),
        ({"image": None}, ("'image'", "missing")),
        ({"image": "lost.pgm"}, ("'image'", "lost.pgm", "does not exist")),
        ({"origin": [0.0, 0.0]}, ("'origin[2]'", "missing")),
        ({"origin": "here"}, ("'origin'",)),
        ({"negate": 2}, ("'negate'",)),
        ({"mode": "binary"}, ("'mode'", "trinary", "scale", "raw")),
        ({"occupied_thresh": 1.5}, ("'occupied_thresh'",)),
        ({"occupied_thresh": 0.1}, ("'free_thresh'", "'occupied_thresh'")),
    ],
)
def test_faults_are_said_in_one_sentence(tmp_path: Path, fields: dict, words: tuple[str, ...]) -> None:
    path = write_map(tmp_path, np.full((2, 2), 254, np.uint8), **fields)
    with pytest.raises(ShmooError) as error:
        maps.load_map(path)
    text = str(error.value)
    assert str(path) in text and all(word in text for word in words), text
    assert "\n" not in text and text.endswith(".") and "pydantic" not in text


@pytest.mark.parametrize("side", [6000, 14000])
def test_an_image_of_too_many_pixels_is_not_read(tmp_path: Path, side: int) -> None:
    """The larger one is too large for Pillow as well. Its header is enough."""
    path = write_map(tmp_path, np.full((9, 9), 254, np.uint8))
    (tmp_path / "m.png").write_bytes(png_header(side))
    with pytest.raises(ShmooError, match="more pixels than the 25 million that are read"):
        maps.load_map(path)


def png_header(side: int) -> bytes:
    head = b"IHDR" + struct.pack(">IIBBBBB", side, side, 8, 0, 0, 0, 0)
    data = b"IDAT" + zlib.compress(b"")
    chunks = [struct.pack(">I", len(part) - 4) + part + struct.pack(">I", zlib.crc32(part)) for part in (head, data)]
    return b"\x89PNG\r\n\x1a\n" + b"".join(chunks)


def test_damaged_files(tmp_path: Path) -> None:
    path = write_map(tmp_path, np.full((9, 9), 254, np.uint8))
    (tmp_path / "m.png").write_bytes((tmp_path / "m.png").read_bytes()[:30])
    with pytest.raises(ShmooError, match="no readable image"):
        maps.load_map(path)
    path.write_text("image: [unclosed")
    with pytest.raises(ShmooError, match="not valid YAML at line 1"):
        maps.load_map(path)
    path.write_text("just words")
    with pytest.raises(ShmooError, match="mapping"):
        maps.load_map(path)
    with pytest.raises(ShmooError, match="no such map file"):
        maps.load_map(tmp_path / "none.yaml")


@settings(max_examples=30, deadline=None)
@given(
    st.floats(-50, 50), st.floats(-50, 50), st.floats(-4, 4), st.floats(0.01, 1), st.integers(0, 8), st.integers(0, 5)
)
def test_cells_and_world_are_inverse_for_any_origin(
    x: float, y: float, yaw: float, resolution: float, row: int, col: int
) -> None:
    grid = OccupancyGrid(np.zeros((9, 6), np.int8), resolution, (x, y, yaw))
    assert grid.world_to_cell(grid.cell_to_world([row, col])).tolist() == [row, col]


def test_origin_with_yaw_turns_the_map() -> None:
    cells = np.zeros((2, 3), np.int8)
    cells[0, 2] = OCCUPIED
    grid = OccupancyGrid(cells, 1.0, (10.0, 20.0, np.pi / 2))
    assert np.allclose(grid.cell_to_world([0, 2]), [9.5, 22.5])
    assert grid.values_at(np.array([[9.5, 22.5], [9.5, 20.5], [0.0, 0.0]])).tolist() == [OCCUPIED, FREE, UNKNOWN]
    assert np.allclose(maps.occupied_rectangles(grid), [(9.5, 22.5, 0.5, 0.5)])
    assert np.allclose(grid.bounds, (8.0, 20.0, 10.0, 23.0))


@settings(max_examples=20, deadline=None)
@given(hnp.arrays(np.int8, (5, 7), elements=st.sampled_from([FREE, OCCUPIED, UNKNOWN, 40])))
def test_saved_maps_come_back(tmp_path_factory: pytest.TempPathFactory, cells: np.ndarray) -> None:
    path = tmp_path_factory.mktemp("map") / "saved.yaml"
    saved = maps.save_map(OccupancyGrid(cells, 0.05, (-1.0, 2.0, 0.3)), path)
    back = maps.load_map(path)
    assert (back.cells == cells).all()
    assert (back.resolution, back.origin, back.source) == (saved.resolution, saved.origin, str(path))
    assert [p.name for p in path.parent.iterdir() if p.name.startswith(".")] == []


@settings(max_examples=20, deadline=None)
@given(hnp.arrays(np.int8, (6, 8), elements=st.sampled_from([FREE, FREE, FREE, OCCUPIED, UNKNOWN])))
def test_clearance_is_within_a_fifth_of_a_cell_of_the_true_distance(cells: np.ndarray) -> None:
    grid = OccupancyGrid(cells, 0.5)
    blocked = np.argwhere(np.pad(cells, 1, constant_values=OCCUPIED) != FREE) - 1
    found = maps.obstacle_distance(grid)
    for row, col in np.argwhere(cells == FREE):
        gap = np.maximum(np.abs(blocked - [row, col]) - 0.5, 0.0)
        true = np.linalg.norm(gap, axis=1).min() * 0.5
        assert -1e-9 <= found[row, col] - true <= 0.21 * 0.5
    assert (found[cells != FREE] == 0).all()
    assert (maps.inflate(grid, 0.3) == ((cells == FREE) & (found >= 0.3))).all()


def test_clearance_field_interpolates_and_is_zero_outside() -> None:
    cells = np.zeros((40, 40), np.int8)
    cells[:, :2] = OCCUPIED
    field = maps.distance_field(OccupancyGrid(cells, 0.1, (1.0, 0.0, 0.0)))
    # The wall's face is at x = 1.2; mid-height the other sides are farther away.
    assert np.allclose(field.at(np.array([[1.7, 2.0], [2.03, 1.99]])), [0.5, 0.83], atol=0.01)
    assert field.at([0.5, 2.0]) == 0.0 and field.at([1.1, 2.0]) == 0.0


@settings(max_examples=60, deadline=None)
@given(hnp.arrays(bool, hnp.array_shapes(min_dims=2, max_dims=2, max_side=12)))
def test_boxes_cover_occupied_cells_and_nothing_else(mask: np.ndarray) -> None:
    grid = OccupancyGrid(np.where(mask, OCCUPIED, UNKNOWN).astype(np.int8), 0.1, (3.0, -2.0, 0.4))
    covered = np.zeros_like(mask)
    for cx, cy, hx, hy in maps.occupied_rectangles(grid):
        row, col = grid.world_to_cell((cx, cy))
        middle = se2.inverse_transform_point(np.array(grid.origin), np.array([cx, cy]))
        half = np.array([hx, hy])
        low, high = np.rint((middle - half) / 0.1).astype(int), np.rint((middle + half) / 0.1).astype(int)
        assert low[1] <= row < high[1] and low[0] <= col < high[0]
        covered[low[1] : high[1], low[0] : high[0]] = True
    assert (covered == mask).all()


def test_crossing_walls_take_one_box_each_and_a_window_crops() -> None:
    cells = np.zeros((30, 30), np.int8)
    cells[10:12, :] = OCCUPIED
    cells[:, 20:23] = OCCUPIED
    grid = OccupancyGrid(cells, 0.1)
    assert len(maps.occupied_rectangles(grid)) == 2
    assert np.allclose(maps.occupied_rectangles(grid, (0.0, 0.0, 1.0, 3.0)), [(0.5, 1.1, 0.5, 0.1)])
    assert maps.occupied_rectangles(grid, (0.0, 2.0, 1.0, 3.0)) == []


FREE_AREAS = {
    "nav2_depot/depot.yaml": 449,
    "turtlebot3_world/map.yaml": 20,
    "aws_small_house/map.yaml": 158,
    "aws_hospital/hospital.yaml": 1478,
    "willow_2010/willow-2010-02-18-0.10.yaml": 1092,
}


@pytest.mark.parametrize("name", FREE_AREAS)
def test_free_area_of_real_maps(name: str) -> None:
    if not REAL_MAPS.is_dir():
        pytest.skip(f"real maps are not at {REAL_MAPS.name} beside the repository")
    grid = maps.load_map(REAL_MAPS / name)
    assert round(float(grid.free.sum()) * grid.resolution**2) == FREE_AREAS[name]


def test_a_point_that_no_integer_holds_is_off_the_map_without_a_warning() -> None:
    grid = OccupancyGrid(np.zeros((4, 5), np.int8), 0.05)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for far in (1e308, -1e308, 1e30):
            assert not grid.inside(grid.world_to_cell(np.array([far, 0.0])))


@pytest.mark.parametrize(
    ("cells", "resolution", "told"),
    [
        (np.eye(3, dtype=bool), 0.05, "type bool"),
        (np.eye(3, dtype=np.int8), 0.05, "no value above 1"),
        (100 * np.eye(3), 0.05, "type float64"),
        (500 * np.eye(3, dtype=int), 0.05, "from 0 to 500"),
        (-2 * np.eye(3, dtype=int), 0.05, "from -2 to 0"),
        (np.zeros(3, np.int8), 0.05, r"shape \(3,\)"),
        (np.zeros((0, 3), np.int8), 0.05, r"shape \(0, 3\)"),
        *((np.zeros((3, 3), np.int8), resolution, "'resolution'") for resolution in (0.0, -0.05, np.nan, np.inf)),
    ],
)
def test_cells_and_resolutions_that_mean_nothing_are_refused(cells: np.ndarray, resolution: float, told: str) -> None:
    with pytest.raises(ShmooError, match=told) as error:
        OccupancyGrid(cells, resolution)
    assert told == "'resolution'" or "100 is occupied, 0 is free and -1 is unknown" in str(error.value)
