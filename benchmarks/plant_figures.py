"""Draws docs/figures/plant_*.png and sensing_push.png, and prints the numbers that docs/plant.md and sensing.md quote.

It takes about two minutes on one core.

Run: python -m benchmarks.plant_figures
"""

from __future__ import annotations

import io
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from shmoo_mjx.geometry.hands import HAND_HEIGHT, REACH, TUCKED_HEIGHT, TUCKED_REACH
from shmoo_mjx.plant.condition import Condition
from shmoo_mjx.plant.engine_mujoco import MujocoEngine
from shmoo_mjx.plant.joint_torque import joint_torque_wrench
from shmoo_mjx.plant.lowlevel import Gains
from shmoo_mjx.plant.objects import draw_condition
from shmoo_mjx.plant.robot import shmoobot
from shmoo_mjx.plant.scene import build_scene
from shmoo_mjx.plant.trials import command, drive, object_alone, pushed, settled
from shmoo_mjx.report.style import SERIES, outline
from shmoo_mjx.sensing import REAL, SensedEngine

FIGURES = Path(__file__).resolve().parent.parent / "docs" / "figures"
NUMBERS: dict[str, Any] = {}


def _save(figure: Any, name: str) -> None:
    from PIL import Image

    raw = io.BytesIO()
    figure.savefig(raw, dpi=110, bbox_inches="tight")
    # A palette of 64 colours needs a quarter of the space and looks the same.
    picture = Image.open(raw).convert("RGB").quantize(64)
    part = FIGURES / f"{name}.part.png"
    picture.save(part, optimize=True)
    os.replace(part, FIGURES / f"{name}.png")


def _during(start: float, end: float, value: Any, otherwise: Any) -> Callable[[float], Any]:
    """A function of time that is ``value`` between start and end."""
    return lambda time: value if start < time < end else otherwise


def robot_figure(plt: Any) -> None:
    """Draw plant_robot.png: pushes from all sides, velocity steps, a lean step, and the feed-forward of the arms."""
    figure, axes = plt.subplots(1, 4, figsize=(15, 3.4), layout="constrained")
    scene = build_scene()
    single, many = MujocoEngine([scene]), MujocoEngine([scene] * 16)
    _pushes(axes[0], many)
    for k, wanted in enumerate((0.3, 0.5)):
        track, _ = drive(single, 6.0, _during(0.95, 99.0, (wanted, 0.0), (0.0, 0.0)))
        speed = track.robot_twist[:, 0, 0]
        axes[1].plot(track.time[:, 0], speed, color=SERIES[k], label=f"{wanted} m/s")
        axes[1].axhline(wanted, color=SERIES[k], lw=0.6, ls=":")
        NUMBERS[f"velocity step {wanted} m/s: t90 [s]"] = float(track.time[np.argmax(speed > 0.9 * wanted), 0] - 1.0)
        NUMBERS[f"velocity step {wanted} m/s: overshoot"] = float(speed.max() / wanted - 1)
        NUMBERS[f"velocity step {wanted} m/s: peak lean [deg]"] = float(np.rad2deg(np.abs(track.lean).max()))
    axes[1].set(xlabel="time [s]", ylabel="speed [m/s]", title="velocity steps")
    axes[1].legend()
    _lean_step(axes[2], single)
    _feed_forward(axes[3], scene)
    noise = (np.random.default_rng(0), 0.01, 0.01)
    track, fallen = drive(single, 60.0, station=0.8, sensor_noise=noise)
    NUMBERS["stands 60 s with sensor noise: largest drift [m]"] = float(np.hypot(*track.robot_pose[:, 0, :2].T).max())
    assert not fallen.any()
    track, _ = drive(single, 5.0, station=0.8, yaw=1.5)
    NUMBERS["pivot by 1.5 rad: largest displacement [m]"] = float(np.hypot(*track.robot_pose[:, 0, :2].T).max())
    _save(figure, "plant_robot")


def _pushes(axes: Any, many: MujocoEngine) -> None:
    angle = np.arange(16) * np.pi / 8
    for share, arms in ((0, (TUCKED_REACH, TUCKED_HEIGHT)), (1, (REACH, HAND_HEIGHT))):
        push = np.zeros((16, 6))
        push[:, 0], push[:, 1] = 20 * np.cos(angle), 20 * np.sin(angle)
        track, fallen = drive(
            many,
            8.0,
            station=0.8,
            push=_during(2.95, 3.45, push, None),
            arms=_during(-1.0, 99.0, arms, arms),
        )
        away = track.robot_pose[29:, :, :2] - track.robot_pose[29, :, :2]
        excursion = np.hypot(away[..., 0], away[..., 1]).max(axis=0)
        name = ("arms folded", "arms out")[share]
        NUMBERS[f"20 N x 0.5 s, 16 sides, {name}: excursion [m]"] = (float(excursion.min()), float(excursion.max()))
        NUMBERS[f"20 N x 0.5 s, {name}: falls"] = int(fallen.sum())
        axes.plot(away[..., 0], away[..., 1], color=SERIES[share], lw=0.8)
        axes.plot([], [], color=SERIES[share], label=name)
    axes.set(xlabel="x [m]", ylabel="y [m]", title="20 N x 0.5 s from 16 sides", aspect="equal")
    axes.legend(fontsize=8)


