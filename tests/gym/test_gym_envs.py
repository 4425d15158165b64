"""The environments keep Gymnasium's rules, and mean what their tables say."""

# ruff: noqa: E402 (without the extra the file is skipped before it imports what needs it)
from __future__ import annotations

import copy
import importlib
import pickle
import sys
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely
import trimesh

gymnasium = pytest.importorskip("gymnasium", reason="the extra gym (gymnasium) is not installed")

import shmoo_mjx.gym
from shmoo_mjx.errors import ShmooError
from shmoo_mjx.geometry import se2
from shmoo_mjx.gym import navigate, single, task
from shmoo_mjx.gym.navigate import NavigateConfig
from shmoo_mjx.gym.push import PushEnvConfig, PushEnvTask
from shmoo_mjx.planning.distance_field import DistanceField
from shmoo_mjx.planning.floorplan import demo_scenario
from shmoo_mjx.planning.footprints import footprint_polygon
from shmoo_mjx.planning.line_costs import PathConfig
from shmoo_mjx.planning.maps import OccupancyGrid, distance_field
from shmoo_mjx.planning.paths import plan_path
from shmoo_mjx.planning.scenario import ROBOT_RADIUS, Scenario
from shmoo_mjx.plant.engine_mujoco import MujocoEngine
from shmoo_mjx.plant.mesh import add_object
from shmoo_mjx.plant.objects import draw_condition
from shmoo_mjx.plant.render import can_render, has_display
from shmoo_mjx.report.tables import markdown_table
from shmoo_mjx.types import Observation

NAMES = list(shmoo_mjx.gym.EPISODE_STEPS)
PAGE = Path(__file__).resolve().parents[2] / "docs" / "gym.md"


def in_line_of_sight(
    seen: Observation, index: int, half_extents: tuple[float, float], walls: DistanceField, *, reach: float
) -> bool:
    """Whether some corner of an object is within ``reach`` metres and in line of sight over the map."""
    robot = seen.robot_pose[0, :2]
    corners = np.asarray(footprint_polygon(seen.object_pose[0, index], half_extents).exterior.coords)[:4]
    targets = corners + 0.1 * (seen.object_pose[0, index, :2] - corners)
    near = np.linalg.norm(targets - robot, axis=1) <= reach
    fractions = np.linspace(0.05, 0.95, 60)[:, None, None]
    clear = walls.at(robot + fractions * (targets - robot)) > 0.3 * float(walls.resolution)
    return bool(np.any(near & clear.all(axis=0)))


def start_of(env: Any) -> task.Start:
    return env.unwrapped.start


def part(env: Any, observation: np.ndarray, name: str) -> np.ndarray:
    first = 0
    for p in env.unwrapped.task.observation:
        if p.name == name:
            return observation[first : first + p.size]
        first += p.size
    raise KeyError(name)


@pytest.mark.parametrize("name", NAMES)
def test_gymnasiums_checker_has_nothing_to_say(name: str) -> None:
    from gymnasium.utils.env_checker import check_env

    env = gymnasium.make(f"shmoo_mjx.gym:{name}")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(env.unwrapped, skip_render_check=bool(can_render()) or not has_display())
    env.close()


def roll(env: Any, seed: int, steps: int = 6) -> list[Any]:
    first, _ = env.reset(seed=seed)
    low, high = env.action_space.low, env.action_space.high
    actions = np.random.default_rng(1).uniform(low, high, (steps, len(low)))
    return [first, *(env.step(a)[:2] for a in actions)]


@pytest.mark.parametrize("name", NAMES)
def test_a_seed_draws_everything(name: str) -> None:
    env = gymnasium.make(name)
    once, described = roll(env, 7), [c.describe() for c in start_of(env).conditions]
    again = roll(env, 7)
    np.testing.assert_array_equal(once[0], again[0])
    for (seen, reward), (other, same) in zip(once[1:], again[1:], strict=True):
        np.testing.assert_array_equal(seen, other)
        assert reward == same
    assert np.abs(roll(env, 8, 1)[0] - once[0]).max() > 0.01
    assert [c.describe() for c in start_of(env).conditions] != described
    env.close()


