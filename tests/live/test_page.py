"""The live page: what is asked for on it happens between samples; and in a real browser, where there is one."""

from __future__ import annotations

import asyncio
import importlib
import json
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
import warnings
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from subprocess import CompletedProcess
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import trimesh

pytest.importorskip("viser")
pytest.importorskip("mjviser")

from viser._messages import SetCameraPositionMessage
from viser.infra._async_message_buffer import AsyncMessageBuffer

from shmoo_mjx.base.assets import asset
from shmoo_mjx.behavior.state import Decision, Option
from shmoo_mjx.learning.weights import load_weights
from shmoo_mjx.live import cameras, overlay
from shmoo_mjx.live.cameras import FOLLOW, Cameras
from shmoo_mjx.live.command import go_on
from shmoo_mjx.live.page import Page
from shmoo_mjx.live.pictures import RATE
from shmoo_mjx.live.scenes import scene_named
from shmoo_mjx.live.session import Session
from shmoo_mjx.live.words import beliefs, state_text
from shmoo_mjx.plant.mesh import add_object
from shmoo_mjx.sensing import REAL


def free_port() -> int:
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return int(one.getsockname()[1])


@pytest.fixture
def page(tmp_path: Path) -> Iterator[Page]:
    session = Session(load_weights(), lambda: scene_named("box_in_doorway", tmp_path), "perfect", tmp_path)
    made = Page(session, port=free_port())
    yield made
    made.close()
    session.close()


class Gone:
    """A browser whose connection has closed since it was listed, as viser sees it."""

    def __init__(self) -> None:
        self.camera, self.moved = self, False
        self.look_at, self.aspect, self._position = np.zeros(3), 1.5, np.ones(3)
        loop: Any = SimpleNamespace(call_soon_threadsafe=lambda call: None)
        self._messages = AsyncMessageBuffer(loop, persistent_messages=False, done=True)

    @property
    def position(self) -> np.ndarray:
        return self._position

    @position.setter
    def position(self, value: np.ndarray) -> None:
        self._messages.push(SetCameraPositionMessage((float(value[0]), float(value[1]), float(value[2]))))
        self._position, self.moved = value, True


def said(page: Page) -> str:
    return str(page.panel.message.content)


def test_it_listens_at_home_only_goes_on_and_sends_pictures(page: Page) -> None:
    assert page.url.startswith("http://127.0.0.1:")
    page.speed = 0.0
    before, began = page.pictures.count, time.perf_counter()
    go_on(page, 3.0)
    spent = time.perf_counter() - began
    assert page.session.simulation.time > 0.3
    assert page.pictures.count - before > 0.5 * RATE * spent
    assert page.panel.state.content.startswith("### The robot ")


def test_what_is_asked_for_happens_and_what_can_t_be_is_refused_with_a_sentence(page: Page) -> None:
    count = len(page.session.scenario.objects)
    x, y, yaw = page.session.simulation.true.robot_pose[0]
    place = (float(x + 1.2 * np.cos(yaw)), float(y + 1.2 * np.sin(yaw)))
    page.ask(page.new_object(*place))
    page.carry_out()
    page.show()
    assert len(page.session.scenario.objects) == count + 1 and said(page).startswith("*box 1: box")
    assert page.panel.which.options == ("box 0", "box 1")
    for wanted in (
        page.new_object(*place),
        page.new_object(float("nan"), 0.0),
        lambda: page.actions.alter("none", "set load", 3.0),
        lambda: page.actions.alter("box 1", "set load", -3.0),
        lambda: page.actions.alter("box 1", "set brakes", True),
        lambda: page.actions.alter("box 7", "set load", 3.0),
        lambda: page.actions.head_for(1e9, 0.0),
        lambda: page.actions.save("../../etc/passwd"),
        lambda: page.actions.load("gone"),
    ):
        page.panel.message.content = ""
        page.ask(wanted)
        page.carry_out()
        assert said(page).startswith("**Not possible.**") and len(page.session.scenario.objects) == count + 1
    page.ask(page.actions.reset)
    page.carry_out()
    page.show()
    assert len(page.session.scenario.objects) == count


