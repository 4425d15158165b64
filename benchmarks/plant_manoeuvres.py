"""Compares the simulated robot with published manoeuvres of ball-balancing robots, and finds the pushes that topple it.

It uses the C engine of MuJoCo.

Run: python -m benchmarks.plant_manoeuvres            table and figure of docs/plant.md
     python -m benchmarks.plant_manoeuvres --worlds 10000   randomised worlds; a stopped run continues
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import mujoco
import numpy as np

from shmoo_mjx.base.fingerprints import fingerprint
from shmoo_mjx.behavior.drive import DAMPING, LEAD, STIFFNESS
from shmoo_mjx.control import equilibrium_lean
from shmoo_mjx.evaluation.trials import run_trials
from shmoo_mjx.geometry import se2
from shmoo_mjx.plant.lowlevel import Gains, velocity_to_lean
from shmoo_mjx.plant.robot import shmoobot
from shmoo_mjx.plant.scene import Scene, build_scene
from shmoo_mjx.plant.trials import command
from shmoo_mjx.report.style import SERIES
from shmoo_mjx.report.tables import markdown_table
from shmoo_mjx.sensing import PERFECT, REAL, SensedEngine, Senses
from shmoo_mjx.types import DT, Observation

from .plant_figures import _save

MASS = shmoobot().upper_mass + shmoobot().ball_mass
CMU_MASS = 51.66 + 2.44
SCALE = MASS / CMU_MASS
ROBOTS = 5
"""Number of proxy robots per manoeuvre, with seeds 0 to 4."""
FORCES = {4.6: 0.23, 11.5: 0.50, 20.4: 0.82}
"""Constant pushes of the CMU ballbot [N], and its speed after 5 s [m/s]."""
PUBLISHED = {
    "station: position error, largest [mm]": "ballbot 20",
    "circle 0.4 m/s: position error, largest [mm]": "Newton example 179",
    "circle 0.4 m/s: lean, largest [deg]": "Newton example 14.2",
    **{f"{SCALE * force:.1f} N for 5 s: speed [m/s]": f"ballbot {speed}" for force, speed in FORCES.items()},
}
_CHUNK = 100


class Wish(NamedTuple):
    """Desired motion of the robot in {W}. Without ``position`` only the velocity is controlled, and without
    ``velocity`` the commanded lean is zero."""

    position: Any = None
    velocity: Any = None
    acceleration: Any = (0.0, 0.0)


Reference = Callable[[float], Wish]


class Track(NamedTuple):
    """True motion ``[T, W, ...]``, and which robots have fallen ``[W]``."""

    time: np.ndarray
    pose: np.ndarray
    twist: np.ndarray
    lean: np.ndarray
    fallen: np.ndarray


def follow(
    scenes: list[Scene],
    senses: Senses,
    seconds: float,
    wish: Reference,
    *,
    push: Callable[[float], Any] = lambda t: None,
) -> Track:
    """The motion of robots that follow a reference: flat feed-forward with feedback on what they perceive, as in
    navigation.

    Args:
        scenes: scene of each world.
        senses: sensing of the robots.
        seconds: duration [s].
        wish: reference, a function of time.
        push: external wrenches on the robots, a function of time.
    """
    rows: list[Observation] = []
    fallen = np.zeros(len(scenes), dtype=bool)
    with SensedEngine(scenes, senses, list(range(len(scenes)))) as engine:
        world = engine.init()
        seen = engine.observe(world)
        offsets = [equilibrium_lean.init() for _ in scenes]
        for i in range(round(seconds / DT)):
            lean = np.empty((len(scenes), 2))
            for k in range(len(scenes)):
                one = Observation(*(np.asarray(v)[k : k + 1] for v in seen))
                offsets[k] = equilibrium_lean.step(offsets[k], one)
                predicted = equilibrium_lean.predicted(equilibrium_lean.corrected(offsets[k], one), senses.latency)
                lean[k] = _lean(wish, i * DT, predicted) + offsets[k].lean
            world, seen = engine.step(world, command(len(scenes), lean), push=push(i * DT))
            rows.append(engine.true_observation(world))
            fallen |= engine.fallen(world)
    names = ("time", "robot_pose", "robot_twist", "lean")
    time, pose, twist, lean = (np.stack([getattr(r, n) for r in rows]) for n in names)
    return Track(time, pose, twist, lean, fallen)


def _lean(wish: Reference, time: float, seen: Observation) -> np.ndarray:
    a, b, c = shmoobot().flatness
    now, yaw = wish(time), seen.robot_pose[0, 2]
    if now.velocity is None:
        return np.zeros(2)
    if now.position is None:
        moving = se2.rotate(seen.robot_twist[:, :2], -seen.robot_pose[:, 2])
        wanted = se2.rotate(np.array([now.velocity], float), -seen.robot_pose[:, 2])
        return np.asarray(velocity_to_lean(Gains(), moving, seen.lean_rate, wanted))[0]
    ahead = wish(time + LEAD)
    flat = seen.robot_pose[0, :2] + b / a * se2.rotate(seen.lean[0], yaw)
    rate = seen.robot_twist[0, :2] + b / a * se2.rotate(seen.lean_rate[0], yaw)
    wanted = np.asarray(now.position) + b / c * np.asarray(now.acceleration)
    effort = ahead.acceleration + STIFFNESS * (wanted - flat) + DAMPING * (np.asarray(now.velocity) - rate)
    return np.clip(a / c * se2.rotate(effort, -yaw), -Gains().lean_limit, Gains().lean_limit)


def curve(shape: Callable[[float], np.ndarray], rate: float) -> Reference:
    """Reference along ``shape`` (angle -> point). The rate of the angle rises to ``rate`` [rad/s] within 4 s.

    Velocity and acceleration are finite differences.
    """

    def at(time: float) -> np.ndarray:
        ramp = 4.0
        angle = rate * (time**2 / (2 * ramp) if time < ramp else time - ramp / 2)
        return shape(max(angle, 0.0)) - shape(0.0)

    def wish(time: float) -> Wish:
        h = 0.05
        before, here, after = at(max(time - h, 0.0)), at(time), at(time + h)
        return Wish(here, (after - before) / (2 * h), (after - 2 * here + before) / h**2)

    return wish


def circle(angle: float) -> np.ndarray:
    """Point ``[2]`` of the unit circle [m]."""
    return np.array([np.cos(angle), np.sin(angle)])


def eight(angle: float) -> np.ndarray:
    """Point ``[2]`` of a figure eight that is 2 m long and 1 m wide [m]."""
    return np.array([np.sin(angle), 0.5 * np.sin(2 * angle)])


def stand(time: float) -> Wish:
    """Reference that stays at the origin."""
    return Wish((0.0, 0.0), (0.0, 0.0))


def robots(senses: Senses, count: int) -> list[Scene]:
    """Scenes of ``count`` robots, each with parameters of its own."""
    return [build_scene(adjust=senses.adjust(seed)) for seed in range(count)]


def _during(start: float, end: float, force: np.ndarray) -> Callable[[float], Any]:
    return lambda time: force if start - 1e-6 < time < end - 1e-6 else None


def manoeuvres(senses: Senses) -> tuple[dict[str, Any], dict[str, Track]]:
    """Numbers of one kind of robot, and the tracks for the figure.

    Largest errors, leans, times and ways are those of the worst robot. RMS errors are over all robots, speeds after a
    constant push are medians, and falls are counted.
    """
    count = 1 if senses.perfect else ROBOTS
    scenes, numbers, tracks = robots(senses, count), dict[str, Any](), dict[str, Track]()
    wishes: dict[str, tuple[Reference, float]] = {
        "station": (stand, 66.0),
        "circle 0.4 m/s": (curve(circle, 0.4), 40.0),
        "circle 0.6 m/s": (curve(circle, 0.6), 30.0),
        "figure eight 0.5 m/s": (curve(eight, 0.36), 42.0),
    }
    for what, (wish, seconds) in wishes.items():
        track = tracks[what] = follow(scenes, senses, seconds, wish)
        late = track.time[:, 0] > 6.0
        wanted = np.array([wish(t).position for t in track.time[:, 0]])[:, None]
        off = np.hypot(*np.moveaxis(track.pose[..., :2] - wanted, -1, 0))[late]
        numbers[f"{what}: position error, largest [mm]"] = 1e3 * off.max()
        numbers[f"{what}: position error, rms [mm]"] = 1e3 * np.sqrt(np.mean(off**2))
        lean = np.rad2deg(np.hypot(track.lean[..., 0], track.lean[..., 1]))[late]
        numbers[f"{what}: lean, largest [deg]"] = lean.max()
        numbers[f"{what}: falls"] = int(track.fallen.sum())
    track = follow(scenes, senses, 14.0, lambda t: Wish(None, (0.7, 0.0) if t < 6.0 else (0.0, 0.0)))
    speed, along = track.twist[..., 0], track.pose[..., 0]
    after = track.time[:, 0] > 6.0 + 1e-6
    slow = np.array([np.argmax(after & (speed[:, k] < 0.05)) for k in range(count)])
    numbers["stop from 0.7 m/s: time to 0.05 m/s [s]"] = float(track.time[slow, 0].max() - 6.0)
    start = np.argmax(after)
    numbers["stop from 0.7 m/s: way [m]"] = float((along[start:].max(axis=0) - along[start - 1]).max())
    for force in FORCES:
        wrench = np.zeros((count, 6))
        wrench[:, 0] = SCALE * force
        track = follow(scenes, senses, 11.0, lambda t: Wish(), push=_during(6.0, 11.0, wrench))
        numbers[f"{SCALE * force:.1f} N for 5 s: speed [m/s]"] = float(np.median(track.twist[-1, :, 0]))
    wrench = np.zeros((count, 6))
    wrench[:, 0] = SCALE * 310.0
    track = follow(scenes, senses, 8.0, stand, push=_during(2.0, 2.4, wrench))
    numbers[f"kick of {SCALE * 310:.0f} N x 0.4 s: falls of {count}"] = int(track.fallen.sum())
    return numbers, tracks


def table(nominal: dict[str, Any], proxy: dict[str, Any]) -> str:
    """Markdown table of the numbers of the nominal robot, of all proxy robots together, and of published ones."""
    lines = [[name, f"{nominal[name]:.3g}", f"{proxy[name]:.3g}", PUBLISHED.get(name, "")] for name in nominal]
    return markdown_table(["", "nominal", f"{ROBOTS} proxy robots", "published"], lines)


def impulses(senses: Senses) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Largest impulse of 0.1 s that the robot survives, by height and direction.

    Returns:
        Heights above the floor [m], directions [rad], and impulses ``[heights, directions]`` [N s]. The robot survives
        all smaller tested impulses too.
    """
    heights, angles, sizes = np.array([0.3, 0.6, 1.0]), np.deg2rad([0, 45, 90, 135, 180]), np.arange(10.0, 151.0, 10.0)
    grid = np.array([(h, a, s) for h in heights for a in angles for s in sizes])
    scenes = [build_scene(adjust=senses.adjust(0))] * len(grid)
    force = grid[:, 2] / 0.1
    wrench = np.zeros((len(grid), 6))
    wrench[:, 0], wrench[:, 1] = force * np.cos(grid[:, 1]), force * np.sin(grid[:, 1])
    arm = grid[:, 0] - shmoobot().ball_radius - shmoobot().body_com_height
    wrench[:, 3], wrench[:, 4] = -arm * wrench[:, 1], arm * wrench[:, 0]
    fallen = follow(scenes, senses, 5.0, stand, push=_during(1.0, 1.1, wrench)).fallen
    stood = ~fallen.reshape(len(heights), len(angles), len(sizes))
    most = np.where(stood.all(axis=-1), len(sizes), np.argmin(stood, axis=-1))
    return heights, angles, np.where(most > 0, sizes[np.maximum(most - 1, 0)], 0.0)