def table(parts: tuple[task.Part, ...]) -> str:
    rows, first = [], 0
    for part in parts:
        index = str(first) if part.size == 1 else f"{first}-{first + part.size - 1}"
        rows.append((index, part.name, part.unit, f"{part.low:g} to {part.high:g}", part.meaning))
        first += part.size
    return markdown_table(("index", "name", "unit", "range", "meaning"), rows)


def test_the_page_holds_the_codes_tables() -> None:
    page, push, rooms = PAGE.read_text(), PushEnvTask.observation, navigate.NavigateTask.observation
    head, _, *rows = table(rooms).splitlines()
    # What the rooms share with pushing, and the second object, is said in words.
    assert push[:4] == rooms[:4] and sum(part.size for part in push[:4]) == 11
    first, second = ([row.split(" | ")[2:] for row in rows if f" object{i}" in row] for i in (0, 1))
    assert first == second and "61-73 are the same as 48-60" in page
    rest = "\n".join([head, "|---|---|---|---|---|", *(row for row in rows[4:] if " object1" not in row)])
    assert all(f"\n\n{shown}\n" in page for shown in (table(task.ACTIONS), table(push), rest))


@pytest.mark.parametrize("senses", ["perfect", "real"])
def test_pushing_forward_pays_and_the_rewards_add_up(senses: str) -> None:
    config = PushEnvConfig(distance=(1.5, 1.5), near_weight=0.0, yaw_weight=0.0)
    env = gymnasium.make("ShmooPush-v0", config=config, senses=senses)
    _, info = env.reset(seed=3)
    far, total = info["distance"], 0.0
    for _ in range(60):
        observation, reward, terminated, _, info = env.step(np.array([0.06, 0.0, 0.0, 0.0]))
        total += reward
        assert not terminated
    assert info["distance"] < far - 0.2
    assert total == pytest.approx(far - info["distance"], abs=1e-6)
    assert part(env, observation, "wrench")[0] > 5.0
    env.close()


def test_an_object_at_rest_at_its_goal_is_success() -> None:
    env = gymnasium.make("ShmooPush-v0", config=PushEnvConfig(distance=(0.0, 0.0), bearing=0.0, gap=(0.5, 0.5)))
    _, info = env.reset(seed=0)
    assert info["success"]
    _, reward, terminated, _, info = env.step(np.zeros(4))
    assert terminated and info["success"] and reward == pytest.approx(1.0, abs=0.05)
    env.close()


def test_a_fall_ends_the_episode_and_costs(monkeypatch: pytest.MonkeyPatch) -> None:
    env = gymnasium.make("ShmooPush-v0")
    env.reset(seed=0)
    monkeypatch.setattr(MujocoEngine, "fallen", lambda self, world: np.array([True]))
    _, reward, terminated, _, info = env.step(np.zeros(4))
    assert terminated and info["fallen"] and not info["success"] and reward < -0.9
    env.close()


def test_a_bad_action_is_refused_and_a_large_one_is_cut() -> None:
    env = gymnasium.make("ShmooPush-v0", disable_env_checker=True)
    env.reset(seed=0)
    with pytest.raises(ShmooError, match="finite"):
        env.step(np.array([np.nan, 0, 0, 0]))
    with pytest.raises(ShmooError, match=r"\(4,\)"):
        env.step(np.zeros(3))
    large = env.step(np.full(4, 100.0))[0]
    env.reset(seed=0)
    np.testing.assert_array_equal(large, env.step(env.action_space.high)[0])
    with pytest.raises(ShmooError, match="box, cart, wheelchair"):
        gymnasium.make("ShmooPush-v0", config=PushEnvConfig(family="sofa"))
    env.close()


def moved(seen: Observation, frame: np.ndarray) -> Observation:
    """The same scene elsewhere."""
    turn = frame[2]
    return seen._replace(
        robot_pose=se2.compose(frame, seen.robot_pose),
        robot_twist=se2.rotate(seen.robot_twist, turn),
        object_pose=se2.compose(frame, seen.object_pose),
        object_twist=se2.rotate(seen.object_twist, turn),
        wrench=se2.rotate(seen.wrench, turn),
    )


