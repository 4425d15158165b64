"""Converts a mesh or MJCF file into an object file, which can be used wherever a family name can.

``shmoo object add chair.stl --mass 7 --friction 0.4`` writes chair.json with convex hull, mass, CoM, inertia, and feet
or wheels. Use the object as ``family: chair.json`` in a scenario or ``draw_condition("chair.json", seed)`` in Python.
"""

from __future__ import annotations

import hashlib
import json
import warnings
from pathlib import Path
from typing import Any, Literal

import numpy as np
import shapely

from shmoo_mjx.base.files import write_whole
from shmoo_mjx.base.guard import OBJECT, check_output
from shmoo_mjx.base.schema import validated
from shmoo_mjx.errors import ShmooError
from shmoo_mjx.plant.closed_surface import closed_solid
from shmoo_mjx.plant.mjcf_object import read_mjcf
from shmoo_mjx.plant.object_file import ObjectFile, Wheels

_FORMATS = (".stl", ".obj", ".ply", ".glb", ".gltf", ".off", ".dae")
_CONVERT = "convert it to GLB or STL, for instance with Blender"
_UNITS = {"millimetres": 0.001, "centimetres": 0.01, "inches": 0.0254}
_Y_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
"""Rotation from axes with y up to axes with z up."""
_HULL_VERTICES = 64
_MOST_FEET = 6


def add_object(
    source: Path,
    mass: float | None,
    friction: float,
    *,
    wheels: Wheels = "none",
    wheel_radius: float = 0.04,
    rolling: float = 0.02,
    swivel_friction: float = 0.05,
    scale: float = 1.0,
    up: Literal["auto", "y", "z"] = "auto",
    hull: bool = False,
    out: Path | None = None,
) -> Path:
    """Convert a mesh file or an MJCF file into an object file.

    Args:
        source: STL, OBJ, PLY, OFF, GLB, glTF, Collada (with pycollada), or MJCF (.xml) of one rigid object.
        mass: mass of the whole object including wheels [kg]; None takes the mass of the MJCF file.
        friction: Coulomb friction coefficient between the floor and the feet or wheels.
        wheels: "none" (the object slides on its feet), "casters" (a swivel caster at each foot) or "rear" (two fixed
            wheels at the rear, two casters in front; x points forward).
        wheel_radius: radius of the wheels [m].
        rolling: rolling resistance coefficient of each wheel.
        swivel_friction: dry friction torque of each caster's swivel [N m].
        scale: metres per unit of the file: 0.001 for millimetres, 0.01 for centimetres, 0.0254 for inches. For a
            Collada file it is multiplied by the unit that the file states.
        up: axis of the file that points up. "auto" is y for GLB and glTF (as the format defines), the stated axis for
            Collada, and z otherwise.
        hull: whether to use the mass distribution of the convex hull, for a mesh that isn't closed.
        out: file to write, by default the source's name with .json in the current folder.

    Returns:
        Path of the written file.

    Raises:
        ShmooError: the file can't be read as an object, or a number is out of range.
    """
    name = source.name
    target = Path(source.stem + ".json") if out is None else Path(out)
    check_output(target, OBJECT, ".json")
    if not 0 < scale < np.inf:
        raise ShmooError(f"--scale {scale} must be a positive number.")
    if source.suffix.lower() == ".xml":
        vertices, inertial, own_mass = _measure_mjcf(source, scale, up, hull)
        mass = own_mass if mass is None else mass
    else:
        vertices, inertial = _measure(source, scale, up, hull)
    if mass is None:
        raise ShmooError(f"{name} is a mesh, which has no mass; give --mass in kg.")
    for what, value, low, high in (("mass", mass, 0.5, 500.0), ("friction", friction, 0.05, 2.0)):
        if not (np.isfinite(value) and low <= value <= high):
            raise ShmooError(f"{name}: --{what} {value:g} must lie between {low} and {high}.")
    size, centre = np.ptp(vertices, axis=0), (vertices.max(axis=0) + vertices.min(axis=0)) / 2
    if wheels != "none" and not 0 < wheel_radius < min(size) / 2:
        raise ShmooError(f"--wheel-radius {wheel_radius:g} must be below half the object's {min(size):.2f} m.")
    shift = np.array([centre[0], centre[1], vertices[:, 2].min()])
    vertices, com = vertices - shift, inertial["com"] - shift
    if wheels == "rear":
        x, y = size[0] / 2 - wheel_radius, size[1] / 2 - wheel_radius
        feet = np.array([(-x, y), (-x, -y), (x, y), (x, -y)])
    else:
        feet = _feet(vertices, name)
    data = {
        "schema": 1,
        "source": {"file": name, "sha256": hashlib.sha256(source.read_bytes()).hexdigest()},
        "size": _rounded(size),
        "mass": round(mass, 6),
        "friction": friction,
        "com": _rounded(com),
        "inertia_per_mass": _rounded(inertial["inertia"]),
        "hull": _rounded(_fewer(vertices)),
        "feet": _rounded(feet),
        "wheels": wheels,
        "wheel_radius": wheel_radius,
        "rolling": rolling,
        "swivel_friction": swivel_friction,
    }
    validated(ObjectFile, data, name)
    return write_whole(target, json.dumps(data, indent=1).encode())