def envelope_scene(seed: int) -> tuple[Scene, dict[str, float]]:
    """A proxy robot on a random floor: slope up to 3 deg, a step of up to 5 mm 0.6 m ahead, friction 0.2 to 1."""
    rng = np.random.default_rng([29, seed])
    drawn = {
        "slope": float(np.deg2rad(rng.uniform(0, 3))),
        "towards": float(rng.uniform(-np.pi, np.pi)),
        "step": float(rng.uniform(0, 0.005)),
        "friction": float(rng.uniform(0.2, 1.0)),
    }

    def adjust(spec: mujoco.MjSpec) -> None:
        REAL.adjust(seed)(spec)
        for geom in spec.geoms:
            if geom.name in ("floor", "robot/ball"):
                geom.friction[0] = drawn["friction"]
        half = max(drawn["step"] / 2, 1e-4)
        spec.worldbody.add_geom(
            name="step", type=mujoco.mjtGeom.mjGEOM_BOX, pos=[2.6, 0.0, half], size=[2.0, 4.0, half], contype=0,
            conaffinity=1, friction=[drawn["friction"], 0.005, 0.0001],
        )  # fmt: skip
        tilt, towards = np.sin(drawn["slope"]), drawn["towards"]
        spec.option.gravity = 9.81 * np.array([tilt * np.cos(towards), tilt * np.sin(towards), -np.cos(drawn["slope"])])

    return build_scene(adjust=adjust), drawn