def test_where_the_scene_lies_makes_no_difference() -> None:
    env = gymnasium.make("ShmooPush-v0")
    roll(env, 2, 8)
    now, frame = env.unwrapped._now, np.array([3.0, -2.0, 2.1])
    there = now.context._replace(goal=se2.compose(frame, now.context.goal))
    here = env.unwrapped.task.observe(now.context, now.observed)
    np.testing.assert_allclose(env.unwrapped.task.observe(there, moved(now.observed, frame)), here, atol=1e-5)
    env.close()


def test_rays_meet_rectangles_where_geometry_says() -> None:
    rng = np.random.default_rng(0)
    poses = np.concatenate([rng.uniform(-3, 3, (20, 3, 2)), rng.uniform(-3, 3, (20, 3, 1))], axis=-1)
    half, origins = rng.uniform(0.1, 1.0, (20, 3, 2)), rng.uniform(-3, 3, (20, 2))
    angles = rng.uniform(-np.pi, np.pi, (20, 5))
    directions = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    found = navigate.cast(origins, directions, poses, half, reach=3.5)
    for w in range(20):
        blocks = shapely.union_all([footprint_polygon(p, h) for p, h in zip(poses[w], half[w], strict=True)])
        for r in range(5):
            ray = shapely.LineString([origins[w], origins[w] + 3.5 * directions[w, r]]).intersection(blocks)
            expected = 3.5 if ray.is_empty else ray.distance(shapely.Point(origins[w]))
            assert found[w, r] == pytest.approx(expected, abs=1e-6)
    assert 0.2 < np.mean(found < 3.5) < 0.95


def demo_of(seed: int) -> tuple[OccupancyGrid, Scenario]:
    """What the environment draws from this seed."""
    return demo_scenario(int(gymnasium.utils.seeding.np_random(seed)[0].integers(2**31)))


def test_what_is_behind_a_wall_is_not_seen() -> None:
    env = gymnasium.make("ShmooNavigate-v0", senses="perfect")
    counts, differ = np.zeros((2, 2), dtype=int), 0
    for seed in range(12):
        observation, _ = env.reset(seed=seed)
        walls = distance_field(demo_of(seed)[0])
        for i, condition in enumerate(start_of(env).conditions):
            shown = bool(part(env, observation, f"object{i}_seen")[0])
            counts[i, int(shown)] += 1
            now = env.unwrapped._now
            true = now.engine.true_observation(now.world)
            differ += shown != in_line_of_sight(true, i, condition.half_extents, walls, reach=3.5)
            assert part(env, observation, f"object{i}").any() == shown
    # The senses look along other lines: a corner that just shows may be seen by one alone.
    assert differ <= 1
    assert counts[0, 1] > 6 and counts[1, 0] > 6
    env.close()


def test_real_senses_look_ahead_and_each_episode_has_a_robot_of_its_own() -> None:
    env = gymnasium.make("ShmooNavigate-v0")
    masses = set()
    for seed in range(3):
        observation, _ = env.reset(seed=seed)
        now = env.unwrapped._now
        masses.add(float(now.engine.scenes[0].model.body("robot/torso").mass[0]))
        for i in range(2):
            place = part(env, observation, f"object{i}")[:2]
            assert not place.any() or abs(np.arctan2(place[1], place[0])) < np.deg2rad(60)
    assert len(masses) == 3
    with pytest.raises(ShmooError, match="real or perfect"):
        gymnasium.make("ShmooNavigate-v0", senses="keen")
    env.close()


def test_the_way_is_that_of_the_global_path() -> None:
    env = gymnasium.make("ShmooNavigate-v0", senses="perfect")
    observation, _ = env.reset(seed=4)
    grid, scenario = demo_of(4)
    assert tuple(start_of(env).goal) == scenario.goal
    path = plan_path(
        grid, scenario.start[:2], scenario.goal, robot_radius=ROBOT_RADIUS, cfg=PathConfig(soft_weight=0.0)
    )
    assert path is not None
    length, *direction = part(env, observation, "way")
    assert path.length - 0.05 <= length <= 1.1 * path.length
    ahead = se2.rotate(path.points[1] - path.points[0], -np.asarray(scenario.start[2]))
    assert np.dot(direction, ahead / np.linalg.norm(ahead)) > 0.9
    env.close()