def _lean_step(axes: Any, single: MujocoEngine) -> None:
    world, wanted, leans = single.init(), np.deg2rad(5.0), []
    for _ in range(75):
        world, seen = single.step(world, command(1, (wanted, 0.0)), 0.02)
        leans.append(seen.lean[0, 0])
    time, lean = 0.02 * np.arange(1, 76), np.array(leans)
    NUMBERS["lean step 5 deg: t90 [s]"] = float(time[np.argmax(lean > 0.9 * wanted)])
    NUMBERS["lean step 5 deg: overshoot"] = float(max(lean.max() / wanted - 1, 0.0))
    axes.plot(time, np.rad2deg(lean), color=SERIES[0])
    axes.axhline(5.0, color="0.5", lw=0.6, ls=":")
    axes.set(xlabel="time [s]", ylabel="lean [deg]", title="lean command of 5 deg")


def _feed_forward(axes: Any, scene: Any) -> None:
    for k, share in enumerate((1.0, 0.0)):
        engine = MujocoEngine([scene], Gains(com_feed_forward=share))
        track, _ = drive(
            engine,
            12.0,
            arms=lambda time: (REACH, HAND_HEIGHT) if 1 < time % 6 < 4 else (TUCKED_REACH, TUCKED_HEIGHT),
        )
        engine.close()
        x = track.robot_pose[:, 0, 0] - track.robot_pose[9, 0, 0]
        label = "on" if share else "off"
        NUMBERS[f"arms out and in, feed-forward {label}: largest drift [m]"] = float(np.abs(x[9:]).max())
        axes.plot(track.time[:, 0], x, color=SERIES[k], label=f"feed-forward {label}")
    axes.set(xlabel="time [s]", ylabel="x [m]", title="arms out and in, velocity loop only")
    axes.legend()


def _eight() -> list[tuple[str, Condition]]:
    free, aligned = {"locked": (False,) * 4}, (0.0, 0.0)
    chair = {"payload": 20.0, "payload_x": 0.0, "payload_y": 0.0, "caster_angle": aligned}
    return [
        ("box 8 kg, mu 0.3", draw_condition("box", 1, {"mass": 8.0, "payload": 0.0, "friction": 0.3})),
        ("box 10 kg, mu 0.5", draw_condition("box", 1, {"mass": 10.0, "payload": 0.0, "friction": 0.5})),
        (
            "box, load on the left",
            draw_condition("box", 1, {"mass": 4.0, "payload": 5.0, "payload_x": 0.0, "payload_y": 0.2}),
        ),
        ("cart, casters ahead", draw_condition("cart", 0, free | {"caster_angle": (0.0,) * 4})),
        ("cart, casters askew", draw_condition("cart", 0, free | {"caster_angle": (1.5, 1.5, 0.0, 0.0)})),
        ("cart, front left locked", draw_condition("cart", 0, {"locked": (True, False, False, False)})),
        ("wheelchair", draw_condition("wheelchair", 0, free | chair)),
        ("wheelchair, left locked", draw_condition("wheelchair", 0, chair | {"locked": (True, False, False, False)})),
    ]


def objects_figure(plt: Any) -> None:
    """Draw plant_objects.png: the motion of eight objects under the same push."""
    figure, axes = plt.subplots(2, 4, figsize=(13, 6), layout="constrained", sharex=True, sharey=True)
    push = np.zeros((1000, 3))
    push[:200] = 60.0, 0.0, 2.0
    for k, (name, condition) in enumerate(_eight()):
        model = object_alone(condition)
        track = pushed(model, settled(model), push, 2.0, follow=True)
        for j, i in enumerate((0, 199, 399, 999)):
            corners = outline(track.pose[i], condition.half_extents)
            axes.flat[k].fill(*corners.T, facecolor=SERIES[k], alpha=0.12 + 0.12 * j, edgecolor=SERIES[k], lw=0.8)
        axes.flat[k].plot(*track.pose[:, :2].T, color="k", lw=1.2)
        x, y, yaw = track.pose[-1]
        axes.flat[k].set_title(f"{name}\n{x:.2f} m, {y:+.2f} m, {np.rad2deg(yaw):+.0f} deg", fontsize=9)
        axes.flat[k].set(aspect="equal", xlim=(-0.7, 2.2), ylim=(-1.3, 1.3))
    figure.supxlabel("x [m]")
    figure.supylabel("y [m]")
    _save(figure, "plant_objects")