def _measure(mesh_file: Path, scale: float, up: str, hull: bool) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Vertices of the convex hull [m], and CoM [m] and inertia per mass (xx, yy, zz, xy, xz, yz) [m^2], with z up."""
    import trimesh

    parts, unit, own_up = _load(mesh_file)
    name = mesh_file.name
    for part in parts:
        if part.vertices.ndim != 2 or part.vertices.shape[1] != 3:
            raise ShmooError(f"{name} has vertices that are not three numbers each; export the mesh again.")
        if not np.isfinite(part.vertices).all():
            raise ShmooError(f"{name} has vertices that are not finite numbers; export the mesh again.")
        if (own_up if up == "auto" else up) == "y":
            part.vertices = part.vertices @ _Y_UP.T
        part.apply_scale(scale * unit)
    points = np.concatenate([part.vertices[part.faces].reshape(-1, 3) for part in parts] or [np.zeros((0, 3))])
    if len(points) < 12:
        raise ShmooError(f"{name} holds no surface; export the object as triangles.")
    size = _checked_size(points, name, scale)
    shell = trimesh.convex.convex_hull(points)
    solid = shell if hull else closed_solid(parts, name)
    volume = float(solid.volume)
    if volume < 1e-3 * float(np.prod(size)):
        raise ShmooError(
            f"{name} encloses hardly any volume ({volume:.2g} m^3); give its walls a thickness or pass --hull."
        )
    return np.asarray(shell.vertices), _inertial(solid.center_mass, np.asarray(solid.moment_inertia) / volume)


def _measure_mjcf(source: Path, scale: float, up: str, hull: bool) -> tuple[np.ndarray, dict[str, np.ndarray], float]:
    """Like `_measure` for an MJCF file, and also its mass [kg]."""
    import trimesh

    solid = read_mjcf(source)
    axes = _Y_UP if up == "y" else np.eye(3)
    points = scale * solid.points @ axes.T
    _checked_size(points, source.name, scale)
    shell = trimesh.convex.convex_hull(points)
    if hull:
        inertial = _inertial(shell.center_mass, np.asarray(shell.moment_inertia) / float(shell.volume))
    else:
        inertial = _inertial(scale * axes @ solid.com, scale * scale * axes @ solid.inertia @ axes.T)
    return np.asarray(shell.vertices), inertial, solid.mass


def _inertial(com: Any, inertia: np.ndarray) -> dict[str, np.ndarray]:
    return {"com": np.asarray(com), "inertia": inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]}


def _checked_size(points: np.ndarray, name: str, scale: float) -> np.ndarray:
    size: np.ndarray = np.ptp(points, axis=0)
    if _is_size(size):
        return size
    likely = [f"{scale * unit:g} if it is in {units}" for units, unit in _UNITS.items() if _is_size(size * unit)]
    text = " x ".join(f"{s:.3g}" for s in size)
    raise ShmooError(
        f"{name} measures {text} m, but an object's longest side is 0.2 to 2.5 m and its shortest at least 0.05 m; "
        f"give --scale in metres per unit of the file ({', '.join(likely) or '0.001 for millimetres'})."
    )


def _is_size(size: np.ndarray) -> bool:
    return bool(0.2 <= max(size) <= 2.5 and min(size) >= 0.05)


def _load(mesh_file: Path) -> tuple[list[Any], float, str]:
    """The parts of a mesh file, its length unit [m], and the axis that points up."""
    import trimesh

    name, kind = mesh_file.name, mesh_file.suffix.lower()
    if kind in (".urdf", ".xacro", ".sdf", ".world"):
        raise ShmooError(
            f"{name} describes bodies and joints, not a mesh: give the mesh file that it names (<mesh>), or write the "
            "object as MJCF (.xml), which MuJoCo makes of a URDF by mujoco.mj_saveLastXML."
        )
    if kind not in _FORMATS:
        raise ShmooError(
            f"{name} is no format known here: use one of {', '.join(_FORMATS)} or .xml (MJCF), or {_CONVERT}."
        )
    if not mesh_file.is_file():
        raise ShmooError(f"{mesh_file} does not exist; give the path of a mesh file.")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # pycollada warns about NumPy
            unit, up = _collada_axes(mesh_file) if kind == ".dae" else (1.0, "y" if kind in (".glb", ".gltf") else "z")
            scene = trimesh.load_scene(mesh_file, process=False)
            parts = [part for part in scene.dump() if isinstance(part, trimesh.Trimesh) and len(part.faces)]
    except ShmooError:
        raise
    except Exception as error:
        raise ShmooError(
            f"{name} can't be read as a mesh ({' '.join(str(error).split())}); export it again."
        ) from error
    return parts, unit, up


def _collada_axes(mesh_file: Path) -> tuple[float, str]:
    """Length unit [m] and upward axis of a Collada file; the format's defaults are 1 m and y."""
    try:
        import collada
    except ImportError:
        raise ShmooError(
            f"{mesh_file.name} is a Collada file, which needs the package pycollada, not installed here; "
            f"pip install pycollada (in a clone, '.[meshes]'), or {_CONVERT}."
        ) from None
    asset = collada.Collada(str(mesh_file), ignore=[collada.common.DaeError]).assetInfo
    if asset.upaxis == collada.asset.UP_AXIS.X_UP:
        raise ShmooError(f"{mesh_file.name} has x pointing up, which is not known here; {_CONVERT}, with z up.")
    return float(asset.unitmeter or 1.0), "z" if asset.upaxis == collada.asset.UP_AXIS.Z_UP else "y"