def envelope(first: int) -> list[dict[str, Any]]:
    """The rows of a chunk of worlds, with the seeds from ``first`` on.

    The robot drives over the step at 0.4 m/s, stops, and gets a push of up to 5 N s from any side while standing.
    """
    count = _CHUNK
    worlds = [envelope_scene(seed) for seed in range(first, first + count)]
    rng = np.random.default_rng([31, first])
    size, angle = rng.uniform(0, 5, count) / 0.1, rng.uniform(-np.pi, np.pi, count)
    wrench = np.zeros((count, 6))
    wrench[:, 0], wrench[:, 1] = size * np.cos(angle), size * np.sin(angle)
    wish = lambda t: Wish(None, (0.4, 0.0) if 1.0 < t < 5.0 else (0.0, 0.0))  # noqa: E731
    track = follow([scene for scene, _ in worlds], REAL, 11.0, wish, push=_during(8.0, 8.1, wrench))
    return [drawn | {"fell": bool(f)} for (_, drawn), f in zip(worlds, track.fallen, strict=True)]


def survey(count: int, out: Path, workers: int) -> None:
    """Print how many robots fell in the worlds of the envelope. Finished chunks are kept by fingerprint of the code."""
    chunks = {f"{first:05d}": first for first in range(0, count, _CHUNK)}
    code = fingerprint("shmoo_mjx.sensing.engine", {"chunk": _CHUNK}, Path(__file__))
    report = lambda what, done: print(f"{what}, {done:.0%}", flush=True)  # noqa: E731
    rows = run_trials(chunks, envelope, out / f"envelope-{code}", report, workers=workers)
    fell = [seed for seed, row in enumerate(rows) if row["fell"]]
    print(f"{len(rows)} worlds, {len(fell)} fell: {fell[:10]}")