def wrench_figure(plt: Any) -> None:
    """Draw plant_wrench.png: the wrench from contacts and from joint torques, and the momentum balance."""
    figure, axes = plt.subplots(1, 2, figsize=(11, 3.4), layout="constrained")
    condition = draw_condition("box", 1, {"mass": 12.0, "payload": 0.0, "friction": 0.3})
    scene = build_scene([(condition, (REACH + 0.14 + condition.half_extents[0], 0.06, 0.0))])
    engine = MujocoEngine([scene])
    world, rows = engine.init(), []
    for i in range(60):
        lean = 0.0 if i < 8 else 0.09 if i < 40 else -0.05
        wanted = command(1, (lean, 0.0), gamma=0.1, reach=REACH, hand_height=HAND_HEIGHT)
        world, seen = engine.step(world, wanted)
        torque = engine.torque(world, wanted)[:, 3:]
        felt = joint_torque_wrench(shmoobot(), engine.robot(world), torque, seen.object_pose[:, 0])[0]
        rows.append((seen.time[0], *seen.wrench[0, 0], *felt, seen.object_twist[0, 0, 0]))
    engine.close()
    time, fx, _, tz, jx, _, jz, speed = np.array(rows).T
    axes[0].plot(time, fx, color=SERIES[0], label="force, contacts (mean over 0.1 s)")
    axes[0].plot(time, jx, color=SERIES[1], lw=1, label="force, J tau (end of sample)")
    axes[0].plot(time, tz, color=SERIES[2], label="moment, contacts [N m]")
    axes[0].plot(time, jz, color=SERIES[3], lw=1, label="moment, J tau [N m]")
    axes[0].set(xlabel="time [s]", ylabel="[N], [N m]", title="Gamma while a 12 kg box is pushed")
    axes[0].legend(fontsize=8)
    touching = fx > 5
    NUMBERS["J tau against contacts, moving: rms force error [N]"] = float(np.sqrt(np.mean((jx - fx)[touching] ** 2)))
    NUMBERS["J tau against contacts, moving: mean force [N]"] = float(fx[touching].mean())
    sliding = np.flatnonzero(speed > 0.05)
    first, last = sliding[0], sliding[-1]
    given = np.cumsum(0.1 * fx[first + 1 : last + 1])
    elapsed = time[first + 1 : last + 1] - time[first]
    taken = 12.0 * (speed[first + 1 : last + 1] - speed[first]) + 0.3 * 12.0 * 9.81 * elapsed
    NUMBERS["impulse over momentum change and friction - 1"] = float(given[-1] / taken[-1] - 1)
    axes[1].plot(elapsed, given, color=SERIES[0], label="impulse of the hands")
    axes[1].plot(elapsed, taken, "--", color=SERIES[1], label="m dv + mu m g dt")
    axes[1].set(xlabel="time since sliding began [s]", ylabel="[N s]", title="momentum balance")
    axes[1].legend(fontsize=8)
    _save(figure, "plant_wrench")


def senses_figure(plt: Any) -> None:
    """Draw sensing_push.png: pose, velocity and force of an object, true and as the robot perceives them."""
    figure, axes = plt.subplots(1, 3, figsize=(13, 3.4), layout="constrained")
    condition = draw_condition("box", 1, {"mass": 9.0, "payload": 0.0, "friction": 0.35})
    place = (REACH + 0.12 + condition.half_extents[0], 0.03, 0.1)
    squares = []
    for seed in range(1, 6):
        reported: list[Any] = []
        true: list[Any] = []
        time: list[Any] = []
        with SensedEngine([build_scene([(condition, place)], adjust=REAL.adjust(seed))], REAL, seed) as engine:
            world = engine.init()
            for i in range(60):
                wanted = command(
                    1, (0.0 if i < 8 else 0.1 if i < 40 else -0.05, 0.0), reach=REACH, hand_height=HAND_HEIGHT
                )
                world, seen = engine.step(world, wanted)
                for rows, it in ((reported, seen), (true, engine.true_observation(world))):
                    rows.append((*it.object_pose[0, 0], *it.object_twist[0, 0], it.wrench[0, 0, 0]))
                time.append(seen.time[0])
        squares.append((np.array(reported) - np.array(true)) ** 2)
        if seed == 1:
            a, b = np.array(reported), np.array(true)
    for k, (column, name, unit) in enumerate(((0, "x", "m"), (3, "vx", "m/s"), (6, "force", "N"))):
        axes[k].plot(time, b[:, column], color=SERIES[0], label="true")
        axes[k].plot(time, a[:, column], color=SERIES[1], lw=1, label="as the robot perceives it")
        rms = np.sqrt(np.mean(np.array(squares)[..., column]))
        NUMBERS[f"real senses, five robots, rms error of object {name} [{unit}]"] = float(rms)
        axes[k].set(xlabel="time [s]", ylabel=f"{name} [{unit}]", title=f"object {name}: rms error {rms:.3g} {unit}")
    axes[0].legend(fontsize=8)
    _save(figure, "sensing_push")


def main() -> None:
    """Draw all four figures."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    FIGURES.mkdir(parents=True, exist_ok=True)
    for draw in (robot_figure, objects_figure, wrench_figure, senses_figure):
        draw(plt)
    for name, value in NUMBERS.items():
        numbers = value if isinstance(value, tuple) else (value,)
        print(f"{name}: {' to '.join(f'{n:.4g}' for n in numbers)}")


if __name__ == "__main__":
    main()