def _fewer(vertices: np.ndarray) -> np.ndarray:
    """At most 64 of the hull's vertices: the support points in evenly distributed directions."""
    if len(vertices) <= _HULL_VERTICES:
        return vertices
    i = np.arange(_HULL_VERTICES)
    z, turn = 1 - (2 * i + 1) / _HULL_VERTICES, np.pi * (1 + np.sqrt(5)) * i
    flat = np.sqrt(1 - z * z)
    directions = np.stack([flat * np.cos(turn), flat * np.sin(turn), z], axis=-1)
    return vertices[np.unique(np.argmax(vertices @ directions.T, axis=0))]


def _feet(vertices: np.ndarray, name: str) -> np.ndarray:
    """Corners ``[F, 2]`` of the support area [m], at most six."""
    low = vertices[vertices[:, 2] < 0.005 + 0.01 * vertices[:, 2].max(), :2]
    area = shapely.MultiPoint(low).convex_hull
    if not isinstance(area, shapely.Polygon) or area.area < 0.1 * np.prod(np.ptp(vertices[:, :2], axis=0)):
        raise ShmooError(f"{name} stands on a point or an edge; turn it so that it stands, or give --up y.")
    # Merge neighbouring corners: a leg or wheel has several corners but is one foot.
    near = 0.15 * float(np.sqrt(area.area))
    groups: list[list[np.ndarray]] = []
    for corner in np.asarray(area.exterior.coords)[:-1]:
        if groups and np.linalg.norm(corner - groups[-1][-1]) < near:
            groups[-1].append(corner)
        else:
            groups.append([corner])
    if len(groups) > 1 and np.linalg.norm(groups[0][0] - groups[-1][-1]) < near:
        groups[0] += groups.pop()
    corners = np.array([np.mean(g, axis=0) for g in groups])
    tolerance, outline = 0.001, corners
    # On a round base all corners merge into few groups, so simplify its outline instead.
    if len(corners) < 3:
        outline = np.asarray(area.exterior.coords)[:-1]
    while len(outline) > _MOST_FEET:
        tolerance *= 1.3
        outline = np.asarray(shapely.Polygon(outline).simplify(tolerance).exterior.coords)[:-1]
    return outline


def _rounded(values: np.ndarray) -> list[Any]:
    return np.round(values, 6).tolist()