def test_paused_it_stands_still_but_for_single_samples(page: Page) -> None:
    page.paused = True
    go_on(page, 0.3)
    assert page.session.simulation.time == 0.0
    page.ask(page.one_sample)
    go_on(page, 0.5)
    assert page.session.simulation.time == pytest.approx(0.1)


def test_looking_back_pauses_and_shows_the_world_as_it_was(page: Page) -> None:
    for _ in range(12):
        page.session.step()
    page.show()
    page.panel.back.value = 0.5
    assert not page.carry_out() and page.paused
    history = page.session.simulation.history
    shown = page.pictures._samples
    assert shown is not None
    np.testing.assert_array_equal(shown[1], history.qpos[-5])
    assert f"Looking back to {history.rows[-5].t:.1f} s" in page.panel.state.content
    page.paused = False
    assert page.carry_out() and page.panel.back.value == 0.0
    page.show()
    shown = page.pictures._samples
    assert shown is not None
    np.testing.assert_array_equal(shown[1], page.session.simulation.qpos)


def test_an_object_is_shoved_in_the_chosen_direction(page: Page) -> None:
    page.ask(partial(page.actions.shove, "box 0", "away", 8.0))
    page.ask(partial(page.actions.shove, "none", "away", 8.0))
    page.carry_out()
    assert said(page).startswith("**Not possible.**")
    assert np.linalg.norm(page.session.simulation.true.object_twist[0, 0, :2]) > 0.1


def test_the_options_of_a_decision_are_shown_with_their_times(page: Page) -> None:
    navigator = page.session.simulation.navigator
    options = (Option("push from behind", 23.0, 31.0, 0.84), Option("go round", 47.0, 47.0, 1.0))
    none = np.zeros((0, 2))
    decision = Decision(0.0, 0, np.nan, np.nan, True, None, "", none, none, 0.84, options)
    navigator.events.append(decision)
    text = state_text(page.session)
    assert "| **push from behind** | 84% | 31 s |" in text and "| go round | 100% | 47 s |" in text
    navigator.events.append(decision._replace(options=options[:1]))
    text = state_text(page.session)
    assert "| **push from behind** | 84% | 23 s |" in text and "no way round" in text
    page.session.simulation.advance(page.session.simulation.decide())
    x, y, yaw = page.session.simulation.true.robot_pose[0]
    page.session.head_for(float(x + 0.8 * np.cos(yaw)), float(y + 0.8 * np.sin(yaw)))
    assert "|" not in state_text(page.session)  # the decision was about the way to another goal


@pytest.mark.slow
def test_the_robot_goes_on_while_new_settings_of_mppi_are_compiled(page: Page) -> None:
    page.panel.control["num_rollouts"].value, page.panel.control["horizon"].value = 100, 12
    before, began = page.session.controller, page.session.simulation.time
    seen, until = False, time.monotonic() + 120.0
    while page.session.controller is before and time.monotonic() < until:
        if page.carry_out():
            page.session.step()
            page.show()
        seen |= "Compiling" in page.panel.compiling.content and page.session.simulation.time > began + 0.2
    control = page.session.controller.config.control
    assert seen and (control.num_rollouts, control.horizon) == (100, 12)
    assert page.session.simulation.navigator.setup.controller is page.session.controller
    page.show()
    assert "100 roll-outs of 12 samples" in page.panel.compiling.content and not page.panel.tuning.pending
    assert not page.session.simulation.history.falls


