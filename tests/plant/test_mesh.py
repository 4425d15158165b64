"""Own objects: a mesh becomes something the robot can push, or the user hears in one sentence why not."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from shmoo_mjx.errors import ShmooError
from shmoo_mjx.geometry.hands import HAND_HEIGHT, REACH
from shmoo_mjx.plant.engine_mujoco import MujocoEngine
from shmoo_mjx.plant.mesh import add_object
from shmoo_mjx.plant.object_file import read_object
from shmoo_mjx.plant.objects import draw_condition
from shmoo_mjx.plant.scene import build_scene
from shmoo_mjx.plant.trials import command, object_alone, pushed, settled

trimesh = pytest.importorskip("trimesh")


def _box(path: Path, size: tuple[float, float, float] = (0.5, 0.4, 0.7)) -> Path:
    trimesh.creation.box(size).export(path)
    return path


def _office_chair(path: Path) -> Path:
    """A seat with a back on a column, on a star of five feet."""
    parts = [
        trimesh.creation.box((0.48, 0.48, 0.08), trimesh.transformations.translation_matrix((0, 0, 0.48))),
        trimesh.creation.box((0.06, 0.44, 0.50), trimesh.transformations.translation_matrix((-0.22, 0, 0.76))),
        trimesh.creation.cylinder(0.04, 0.40, transform=trimesh.transformations.translation_matrix((0, 0, 0.26))),
    ]
    for k in range(5):
        turn = trimesh.transformations.rotation_matrix(2 * np.pi * k / 5, (0, 0, 1))
        leg = trimesh.creation.box((0.32, 0.05, 0.05), trimesh.transformations.translation_matrix((0.16, 0, 0.085)))
        wheel = trimesh.creation.cylinder(
            0.03, 0.04, sections=16,
            transform=trimesh.transformations.translation_matrix((0.30, 0, 0.03))
            @ trimesh.transformations.rotation_matrix(np.pi / 2, (1, 0, 0)),
        )  # fmt: skip
        parts += [part.apply_transform(turn) for part in (leg, wheel)]
    trimesh.util.concatenate(parts).export(path)
    return path


def test_a_box_mesh_slides_like_a_box(tmp_path: Path) -> None:
    made = add_object(_box(tmp_path / "crate.stl"), mass=8.0, friction=0.4, out=tmp_path / "crate.json")
    data = read_object(made)
    np.testing.assert_allclose(data["size"], (0.5, 0.4, 0.7), atol=1e-5)
    np.testing.assert_allclose(data["com"], (0, 0, 0.35), atol=1e-5)
    np.testing.assert_allclose(
        data["inertia_per_mass"][:3], [(0.16 + 0.49) / 12, (0.25 + 0.49) / 12, 0.41 / 12], rtol=1e-4
    )
    assert len(data["feet"]) == 4
    condition = draw_condition(str(made), 0)
    assert condition.half_extents == pytest.approx((0.25, 0.2))
    model = object_alone(condition)
    assert model.body("object0/object").subtreemass[0] == pytest.approx(8.0)
    data = settled(model)
    expected = 0.4 * 8.0 * 9.81
    ramp = np.zeros((1500, 3))
    ramp[:, 0] = np.linspace(0, 1.4 * expected, 1500)
    track = pushed(model, data, ramp, 3.0, height=0.0)
    assert ramp[np.argmax(track.twist[:, 0] > 0.01), 0] == pytest.approx(expected, rel=0.1)


def test_an_office_chair_on_casters_is_pushed_by_the_robot(tmp_path: Path) -> None:
    made = add_object(
        _office_chair(tmp_path / "chair.glb"), 9.0, 0.6, wheels="casters", wheel_radius=0.03, up="z", hull=True,
        out=tmp_path / "chair.json",
    )  # fmt: skip
    condition = draw_condition(str(made), 3)
    assert len(condition.rolling) == len(read_object(made)["feet"]) == 5
    scene = build_scene([(condition, (REACH + 0.06 + condition.half_extents[0], 0.0, 0.0))])
    assert scene.model.body("object0/object").subtreemass[0] == pytest.approx(9.0, rel=1e-6)
    engine = MujocoEngine([scene])
    world = engine.init()
    start = engine.observe(world).object_pose[0, 0, 0]
    strongest = 0.0
    for _ in range(25):
        world, seen = engine.step(world, command(1, (0.04, 0.0), reach=REACH, hand_height=HAND_HEIGHT + 0.1))
        strongest = max(strongest, float(seen.wrench[0, 0, 0]))
    assert not engine.fallen(world)[0]
    engine.close()
    assert seen.object_pose[0, 0, 0] > start + 0.1 and strongest > 1.0


def test_rear_wheels_resist_sideways(tmp_path: Path) -> None:
    made = add_object(
        _box(tmp_path / "trolley.ply"), 12.0, 0.7, wheels="rear", wheel_radius=0.08, out=tmp_path / "trolley.json"
    )
    condition = draw_condition(str(made), 0, {"caster_angle": (0.0, 0.0)})
    moved = []
    for axis in (0, 1):
        model = object_alone(condition)
        wrench = np.zeros(3)
        wrench[axis] = 12.0
        track = pushed(model, settled(model), wrench, 0.6)
        moved.append(abs(track.pose[-1, axis]))
    assert moved[0] > 3 * moved[1]


def test_an_own_object_takes_properties_and_keeps_its_fingerprint(tmp_path: Path) -> None:
    made = add_object(_box(tmp_path / "crate.stl"), 8.0, 0.4, out=tmp_path / "crate.json")
    condition = draw_condition(str(made), 0, {"friction": 0.6, "payload": 5.0})
    assert condition.friction == 0.6 and "crate" in condition.describe()
    assert object_alone(condition).body_mass.sum() == pytest.approx(13.0)
    moved = tmp_path / "elsewhere"
    moved.mkdir()
    copy = moved / "crate.json"
    copy.write_bytes(made.read_bytes())
    assert draw_condition(str(copy), 0).fingerprint() == draw_condition(str(made), 0).fingerprint()
    with pytest.raises(ShmooError, match="size"):
        draw_condition(str(made), 0, {"size": (1.0, 1.0, 1.0)})


def test_millimetres_and_y_up_are_understood(tmp_path: Path) -> None:
    made = add_object(
        _box(tmp_path / "crate.obj", (500.0, 700.0, 400.0)), 8.0, 0.4, scale=0.001, up="y", out=tmp_path / "c.json"
    )
    np.testing.assert_allclose(read_object(made)["size"], (0.5, 0.4, 0.7), atol=1e-5)


def test_a_mesh_turned_inside_out_is_the_same_object(tmp_path: Path) -> None:
    mesh = trimesh.creation.box((0.5, 0.4, 0.7))
    mesh.invert()
    mesh.export(tmp_path / "inverted.stl")
    made = [
        read_object(add_object(path, 8.0, 0.4, out=path.with_suffix(".json")))
        for path in (tmp_path / "inverted.stl", _box(tmp_path / "crate.stl"))
    ]
    np.testing.assert_allclose(made[0]["inertia_per_mass"], made[1]["inertia_per_mass"], atol=1e-5)
    np.testing.assert_allclose(made[0]["com"], made[1]["com"], atol=1e-5)


def _placed(mesh: Any, x: float, y: float, z: float) -> Any:
    return mesh.apply_translation((x, y, z))


def _wooden_table() -> Any:
    """A top on four legs that reach into it, with a hollow ball on it."""
    legs = [_placed(trimesh.creation.box((0.05, 0.05, 0.6)), x, y, 0.3) for x in (-0.3, 0.3) for y in (-0.2, 0.2)]
    ball, hole = (trimesh.creation.icosphere(subdivisions=1, radius=r) for r in (0.08, 0.06))
    hole.invert()
    shell = [_placed(sphere, 0.1, 0.05, 0.7) for sphere in (ball, hole)]
    return trimesh.util.concatenate([_placed(trimesh.creation.box((0.7, 0.5, 0.04)), 0, 0, 0.59), *legs, *shell])


def _inertial_of(mesh: Any, file: Path, **options: Any) -> np.ndarray:
    """Centre of mass, inertia and size of what is made of the mesh when it is written as ``file``."""
    mesh.export(file)
    data = read_object(add_object(file, 8.0, 0.4, out=file.with_suffix(".json"), **options))
    return np.concatenate([data["com"], data["inertia_per_mass"], data["size"]])


@pytest.fixture(scope="module")
def true_table(tmp_path_factory: pytest.TempPathFactory) -> np.ndarray:
    return _inertial_of(_wooden_table(), tmp_path_factory.mktemp("table") / "table.stl")


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_winding_changes_no_mass_property_or_is_refused(
    data: st.DataObject, true_table: np.ndarray, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """Some faces, or all, of some bodies are wound the other way."""
    mesh = _wooden_table()
    bodies = trimesh.graph.connected_components(mesh.face_adjacency)
    assert len(bodies) == 7
    rng = np.random.default_rng(data.draw(st.integers(0, 2**32 - 1), "seed"))
    faces = mesh.faces.copy()
    chosen = data.draw(st.sets(st.sampled_from(range(7)), min_size=1), "bodies")
    for body in chosen:
        share = data.draw(st.sampled_from([0.1, 0.5, 1.0]), "share")
        turned = bodies[body][rng.random(len(bodies[body])) <= share]
        faces[turned] = faces[turned][:, ::-1]
    turned_mesh = trimesh.Trimesh(mesh.vertices, faces, process=False)
    try:
        found = _inertial_of(turned_mesh, tmp_path_factory.mktemp("turned") / "table.stl")
    except ShmooError as error:
        assert "cavity" in str(error) and any(len(bodies[body]) == 80 for body in chosen)  # of the hollow ball
    else:
        np.testing.assert_allclose(found, true_table, atol=2e-5)


@pytest.mark.parametrize("turned", [[0], [0, 5, 7], list(range(12))])
def test_a_cube_with_faces_turned_is_the_cube(turned: list[int], tmp_path: Path) -> None:
    cube = trimesh.creation.box((0.5, 0.5, 0.6))
    faces = cube.faces.copy()
    faces[turned] = faces[turned][:, ::-1]
    found = _inertial_of(trimesh.Trimesh(cube.vertices, faces, process=False), tmp_path / "cube.stl")
    np.testing.assert_allclose(found[:3], (0, 0, 0.3), atol=1e-5)
    np.testing.assert_allclose(found[3:6], [0.61 / 12, 0.61 / 12, 0.5 / 12], rtol=1e-4)
    build_scene([(draw_condition(str(tmp_path / "cube.json"), 0), (1.0, 0.0, 0.0))])


@pytest.mark.parametrize(("inverted", "clear"), [("inner", True), ("outer", True), ("", False), ("both", False)])
def test_a_cavity_is_empty_and_a_doubtful_one_is_refused(inverted: str, clear: bool, tmp_path: Path) -> None:
    """Clear is what is wound as it should be, or all the other way round."""
    outer, inner = (trimesh.creation.box(size) for size in ((0.6, 0.5, 0.8), (0.4, 0.3, 0.2)))
    middle = np.array([0.05, 0.0, -0.2])
    inner.apply_translation(middle)
    centre = -middle * inner.volume / (outer.volume - inner.volume) + (0, 0, 0.4)
    for name, mesh in (("inner", inner), ("outer", outer)):
        if inverted in (name, "both"):
            mesh.invert()
    hollow = trimesh.util.concatenate([outer, inner])
    if clear:
        np.testing.assert_allclose(_inertial_of(hollow, tmp_path / "hollow.stl")[:3], centre, atol=1e-5)
    else:
        with pytest.raises(ShmooError, match=r"hollow\.stl .*cavity"):
            _inertial_of(hollow, tmp_path / "hollow.stl")


def _textured_cube(path: Path, normals: bool, material_per_side: bool) -> Path:
    """An OBJ cube of 0.5 m with vertices of its own for each side, as texture or normals ask for."""
    sides = [((0, 0, 0), (0, 1, 0), (1, 0, 0)), ((0, 0, 0), (1, 0, 0), (0, 0, 1)), ((0, 0, 0), (0, 0, 1), (0, 1, 0))]
    sides += [((1, 1, 1), tuple(-x for x in v), tuple(-x for x in u)) for _, u, v in sides]
    lines = []
    for i, (corner, u, v) in enumerate(sides):
        corners = 0.5 * (np.array(corner) + np.array([(0, 0, 0), u, np.add(u, v), v]))
        lines += [f"v {x} {y} {z}" for x, y, z in corners]
        lines += [f"vt {s} {t}" for s, t in ((0, 0), (1, 0), (1, 1), (0, 1))]
        lines += ["vn {} {} {}".format(*np.cross(u, v))] * normals
        lines += [f"usemtl side{i}"] * material_per_side
        four = [f"{4 * i + k + 1}/{4 * i + k + 1}" + f"/{i + 1}" * normals for k in range(4)]
        lines += [f"f {four[0]} {four[1]} {four[2]}", f"f {four[0]} {four[2]} {four[3]}"]
    path.write_text("\n".join(lines) + "\n")
    return path


@pytest.mark.parametrize("normals", [False, True])
@pytest.mark.parametrize("material_per_side", [False, True])
def test_seams_of_texture_and_normals_open_nothing(normals: bool, material_per_side: bool, tmp_path: Path) -> None:
    path = _textured_cube(tmp_path / "cube.obj", normals, material_per_side)
    data = read_object(add_object(path, 8.0, 0.4, out=tmp_path / "cube.json"))
    np.testing.assert_allclose(data["com"], (0, 0, 0.25), atol=1e-6)
    np.testing.assert_allclose(data["inertia_per_mass"], [0.5**2 / 6] * 3 + [0] * 3, atol=1e-6)


def _with_degenerate_faces(mesh: Any) -> Any:
    """A face twice, a face whose corners are one point, one that is a line, and a vertex that nothing uses."""
    vertices = np.concatenate([mesh.vertices, mesh.vertices[:1], [[5.0, 5.0, 5.0]]])
    more = [mesh.faces[0], [0, len(mesh.vertices), 1], [2, 2, 3]]
    return trimesh.Trimesh(vertices, np.concatenate([mesh.faces, more]), process=False)


def test_degenerate_and_doubled_faces_and_unused_vertices_change_nothing(tmp_path: Path) -> None:
    cube = trimesh.creation.box((0.5, 0.4, 0.7))
    expected = _inertial_of(cube, tmp_path / "cube.off")
    np.testing.assert_allclose(_inertial_of(_with_degenerate_faces(cube), tmp_path / "more.off"), expected, atol=1e-6)


def test_bodies_that_touch_are_one_object(tmp_path: Path) -> None:
    """Two halves of a box share a wall of equal faces, or touch as two parts of a file whose edges meet."""
    whole = _inertial_of(trimesh.creation.box((0.6, 0.4, 0.8)), tmp_path / "whole.stl")
    lower, upper = (_placed(trimesh.creation.box((0.6, 0.4, 0.4)), 0, 0, z) for z in (0.2, 0.6))
    for name, upper_half in (("same.glb", upper), ("other.glb", upper.copy().apply_transform(np.diag([-1, 1, 1, 1])))):
        scene = trimesh.Scene([lower, upper_half])
        np.testing.assert_allclose(_inertial_of(scene, tmp_path / name, up="z"), whole, atol=1e-5)
    mirrored = _placed(lower.copy().apply_transform(np.diag([1, 1, -1, 1])), 0, 0, 0.8)
    soup = trimesh.util.concatenate([lower, mirrored])
    np.testing.assert_allclose(_inertial_of(soup, tmp_path / "soup.stl"), whole, atol=1e-5)


def test_a_surface_with_one_side_is_refused(tmp_path: Path) -> None:
    """A Klein bottle: a grid of triangles whose tube comes back turned over."""
    n = 12
    faces = []
    for i in range(n):
        for j in range(n):
            a, d = i * n + j, i * n + (j + 1) % n
            b, c = ((i + 1) % n * n + (k if i < n - 1 else -k) % n for k in (j, j + 1))
            faces += [(a, b, c), (a, c, d)]
    bottle = trimesh.Trimesh(np.random.default_rng(0).uniform(0, 0.6, (n * n, 3)), faces, process=False)
    with pytest.raises(ShmooError, match=r"bottle\.off .*inside and outside"):
        _inertial_of(bottle, tmp_path / "bottle.off")


_COLLADA = """<?xml version="1.0"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
  <asset>{asset}</asset>
  <library_geometries><geometry id="g"><mesh>
    <source id="p"><float_array id="a" count="{count}">{points}</float_array><technique_common>
      <accessor source="#a" count="8" stride="3">
        <param name="X" type="float"/><param name="Y" type="float"/><param name="Z" type="float"/>
      </accessor></technique_common></source>
    <vertices id="v"><input semantic="POSITION" source="#p"/></vertices>
    <triangles count="12"><input semantic="VERTEX" source="#v" offset="0"/><p>{faces}</p></triangles>
  </mesh></geometry></library_geometries>
  <library_visual_scenes><visual_scene id="s"><node id="n"><instance_geometry url="#g"/></node></visual_scene>
  </library_visual_scenes>
  <scene><instance_visual_scene url="#s"/></scene>