def test_driving_into_a_wall_is_felt_and_costs() -> None:
    env = gymnasium.make("ShmooNavigate-v0")
    observation, _ = env.reset(seed=1)
    before = part(env, observation, "way")[0]
    for _ in range(80):
        # Away from the goal: the start looks at the first doorway, with a wall behind.
        observation, _, terminated, _, info = env.step(np.array([-0.08, 0.0, 0.0, 0.0, 0.0]))
        if info["wall_contact"] or terminated:
            break
    assert info["wall_contact"]
    after = part(env, observation, "way")[0]
    assert after > before
    last = part(env, env.step(np.zeros(5))[0], "ranges")
    # An elbow touches before the body does.
    assert last.min() < 0.3
    env.close()


def test_without_gymnasium_one_sentence_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "gymnasium", None)
    with pytest.raises(ShmooError, match=r"pip install '\.\[gym\]'"):
        importlib.reload(shmoo_mjx.gym)


def test_a_machine_that_cannot_draw_says_so_in_one_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(single, "can_render", lambda: "no display")
    with pytest.raises(ShmooError, match=r"can't draw here \(no display\); set MUJOCO_GL=egl before"):
        gymnasium.make("ShmooPush-v0", render_mode="rgb_array")


def test_human_shows_every_step_in_a_window_or_says_in_one_sentence_that_none_can_be_opened(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(single, "has_display", lambda: False)
    with pytest.raises(ShmooError, match="no window can be opened here"):
        gymnasium.make("ShmooPush-v0", render_mode="human")
    shown: list[np.ndarray] = []

    class Window:
        def __init__(self, model: Any, data: Any, **settings: Any) -> None:
            self.data = data

        def is_running(self) -> bool:
            return True

        def sync(self) -> None:
            shown.append(self.data.qpos.copy())

        def close(self) -> None:
            shown.append(np.zeros(0))

    monkeypatch.setattr(single, "has_display", lambda: True)
    monkeypatch.setattr("mujoco.viewer.launch_passive", Window)
    env = gymnasium.make("ShmooPush-v0", render_mode="human")
    env.reset(seed=0)
    for _ in range(2):
        env.step(np.array([0.1, 0.0, 0.0, 0.0], dtype=np.float32))
    env.close()
    assert [len(q) > 0 for q in shown] == [True, True, True, False] and not np.array_equal(shown[0], shown[2])


def test_a_world_that_diverges_ends_its_episode_with_a_reason_and_no_nan() -> None:
    env = gymnasium.make("ShmooPush-v0")
    env.reset(seed=0)
    _, _, terminated, _, info = env.step(np.zeros(4))
    assert not terminated and info["reason"] == ""
    now = env.unwrapped._now
    physics = now.world.truth.physics.copy()
    physics[0, 3] = np.nan
    env.unwrapped._now = now._replace(world=now.world._replace(truth=now.world.truth._replace(physics=physics)))
    seen, reward, terminated, truncated, last = env.step(np.zeros(4))
    assert terminated and not truncated and reward == env.unwrapped.task.fall
    assert last["reason"] == "diverged" and not last["fallen"] and last["distance"] == info["distance"]
    assert seen in env.observation_space
    assert env.reset(seed=0)[1]["reason"] == ""
    env.close()


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))])
@pytest.mark.parametrize("name", NAMES)
def test_a_copy_goes_on_where_the_original_stands(name: str, copied: Callable[[Any], Any]) -> None:
    env = gymnasium.make(name)
    copied(env).close()
    roll(env, 3, 3)
    other = copied(env)
    actions = [env.action_space.sample() for _ in range(3)]
    mine = [env.step(a)[:2] for a in actions]
    for (seen, reward), action in zip(mine, actions, strict=True):
        again, same, *_ = other.step(action)
        np.testing.assert_array_equal(again, seen)
        assert same == reward
    np.testing.assert_array_equal(env.reset()[0], other.reset()[0])
    env.close()
    other.close()