def test_a_click_on_the_floor_is_told_in_the_box_of_the_goal(page: Page) -> None:
    page.paused = True
    go_on(page, 0.1)
    assert page.panel.goal.value == pytest.approx(page.session.scenario.goal)
    x, y, yaw = page.session.simulation.true.robot_pose[0]
    goal = (float(x + 0.8 * np.cos(yaw)), float(y + 0.8 * np.sin(yaw)))
    click = SimpleNamespace(ray_origin=(goal[0], goal[1] - 2.0, 2.0), ray_direction=(0.0, 2.0, -2.0))
    page.clicked(click)  # type: ignore[arg-type]
    go_on(page, 0.1)
    assert page.panel.goal.value == pytest.approx(goal, abs=0.006)
    assert said(page).startswith("*The goal is")
    before = page.panel.goal.value
    page.clicked(SimpleNamespace(ray_origin=(1e3, 0.0, 1.0), ray_direction=(0.0, 0.0, -1.0)))  # type: ignore[arg-type]
    go_on(page, 0.1)
    assert said(page).startswith("**Not possible.**") and page.panel.goal.value == before
    page.ask(page.actions.reset)
    go_on(page, 0.1)
    assert page.panel.goal.value == pytest.approx(page.session.scenario.goal) and page.panel.goal.value != before
    page.panel.click.value = "adds an object"
    place = (round(float(x), 2), round(float(y), 2) + 1.0)
    page.clicked(SimpleNamespace(ray_origin=(*place, 1.0), ray_direction=(0.0, 0.0, -1.0)))  # type: ignore[arg-type]
    go_on(page, 0.1)
    assert page.panel.where.value[:2] == pytest.approx(place, abs=0.006)
    assert page.panel.which.options == ("box 0", "box 1")  # drawn at once, though time stands still


def test_the_list_of_objects_shows_what_they_are(page: Page) -> None:
    x, y, yaw = page.session.simulation.true.robot_pose[0]
    place = (float(x + 1.2 * np.cos(yaw)), float(y + 1.2 * np.sin(yaw)), 0.0)
    page.session.add("wheelchair", place, {"mass": 12.0, "payload": 120.0, "friction": 0.75, "locked": [True] * 4})
    page.show()
    heavier, slippery, brakes = page.panel.present
    own = page.session.simulation.conditions[0]
    assert (heavier.value, slippery.value, brakes.value) == (own.payload, own.friction, False)
    assert page.panel.which.options == ("box 0", "wheelchair 1")
    page.panel.which.value = "wheelchair 1"
    page.carry_out()
    assert (heavier.value, slippery.value, brakes.value) == (120.0, 0.75, True) and heavier.max >= 120.0
    page.ask(lambda: page.actions.alter("wheelchair 1", "set load", 7.0))
    page.carry_out()
    page.show()
    assert (heavier.value, page.panel.which.value) == (7.0, "wheelchair 1")


def test_handles_go_with_their_objects_but_not_out_of_a_hand(page: Page) -> None:
    page.panel.drag.value = True
    page.carry_out()
    x, y, yaw = page.session.simulation.true.robot_pose[0]
    pose = (float(x + 1.2 * np.cos(yaw)), float(y + 1.2 * np.sin(yaw)), 0.4)

    def stands() -> bool:
        (handle,), true = page.pictures.handles, page.session.simulation.true.object_pose[0, 0]
        return bool(np.allclose(handle.position[:2], true[:2]) and np.isclose(2 * np.arcsin(handle.wxyz[3]), true[2]))

    page.session.place(0, pose)
    page.show()
    assert stands() and np.allclose(page.pictures.handles[0].position[:2], pose[:2])
    (handle,) = page.pictures.handles
    asyncio.run(page.pictures.dragging(0, SimpleNamespace(phase="start", target=handle)))  # type: ignore[arg-type]
    handle.position = (pose[0] + 0.2, pose[1], 0.05)
    page.show()
    assert not stands()
    asyncio.run(page.pictures.dragging(0, SimpleNamespace(phase="end", target=handle)))  # type: ignore[arg-type]
    page.carry_out()
    page.show()
    assert stands() and page.session.simulation.true.object_pose[0, 0, 0] == pytest.approx(pose[0] + 0.2)