def draw(tracks: dict[str, Track], most: tuple[np.ndarray, np.ndarray, np.ndarray]) -> None:
    """Draw plant_manoeuvres.png from the tracks of `manoeuvres` and the result of `impulses`."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, 4, figsize=(15, 3.6), layout="constrained")
    station = tracks["station"]
    late = station.time[:, 0] > 6.0
    for k in range(station.pose.shape[1]):
        axes[0].plot(*(1e3 * station.pose[late, k, :2].T), color=SERIES[k], lw=0.7)
    axes[0].add_patch(plt.Circle((0, 0), 20, fill=False, color="0.5", ls=":"))
    axes[0].set(xlabel="x [mm]", ylabel="y [mm]", title="station keeping 60 s, five proxy robots", aspect="equal")
    for axis, names in ((axes[1], ("circle 0.4 m/s", "circle 0.6 m/s")), (axes[2], ("figure eight 0.5 m/s",))):
        for k, what in enumerate(names):
            track = tracks[what]
            axis.plot(*track.pose[track.time[:, 0] > 6.0, 0, :2].T, color=SERIES[k], lw=0.8, label=what)
        axis.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
        axis.legend(fontsize=8)
    angle = np.linspace(0, 2 * np.pi, 200)
    axes[1].plot(np.cos(angle) - 1, np.sin(angle), color="0.5", lw=0.6, ls=":")
    axes[2].plot(np.sin(angle), 0.5 * np.sin(2 * angle), color="0.5", lw=0.6, ls=":")
    heights, angles, sizes = most
    for k, height in enumerate(heights):
        axes[3].plot(np.rad2deg(angles), sizes[k], "o-", color=SERIES[k], label=f"{height:g} m above the floor")
    axes[3].set(xlabel="direction [deg]", ylabel="[N s]", title="largest impulse of 0.1 s survived", ylim=(0, None))
    axes[3].legend(fontsize=8)
    _save(figure, "plant_manoeuvres")


def main() -> None:
    """Print the table and draw the figure, or survey the envelope."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--worlds", type=int, default=0, help="randomised worlds of the envelope, in hundreds")
    parser.add_argument("--workers", type=int, default=2, help="processes")
    parser.add_argument("--out", type=Path, default=Path("runs/plant_manoeuvres"))
    args = parser.parse_args()
    if args.worlds:
        survey(args.worlds, args.out, args.workers)
        return
    nominal, _ = manoeuvres(PERFECT)
    proxy, tracks = manoeuvres(REAL)
    print(table(nominal, proxy))
    most = impulses(REAL)
    print("largest impulse survived [N s], heights x directions:", most[0], np.rad2deg(most[1]), most[2], sep="\n")
    draw(tracks, most)


if __name__ == "__main__":
    main()