def test_an_object_file_is_a_family(tmp_path: Path) -> None:
    trimesh.creation.cylinder(radius=0.25, height=0.6).export(tmp_path / "stool.stl")
    made = add_object(tmp_path / "stool.stl", mass=5.0, friction=0.35, out=tmp_path / "stool.json")
    for family in (str(made), made):
        env = gymnasium.make("ShmooPush-v0", config=PushEnvConfig(family=family))
        env.reset(seed=1)
        assert start_of(env).conditions[0].mass == 5.0
        assert env.step(np.zeros(4, dtype=np.float32))[0] in env.observation_space
        env.close()


def test_ranges_are_as_long_as_they_are_asked_for() -> None:
    for reach, most in ((1.0, 1.0), (3.5, 3.5), (10.0, 4.0)):
        env = gymnasium.make("ShmooNavigate-v0", config=NavigateConfig(reach=reach), senses="perfect")
        seen, _ = env.reset(seed=0)
        assert seen in env.observation_space
        assert most <= part(env, seen, "ranges").max() <= reach
        env.close()
    env = gymnasium.make("ShmooPush-v0", config=PushEnvConfig(distance=(15.0, 15.0)), senses="perfect")
    seen, info = env.reset(seed=0)
    goal, thing = part(env, seen, "goal")[:2], part(env, seen, "object")[:2]
    assert np.linalg.norm(goal - thing) == pytest.approx(15.0, abs=1e-3) == info["distance"]
    env.close()


@pytest.mark.parametrize("make", [gymnasium.make, gymnasium.make_vec])
@pytest.mark.parametrize(
    "name, config, words",
    [
        ("ShmooPush-v0", NavigateConfig(), ("PushEnvConfig", "NavigateConfig")),
        ("ShmooNavigate-v0", PushEnvConfig(), ("NavigateConfig", "PushEnvConfig")),
        ("ShmooPush-v0", {"family": "cart"}, ("PushEnvConfig", "cart")),
        ("ShmooPush-v0", PushEnvConfig, ("PushEnvConfig",)),
        ("ShmooPush-v0", PushEnvConfig(family="gone.json"), ("gone.json",)),
        ("ShmooPush-v0", PushEnvConfig(family=None), ("None", "box, cart, wheelchair")),
        ("ShmooPush-v0", PushEnvConfig(distance=(1.6, 0.6)), ("distance", "smaller one first")),
        ("ShmooPush-v0", PushEnvConfig(distance=1.0), ("distance", "two finite numbers")),
        ("ShmooPush-v0", PushEnvConfig(arrived=float("nan")), ("arrived", "finite")),
        ("ShmooNavigate-v0", NavigateConfig(reach=-1.0), ("reach", "not below 0")),
        ("ShmooNavigate-v0", NavigateConfig(bonus="much"), ("bonus", "finite")),
    ],
)
def test_a_wrong_config_is_refused_in_a_sentence(make: Any, name: str, config: Any, words: tuple[str, ...]) -> None:
    with pytest.raises(ShmooError) as refused:
        make(name, config=config)
    assert all(word in str(refused.value) for word in words)


@pytest.mark.parametrize("make", [gymnasium.make, lambda name: gymnasium.make_vec(name, num_envs=2)])
def test_options_and_seeds_that_no_environment_knows_are_refused(make: Any) -> None:
    env = make("ShmooPush-v0")
    with pytest.raises(ShmooError, match="'goal'"):
        env.reset(seed=0, options={"goal": (1.0, 0.0, 0.0)})
    for seed in (1.5, "three", [1, 2]):
        with pytest.raises(ShmooError, match="whole number"):
            env.reset(seed=seed)
    env.close()


def test_numpy_integers_are_seeds() -> None:
    env = gymnasium.make("ShmooPush-v0")
    first, _ = env.reset(seed=3, options={})
    for kind in (np.int64, np.uint8):
        np.testing.assert_array_equal(env.reset(seed=kind(3))[0], first)
    env.close()
    assert draw_condition("box", np.int64(3)) == draw_condition("box", 3)
    assert draw_condition("box", np.int64(3)).fingerprint() == draw_condition("box", 3).fingerprint()


def test_worlds_of_a_batch_are_not_drawn() -> None:
    gymnasium.make_vec("ShmooPush-v0", num_envs=2, render_mode=None).close()
    with pytest.raises(ShmooError, match="vectorization_mode='sync'"):
        gymnasium.make_vec("ShmooPush-v0", num_envs=2, render_mode="rgb_array")