@pytest.mark.parametrize("scene", ["demo 3", "demo 33", "box_in_doorway", "a file"])
def test_the_box_of_scenes_says_what_was_loaded(tmp_path: Path, scene: str) -> None:
    if scene == "a file":
        scene = str(asset("experiments/scenarios/three_objects.yaml"))
    session = Session(load_weights(), lambda: scene_named(scene, tmp_path), "perfect", tmp_path)
    page = Page(session, port=free_port(), scene=scene)
    assert page.panel.scene.value == scene
    count, start = len(session.scenario.objects), session.scenario.start
    page.panel.look_for_files()
    page.actions.load("office" if "office" in page.panel.scene.options else "demo 1")
    page.actions.load(scene)
    assert (len(session.scenario.objects), session.scenario.start) == (count, start)
    page.close()
    session.close()


def test_a_line_is_drawn_in_the_colour_of_its_legend() -> None:
    """Lines are sent as linear light, which the browser encodes as sRGB; the legend is sRGB."""
    names = dict(re.findall(r"color: (#\w{6}).*?</span> ([^&]*) &ensp;", overlay.legend(None)))
    drawn = {
        "global path": overlay.path(np.eye(2)),
        "local trajectory": overlay.path(np.eye(2), local=True),
        "camera's field of view": overlay.field_of_view(REAL.camera, np.zeros(3)),
    }
    for colour, name in names.items():
        if name in drawn:
            light = drawn[name].colours[0, 0] / 255
            shown = np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)
            wanted = [int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5)]
            np.testing.assert_allclose(shown, wanted, atol=0.03)
    assert set(drawn) <= set(names.values())


DAMAGED: dict[str, Callable[[dict[str, Any]], Any]] = {
    "no friction": lambda data: {k: v for k, v in data.items() if k != "friction"},
    "no centre of mass": lambda data: {k: v for k, v in data.items() if k != "com"},
    "a mass of text": lambda data: data | {"mass": "5"},
    "a hull of nothing": lambda data: data | {"hull": []},
    "a hull of text": lambda data: data | {"hull": "round"},
    "two numbers for a size": lambda data: data | {"size": data["size"][:2]},
    "no feet": lambda data: data | {"feet": None},
    "not a mapping": lambda data: ["hull", data],
}


@pytest.mark.parametrize("damage", DAMAGED)
def test_a_damaged_object_file_is_refused_and_the_run_goes_on(page: Page, tmp_path: Path, damage: str) -> None:
    trimesh.creation.cylinder(radius=0.25, height=0.6).export(tmp_path / "stool.stl")
    made = add_object(tmp_path / "stool.stl", mass=5.0, friction=0.35, out=tmp_path / "stool.json")
    made.write_text(json.dumps(DAMAGED[damage](json.loads(made.read_text()))))
    page.panel.look_for_files()
    page.panel.family.value = "stool"
    x, y, _ = page.session.simulation.true.robot_pose[0]
    page.panel.message.content = ""
    page.ask(page.new_object(float(x), float(y - 1.0)))
    page.carry_out()
    assert said(page).startswith("**Not possible.**")
    before = page.session.simulation.time
    page.session.step()
    page.show()
    assert page.session.simulation.time > before and len(page.session.scenario.objects) == 1


def test_what_cannot_be_read_is_no_scene_and_no_object(page: Page, tmp_path: Path) -> None:
    for name in ("folder.json", "folder.yaml"):
        (tmp_path / name).mkdir()
    for name in ("link.json", "link.yaml"):
        (tmp_path / name).symlink_to(tmp_path / "nowhere")
    page.panel.look_for_files()
    assert not {"folder", "link"} & {*page.panel.scene.options, *page.panel.family.options}
    page.ask(lambda: 1 / 0)  # type: ignore[arg-type, return-value]
    page.carry_out()
    assert said(page).startswith("**Not possible.**") and "ZeroDivisionError" in said(page)