</COLLADA>
"""


def _collada(path: Path, asset: str, size: tuple[float, float, float]) -> Path:
    box = trimesh.creation.box(size)
    points, faces = (" ".join(map(str, a.ravel().tolist())) for a in (np.asarray(box.vertices), np.asarray(box.faces)))
    path.write_text(_COLLADA.format(asset=asset, points=points, faces=faces, count=24))
    return path


@pytest.mark.parametrize(
    ("asset", "options", "size"),
    [
        ('<unit name="m" meter="1"/><up_axis>Z_UP</up_axis>', {}, (0.5, 0.4, 0.7)),
        ('<unit name="cm" meter="0.01"/><up_axis>Z_UP</up_axis>', {}, (50, 40, 70)),
        ('<unit name="inch" meter="0.0254"/><up_axis>Y_UP</up_axis>', {}, (20, 28, 16)),
        ("", {"scale": 0.001}, (500, 700, 400)),
        ("<up_axis>Y_UP</up_axis>", {"up": "z"}, (0.5, 0.4, 0.7)),
    ],
)
def test_collada_files_have_their_own_unit_and_axis(
    asset: str, options: dict[str, Any], size: tuple[float, float, float], tmp_path: Path
) -> None:
    pytest.importorskip("collada")
    path = _collada(tmp_path / "crate.dae", asset, size)
    made = read_object(add_object(path, 8.0, 0.4, out=tmp_path / "crate.json", **options))
    inches = 0.0254 * np.array([20, 16, 28])
    np.testing.assert_allclose(made["size"], inches if "inch" in asset else (0.5, 0.4, 0.7), atol=1e-5)


def test_collada_without_its_package_or_with_x_up_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = _collada(tmp_path / "crate.dae", "<up_axis>X_UP</up_axis>", (0.5, 0.4, 0.7))
    if importlib.util.find_spec("collada"):
        with pytest.raises(ShmooError, match=r"crate\.dae has x pointing up"):
            add_object(path, 8.0, 0.4, out=tmp_path / "crate.json")
    monkeypatch.setitem(sys.modules, "collada", None)
    with pytest.raises(ShmooError, match=r"crate\.dae .*pip install pycollada .*convert it to GLB or STL"):
        add_object(path, 8.0, 0.4, out=tmp_path / "crate.json")


@pytest.mark.parametrize(
    ("name", "words"),
    [("r.urdf", ("mesh file", "mj_saveLastXML")), ("r.sdf", ("mesh file", "MJCF")), ("r.fbx", ("convert", "STL"))],
)
def test_formats_that_are_no_mesh_say_how_to_convert(name: str, words: tuple[str, ...], tmp_path: Path) -> None:
    (tmp_path / name).write_text("<robot/>")
    with pytest.raises(ShmooError) as error:
        add_object(tmp_path / name, 8.0, 0.4, out=tmp_path / "r.json")
    assert all(word in str(error.value) for word in (name, *words)) and "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("factor", "scale", "words"),
    [
        (1000, 1.0, ("0.001 if it is in millimetres",)),
        (100, 1.0, ("0.01 if it is in centimetres",)),
        (1 / 0.0254, 1.0, ("0.0254 if it is in inches",)),
        (1, 0.001, ("--scale",)),
    ],
)
def test_a_size_that_no_object_has_names_the_likely_units(
    factor: float, scale: float, words: tuple[str, ...], tmp_path: Path
) -> None:
    mesh = trimesh.creation.box((0.5, 0.4, 0.7)).apply_scale(factor)
    with pytest.raises(ShmooError) as error:
        _inertial_of(mesh, tmp_path / "crate.stl", scale=scale)
    assert all(word in str(error.value) for word in ("crate.stl", *words))
    if factor == 1000:
        assert "inches" not in str(error.value)


_TABLE = """
<mujoco>
  <worldbody>
    <body pos="1 2 0">
      <freejoint/>
      <geom type="box" size="0.30 0.20 0.02" pos="0 0 0.58" mass="6"/>
      <geom type="cylinder" size="0.02 0.28" pos="0.26 0.16 0.28" mass="1"/>
      <geom type="cylinder" size="0.02 0.28" pos="-0.26 0.16 0.28" mass="1"/>
      <geom type="cylinder" size="0.02 0.28" pos="0.26 -0.16 0.28" mass="1"/>
      <body pos="-0.26 -0.16 0.28"><geom type="capsule" size="0.02 0.26" mass="1"/></body>
      <geom type="sphere" size="0.3" pos="0 0 0.6" contype="0" conaffinity="0" mass="0"/>
      {more}
    </body>
    {floor}
  </worldbody>