def test_what_it_can_t_show_is_said_in_one_sentence(
    shmoo: Callable[..., CompletedProcess[str]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for scene, more in (
        ("nonsense", ()),
        ("gone.yaml", ()),
        ("demo 0", ("--port", "0")),
        ("demo -1", ()),
        ("demo 0", ("--host", "192.0.2.1")),
        ("demo 0", ("--set", "control.rollouts=3")),
    ):
        done = shmoo("live", scene, *more)
        assert done.returncode == 2 and done.stderr.startswith("shmoo: ") and len(done.stderr.splitlines()) == 1


def test_the_clearance_is_drawn_when_asked_for_and_objects_of_ones_own_are_offered(page: Page, tmp_path: Path) -> None:
    drawn = page.server.scene.get_handle_by_name
    page.show()
    assert drawn("/clearance") is None
    page.panel.shown["clearance"].value = True
    page.show()
    picture = drawn("/clearance")
    assert picture is not None and picture.image.shape == (*page.session.simulation.grid.cells.shape, 3)
    shades = picture.image.astype(int).sum(axis=-1)
    assert shades[page.session.simulation.grid.occupied].max() < shades.max() - 200  # walls are dark
    page.actions.load("three_objects")
    page.show()
    assert drawn("/clearance") is not None
    page.panel.shown["clearance"].value = False
    page.show()
    assert drawn("/clearance") is None
    trimesh.creation.cylinder(radius=0.25, height=0.6).export(tmp_path / "stool.stl")
    add_object(tmp_path / "stool.stl", mass=5.0, friction=0.35, out=tmp_path / "stool.json")
    page.panel.look_for_files()
    page.panel.family.value = "stool"
    x, y, _ = page.session.simulation.true.robot_pose[0]
    page.ask(page.new_object(float(x), float(y - 1.0)))
    page.carry_out()
    page.show()
    assert said(page).startswith("*stool 3: stool 0.50 x 0.50 x 0.60 m, 5.0 kg, mu 0.35")
    assert "stool 3" in beliefs(page.session) and "roll-outs of MPPI, by cost" in page.panel.legend.content


def browser() -> Any:
    webdriver = pytest.importorskip("selenium.webdriver")
    found = next((p for name in ("chromium", "chromium-browser", "google-chrome") if (p := shutil.which(name))), None)
    driver = shutil.which("chromedriver")
    if found is None or driver is None:
        pytest.skip("no Chromium with its chromedriver is installed")
    options = webdriver.ChromeOptions()
    options.binary_location = found
    for argument in (
        "--headless=new", "--no-sandbox", "--window-size=1000,700", "--disable-dev-shm-usage",
        "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist",
    ):  # fmt: skip
        options.add_argument(argument)
    return webdriver.Chrome(options=options, service=webdriver.ChromeService(driver))


def wait_for(done: Any, seconds: float) -> Any:
    until = time.monotonic() + seconds
    while time.monotonic() < until:
        if result := done():
            return result
        time.sleep(0.2)
    raise AssertionError(f"not within {seconds} s")


@pytest.mark.slow
def test_in_a_browser_goal_and_object_are_set_and_the_robot_arrives(tmp_path: Path) -> None:
    from selenium.webdriver.common.by import By
    from selenium.webdriver.common.keys import Keys

    session = Session(load_weights(), lambda: scene_named("box_in_doorway", tmp_path), "real", tmp_path)
    page = Page(session, port=free_port())
    page.speed, page.paused = 0.0, True
    runner = threading.Thread(target=go_on, args=(page, 240.0), daemon=True)
    runner.start()
    chrome = browser()

    def press(text: str) -> None:
        button = wait_for(lambda: chrome.find_elements(By.XPATH, f"//button[contains(., '{text}')]"), 60)[0]
        chrome.execute_script("arguments[0].click()", button)

    def open_up(title: str) -> None:
        """A tab or a folder."""
        heading = f"//*[@role='tab'][@title='{title}'] | //*[text()='{title}']"
        wait_for(lambda: chrome.find_elements(By.XPATH, heading), 60)[0].click()

    def enter(label: str, *values: float) -> None:
        row = f"//label[contains(., '{label}')]/ancestor::*[.//input][1]"
        inputs = f"{row}//input[not(@type='hidden')]"

        def shown() -> list[Any]:
            return [field for field in chrome.find_elements(By.XPATH, inputs) if field.is_displayed()]

        wait_for(lambda: len(shown()) >= len(values), 20)
        fields = shown()
        for field, value in zip(fields[-len(values) :], values, strict=True):
            field.send_keys(Keys.CONTROL, "a")
            field.send_keys(str(value), Keys.ENTER)
        handle = page.panel.goal if "goal" in label else page.panel.where
        wait_for(lambda: np.allclose(handle.value, values), 20)

    try:
        chrome.get(page.url)
        wait_for(lambda: "shmoo live" in chrome.find_element(By.TAG_NAME, "body").text, 60)
        x, y, yaw = session.simulation.true.robot_pose[0]
        side, goal = (float(x), float(y + 1.0)), (float(x + 0.8 * np.cos(yaw)), float(y + 0.8 * np.sin(yaw)))
        open_up("World")
        open_up("Add an object")
        enter("x, y [m], heading", *(round(v, 2) for v in side), 0)
        press("put it there")
        wait_for(lambda: len(session.scenario.objects) == 2, 60)
        enter("goal x, y", *(round(v, 2) for v in goal))
        press("go there")
        assert np.linalg.norm(np.array(session.scenario.objects[1].pose[:2]) - side) < 0.01
        wait_for(lambda: np.allclose(session.scenario.goal, goal, atol=0.01), 20)
        page.panel.view.value = FOLLOW
        open_up("Run")
        chrome.find_element(By.XPATH, "//label[contains(., 'paused')]/ancestor::*[.//input][1]//input").click()
        wait_for(lambda: not page.paused, 20)
        wait_for(lambda: str(session.simulation.navigator.mode) == "done", 120)
        assert np.linalg.norm(session.simulation.true.robot_pose[0, :2] - goal) < 0.25
        wait_for(lambda: re.search(r"The robot is at the goal", chrome.find_element(By.TAG_NAME, "body").text), 20)
        (client,) = page.server.get_clients().values()
        assert np.linalg.norm(client.camera.look_at[:2] - session.simulation.true.robot_pose[0, :2]) < 0.1
        picture = tmp_path / "page.png"
        chrome.save_screenshot(str(picture))
        assert picture.stat().st_size > 20_000
        chrome.quit()
        time_then = session.simulation.time
        wait_for(lambda: session.simulation.time > time_then, 30)
    finally:
        chrome.quit()
        page.pictures.close()  # ends go_on, which must not show anything on a stopped server
        runner.join(timeout=30.0)
        page.close()
        session.close()


@pytest.mark.parametrize("filters", ["of the tests", "of the module"])
def test_a_browser_that_goes_while_its_camera_is_moved_is_no_error(filters: str) -> None:
    gone = Gone()
    page_cameras = Cameras(SimpleNamespace(get_clients=lambda: {7: gone}))  # type: ignore[arg-type]
    with warnings.catch_warnings():
        if filters == "of the module":
            warnings.simplefilter("error")
            importlib.reload(cameras)
        page_cameras.move(FOLLOW, SimpleNamespace(body=lambda name: SimpleNamespace(xpos=np.zeros(3))))  # type: ignore[arg-type]
    assert gone.moved


@pytest.mark.slow
def test_the_command_runs_and_ends_by_ctrl_c(tmp_path: Path) -> None:
    # What a shell runs in the background ignores Ctrl-C, and so do its children.
    code = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)\n"
    code, port = code + "from shmoo_mjx.cli import main; main()", free_port()
    command = [sys.executable, "-c", code, "live", "demo 1", "--port", str(port), "--out", str(tmp_path)]
    running = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert running.stdout is not None
    assert f"http://127.0.0.1:{port}" in running.stdout.readline()
    time.sleep(3.0)
    os.kill(running.pid, signal.SIGINT)
    _, errors = running.communicate(timeout=20)
    assert running.returncode == 0 and not errors