</mujoco>
"""


def _table(path: Path, more: str = "", floor: str = "") -> Path:
    path.write_text(_TABLE.format(more=more, floor=floor))
    return path


def test_an_mjcf_table_keeps_its_shape_mass_and_inertia(tmp_path: Path) -> None:
    made = add_object(_table(tmp_path / "table.xml"), mass=None, friction=0.5, out=tmp_path / "table.json")
    data = read_object(made)
    # The hull is that of the shapes that collide: the sphere for the eye doesn't count.
    np.testing.assert_allclose(data["size"], (0.60, 0.40, 0.60), atol=1e-3)
    assert data["mass"] == pytest.approx(10.0) and len(data["feet"]) == 4
    np.testing.assert_allclose(data["com"], (0, 0, (6 * 0.58 + 4 * 0.28) / 10), atol=1e-6)
    # About z: the top as a plate, the legs as points with their own thin moments.
    legs = 4 * (0.26**2 + 0.16**2) + 4 * 0.5 * 0.02**2
    expected = (6 * (0.6**2 + 0.4**2) / 12 + legs) / 10
    assert data["inertia_per_mass"][2] == pytest.approx(expected, rel=2e-3)
    model = object_alone(draw_condition(str(made), 0))
    assert model.body("object0/object").subtreemass[0] == pytest.approx(10.0)
    assert np.abs(settled(model, 1.0).qvel[:6]).max() < 0.01


def test_an_mjcf_object_takes_mass_scale_and_wheels(tmp_path: Path) -> None:
    made = add_object(
        _table(tmp_path / "table.xml"), 14.0, 0.5, wheels="casters", wheel_radius=0.03, scale=1.2,
        out=tmp_path / "table.json",
    )  # fmt: skip
    np.testing.assert_allclose(read_object(made)["size"], (0.72, 0.48, 0.72), atol=1e-3)
    assert object_alone(draw_condition(str(made), 0)).body_mass.sum() == pytest.approx(14.0)


@pytest.mark.parametrize(
    ("more", "floor", "words"),
    [
        ('<body><joint name="drawer" type="slide"/><geom size="0.1"/></body>', "", ("'drawer'", "--wheels")),
        ("", '<geom type="plane" size="1 1 1"/>', ("plane", "floor")),
        ("", '<body><freejoint/><geom size="0.1"/></body>', ("2 free bodies",)),
        ("<geom/>", "", ("MJCF", "size")),
    ],
)
def test_bad_mjcf_gets_one_sentence(more: str, floor: str, words: tuple[str, ...], tmp_path: Path) -> None:
    with pytest.raises(ShmooError) as error:
        add_object(_table(tmp_path / "thing.xml", more, floor), None, 0.4, out=tmp_path / "thing.json")
    assert "thing.xml" in str(error.value) and "\n" not in str(error.value)
    assert all(word in str(error.value) for word in words)
    assert not list(tmp_path.glob("*.json*"))


def test_a_mesh_without_mass_is_asked_for_it(tmp_path: Path) -> None:
    with pytest.raises(ShmooError, match="--mass"):
        add_object(_box(tmp_path / "crate.stl"), None, 0.4, out=tmp_path / "crate.json")


def _bad_mesh(kind: str, folder: Path) -> tuple[Path, dict[str, Any]]:
    path, options = folder / "thing.stl", {}
    mesh = trimesh.creation.box((0.5, 0.4, 0.7))
    if kind == "scale":
        mesh.apply_scale(1000)
    elif kind == "open":
        mesh = trimesh.Trimesh(mesh.vertices, mesh.faces[2:], process=False)
    elif kind == "flat":
        mesh = trimesh.creation.box((0.5, 0.4, 0.7))
        inner = trimesh.creation.box((0.4999, 0.3999, 0.6999))
        inner.invert()
        mesh = trimesh.util.concatenate([mesh, inner])
    elif kind == "nan":
        vertices = mesh.vertices.copy()
        vertices[3] = np.nan
        mesh = trimesh.Trimesh(vertices, mesh.faces, process=False, validate=False)
    elif kind == "point":
        mesh = trimesh.creation.icosphere(radius=0.3)
    elif kind == "format":
        path = folder / "thing.step"
        path.write_text("x")
        return path, options
    elif kind == "missing":
        return path, options
    elif kind == "rubbish":
        path = folder / "thing.ply"
        path.write_bytes(b"\x00\x01rubbish")
        return path, options
    elif kind == "mass":
        options = {"mass": -1.0}
    elif kind == "wheels":
        options = {"wheels": "rear", "wheel_radius": 0.3}
    elif kind == "topple":
        top = trimesh.creation.box((0.5, 0.5, 0.5), trimesh.transformations.translation_matrix((0.9, 0, 0.8)))
        mesh = trimesh.util.concatenate([mesh, top])
    mesh.export(path)
    return path, options


@pytest.mark.parametrize(
    ("kind", "word"),
    [
        ("scale", "--scale"), ("open", "--hull"), ("flat", "volume"), ("nan", "not finite"),
        ("point", "stands on a point"),
        ("format", "format"), ("missing", "does not exist"), ("rubbish", "thing.ply"), ("mass", "--mass"),
        ("wheels", "--wheel-radius"),
        ("topple", "topple"),
    ],
)  # fmt: skip
def test_bad_meshes_get_one_sentence(kind: str, word: str, tmp_path: Path) -> None:
    path, options = _bad_mesh(kind, tmp_path)
    with pytest.raises(ShmooError) as error:
        add_object(path, **{"mass": 8.0, "friction": 0.4, "out": tmp_path / "thing.json"} | options)
    assert word in str(error.value) and "\n" not in str(error.value)
    assert not list(tmp_path.glob("*.json*"))


def test_a_file_that_is_no_object_is_named(tmp_path: Path) -> None:
    wrong = tmp_path / "wrong.json"
    wrong.write_text("[1, 2]")
    for path in (wrong, tmp_path / "missing.json"):
        with pytest.raises(ShmooError, match=path.name):
            draw_condition(str(path), 0)


@pytest.mark.slow
def test_two_million_triangles(tmp_path: Path) -> None:
    mesh = trimesh.creation.uv_sphere(radius=0.4, count=[1000, 510])
    vertices = mesh.vertices.copy()
    vertices[:, 2] = np.clip(vertices[:, 2], -0.3, None)
    trimesh.Trimesh(vertices, mesh.faces, process=False).export(tmp_path / "egg.stl")
    assert len(mesh.faces) > 2_000_000
    made = add_object(tmp_path / "egg.stl", 8.0, 0.4, hull=True, out=tmp_path / "egg.json")
    assert len(read_object(made)["hull"]) <= 64
    settled(object_alone(draw_condition(str(made), 0)), 0.2)


def test_a_vertex_of_two_numbers_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "chair.obj"
    path.write_text("v 0 0 0\nv 0.5 0 0\nv 0 0.5 0\nv 0 0.6\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n")
    with pytest.raises(ShmooError, match=r"chair\.obj"):
        add_object(path, 4.0, 0.4)
