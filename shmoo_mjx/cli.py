"""The command line. Each command calls one function of the package, and imports heavy modules only when it runs."""

from __future__ import annotations

import errno
import os
import re
import sys
from collections.abc import Callable
from difflib import get_close_matches
from pathlib import Path
from typing import Literal

import tyro
from tyro.conf import Positional

import shmoo_mjx
from shmoo_mjx.base import options as bounded
from shmoo_mjx.base.assets import benchmark_suite
from shmoo_mjx.base.environment import check_environment, prepare_environment
from shmoo_mjx.base.inputs import with_inputs_kept
from shmoo_mjx.base.seeds import UNSEEN_SEED, ConditionSeed, Seed, Seeds, check_seed
from shmoo_mjx.base.verbosity import with_verbosity
from shmoo_mjx.errors import ShmooError


def demo(
    *,
    seed: Seeds = range(1),
    out: Path = Path("runs"),
    weights: Path | None = None,
    video: bool = True,
    quick: bool = False,
    senses: bounded.Senses = "real",
    scene: Literal["generated", "paper"] = "generated",
    method: bounded.Method = "ours",
    set: tuple[str, ...] = (),
) -> int:
    """Run the demo: the robot pushes a box out of a doorway, then drives around a locked wheelchair.

    Example: shmoo demo --seed 3

    Args:
        seed: seed of the floor plan, the objects and their properties. A range such as 0..19 runs each seed and prints
            the success rate.
        out: folder that receives one folder per run, demo-SEED.
        weights: file with trained weights (default: those of the method).
        video: write episode.mp4 (--no-video halves the run time).
        quick: short form for checks, without video.
        senses: real (simulated camera, odometry and joint torques) or perfect (ground truth of the simulator).
        scene: generated, or paper (a box of 2.8 kg and an empty wheelchair of 11.9 kg with locked wheels).
        method: ours, frozen (no adaptation to the object) or paper (the system of the paper, docs/paper_system.md).
        set: settings of the run as NAME=VALUE, such as control.num_rollouts=128 (shmoo list settings lists them).
    """
    from shmoo_mjx.run.demo import run_demo

    return run_demo(
        seed, out, weights, video=video and not quick, senses=senses, scene=scene, method=method, settings=set
    )


def navigate(
    *,
    scenario: Path | None = None,
    map: Path | None = None,
    start: str | None = None,
    goal: str | None = None,
    out: Path = Path("runs/navigate"),
    weights: Path | None = None,
    video: bool = True,
    record: bool = False,
    senses: bounded.Senses | None = None,
    real_time: bool = False,
    policy: str | None = None,
    method: bounded.Method = "ours",
    set: tuple[str, ...] = (),
) -> int:
    """Run a scenario on any ROS map_server map.

    Example: shmoo navigate --map office.yaml --scenario blocked_door.yaml

    Args:
        scenario: scenario file (docs/scenario.md). Without one, give --map, --start and --goal.
        map: YAML file of a map_server map; replaces the map that the scenario names.
        start: start pose of the robot as x,y,yaw [m, rad], without a scenario file.
        goal: goal position of the robot as x,y [m], without a scenario file.
        out: folder for result.json, report.html and episode.mp4.
        weights: file with trained weights (default: those of the method).
        video: write episode.mp4.
        record: also write episode.rrd, a 3-D recording for the Rerun viewer (needs the package rerun-sdk).
        senses: real or perfect; replaces the scenario's own value (default: the scenario's, or else real).
        real_time: run against the wall clock. The simulated world advances by the time that computing takes, and each
            missed deadline is reported.
        policy: your own navigation policy as package.module:Name, in place of the built-in one.
        method: ours, frozen (no adaptation to the object) or paper (the system of the paper, docs/paper_system.md).
        set: settings of the run as NAME=VALUE, such as control.num_rollouts=128 (shmoo list settings lists them).
    """
    from shmoo_mjx.base import progress
    from shmoo_mjx.run import scenario_run as run

    grid, task = run.load_inputs(map, scenario, start, goal)
    name = str(scenario) if scenario else "--start/--goal"
    with progress.stages() as report:
        result = run.run_scenario(
            grid,
            task,
            out,
            weights=weights,
            video=video,
            name=name,
            progress=report,
            record=record,
            senses=senses,
            real_time=real_time,
            policy=policy,
            method=method,
            settings=set,
        )
    if real_time:
        late = result["missed_deadlines"]
        worst = f", the worst {max(d['ms'] for d in late)} ms in '{max(late, key=lambda d: d['ms'])['state']}'"
        print(f"missed deadlines: {len(late)} of {round(result['time_s'] / 0.1)}{worst if late else ''}")
    print(f"{result['outcome']}: {result['reason']}; {out / 'report.html'}")
    return 0 if result["outcome"] == "success" else 1


def push(
    family: Positional[str] = "box",
    *,
    goal: str = "1.2,0.3,0.4",
    set: tuple[str, ...] = (),
    seed: Seed = 2,
    start: str = "-1.3,0,0",
    out: Path = Path("runs/push"),
    weights: Path | None = None,
    video: bool = True,
    record: bool = False,
    senses: bounded.Senses = "real",
    method: bounded.Method = "ours",
) -> int:
    """Push one object to a goal pose on an open floor, with report and film.

    Example: shmoo push wheelchair --goal 1.5,0,0.3 --set mass=20

    Args:
        family: box, cart, wheelchair, or an object file made by shmoo object add. The object starts at 0,0,0.
        goal: goal pose of the object as x,y,yaw [m, rad].
        set: properties of the object as NAME=VALUE, such as mass=12 (docs/scenario.md lists them), and settings of the
            run, such as control.num_rollouts=128 (shmoo list settings lists them).
        seed: seed of the properties that are not set, and of all noise; 2 draws a movable box, cart and wheelchair.
        start: start pose of the robot as x,y,yaw [m, rad].
        out: folder for result.json, report.html and episode.mp4.
        weights: file with trained weights (default: those of the method).
        video: write episode.mp4.
        record: also write episode.rrd, a 3-D recording for the Rerun viewer (needs the package rerun-sdk).
        senses: real (simulated camera, odometry and joint torques) or perfect (ground truth of the simulator).
        method: ours, frozen (no adaptation to the object) or paper (the system of the paper, docs/paper_system.md).
    """
    from shmoo_mjx.base import progress
    from shmoo_mjx.base.options import parted
    from shmoo_mjx.run import scenario_run as run

    properties, settings = parted(set)
    grid, task = run.push_inputs(family, goal, properties, seed=seed, start=start)
    with progress.stages() as report:
        result = run.run_scenario(
            grid,
            task,
            out,
            weights=weights,
            video=video,
            name="push",
            progress=report,
            record=record,
            senses=senses,
            method=method,
            settings=settings,
        )
    print(f"{result['outcome']}: {result['reason']}; {out / 'report.html'}")
    return 0 if result["outcome"] == "success" else 1


def live(
    scene: Positional[str] = "demo 0",
    *,
    host: str = "127.0.0.1",
    port: bounded.Port = 8080,
    senses: bounded.Senses = "real",
    weights: Path | None = None,
    out: Path = Path("runs/live"),
    seconds: bounded.Seconds | None = None,
    set: tuple[str, ...] = (),
) -> int:
    """Watch and disturb a run in the browser (needs the packages viser and mjviser).

    Example: shmoo live "demo 3"

    Args:
        scene: "demo SEED", the name of a shipped scenario such as box_in_doorway, or a scenario or map file.
        host: network interface to listen on. Anyone who can reach it can use the page.
        port: port of the page; the next free one if it is in use.
        senses: real (simulated camera, odometry and joint torques) or perfect (ground truth of the simulator).
        weights: file with trained weights (default: the shipped ones).
        out: folder for the scenes and reports that are saved on the page.
        seconds: stop after this wall-clock time [s] (default: run until Ctrl-C).
        set: settings of the run as NAME=VALUE, such as control.num_rollouts=128 (shmoo list settings lists them).
    """
    from shmoo_mjx.live.command import run_live

    return run_live(scene, host=host, port=port, senses=senses, weights=weights, out=out, seconds=seconds, settings=set)


def replay(run: Positional[Path], *, weights: Path | None = None) -> int:
    """Feed the recorded observations of a run to the navigator again and compare its commands bit for bit.

    Example: shmoo replay runs/demo-0

    Args:
        run: folder written by shmoo demo, navigate or push.
        weights: weights of the run (default: those in its folder, or else those of its method).
    """
    from shmoo_mjx.run.replay import replay as compare

    difference = compare(run, weights)
    print(f"{run}: {difference or 'every command is the same, bit for bit'}")
    return 0 if difference is None else 1


def report(
    source: Positional[Path],
    *,
    size: tuple[bounded.Side, bounded.Side] | None = None,
    out: Path | None = None,
    weights: Path | None = None,
) -> int:
    """Write a report on a recording of your own robot: the object's estimated properties, and whether it can be moved.

    Example: shmoo report log.csv --size 0.5 0.4

    Args:
        source: CSV or Parquet file (docs/how_to/recording.md lists its columns), or the folder of a run, whose report
            is written again.
        size: length and width of the object's footprint [m]; required for a recording.
        out: for a recording: folder for report.html, result.json and trace.npz (default: runs/report).
        weights: for a recording: file with trained weights; they hold the prior over objects (default: the shipped
            ones).
    """
    if not source.exists():
        raise ShmooError(f"{source}: there is no such file or folder; give a recording, or the folder of a run.")
    if source.is_dir():
        for option, value in {"--size": size, "--out": out, "--weights": weights}.items():
            if value is not None:
                raise ShmooError(f"{option} is for a recording alone; leave it out for the folder of a run.")
        from shmoo_mjx.report.html import write_report

        print(write_report(source))
        return 0
    if size is None:
        raise ShmooError(f"{source}: give the object's --size LENGTH WIDTH in m.")
    from shmoo_mjx.base.assets import WEIGHTS, asset
    from shmoo_mjx.learning.weights import load_weights
    from shmoo_mjx.run.custom_log import write_run

    print(write_run(source, size, out or Path("runs/report"), load_weights(weights or asset(WEIGHTS))))
    return 0


def collect(
    directory: Positional[Path],
    *,
    train: bounded.Train = 40,
    validation: bounded.Validation = 8,
    episodes: bounded.Episodes = 8,
    seconds: bounded.Seconds = 12.0,
    seed: Seed = 0,
    workers: bounded.Workers = 2,
) -> int:
    """Record a data set of scripted pushes of randomised objects. Resumes after an interruption.

    Example: shmoo collect data/train

    Args:
        directory: folder of the data set, new or to be continued.
        train: number of training objects per family.
        validation: number of validation objects per family.
        episodes: episodes per object.
        seconds: length of an episode [s].
        seed: seed of the scripted operators.
        workers: number of processes.
    """
    from shmoo_mjx.base import progress
    from shmoo_mjx.data.collect import CollectConfig
    from shmoo_mjx.data.collect import collect as run

    config = CollectConfig(train=train, validation=validation, episodes=episodes, seconds=seconds, seed=seed)
    with progress.counter("conditions") as report:
        run(directory, config, workers=workers, progress=report)
    print(f"{directory}: complete")
    return 0


def train(
    what: Positional[Literal["object", "robot"]],
    data: Positional[Path],
    *,
    out: Path | None = None,
    seed: Seed = 0,
    quick: bool = False,
    form: Literal["ours", "paper"] = "ours",
) -> int:
    """Train the object model (DAIML) or the robot model on a data set. Resumes after an interruption.

    Example: shmoo train object data/train --out weights.safetensors

    Args:
        what: object (basis functions psi, prior and noise) or robot (model R).
        data: data set made by shmoo collect.
        out: weights file. Training replaces one part and keeps the other (default: weights.safetensors, or
            weights-quick.safetensors with --quick).
        seed: seed of initialisation and batches.
        quick: short training of a few minutes, to try the commands. Its weights are not fit for use.
        form: shape of the network: ours, or paper (as the paper prints it).
    """
    from shmoo_mjx.base import progress
    from shmoo_mjx.base.guard import WEIGHTS, check_output
    from shmoo_mjx.learning.train import train_part

    target = out or Path("weights-quick.safetensors" if quick else "weights.safetensors")
    check_output(target, WEIGHTS)
    with progress.training(what) as report:
        score = train_part(what, data, target, seed=seed, progress=report, quick=quick, form=form)
    print(f"{target}: {what} model, fraction of variance unexplained on validation conditions {score:.3f}")
    if quick:
        print("A short training: these weights are not for use.")
    return 0


def map_(
    action: Positional[Literal["show"]],
    map: Positional[Path],
    *,
    out: Path | None = None,
    radius: bounded.Radius = 0.29,
) -> int:
    """Draw a map and the area in which a robot of a given radius fits.

    Example: shmoo map show office.yaml

    Args:
        action: show.
        map: YAML file of a map_server map.
        out: PNG file to write (default: NAME_free_space.png in the current folder).
        radius: radius of the robot [m].
    """
    from shmoo_mjx.base.guard import PNG, check_output
    from shmoo_mjx.planning.maps import count_free_unknown, load_map
    from shmoo_mjx.report.map_picture import draw_map

    target = out or Path(f"{map.stem}_free_space.png")
    check_output(target, PNG, ".png")
    grid = load_map(map)
    print(draw_map(grid, radius, target))
    if count := count_free_unknown(map):
        area = count * grid.resolution**2
        print(
            f"{count} cells ({area:.0f} m2) count as free only because 'free_thresh' lets grey 205 be free, which "
            f"map_saver writes for unknown cells; if they are unknown, set free_thresh: 0.196 in {map}."
        )
    return 0


def scenarios(
    action: Positional[Literal["make"]],
    *,
    out: Path,
    maps: Path | None = None,
    condition_seed: tuple[ConditionSeed, ...] = (0,),
    per_map: bounded.PerMap = 4,
) -> int:
    """Generate a set of certified scenarios in one file, for comparisons on the same scenarios.

    Example: shmoo scenarios make --maps maps --condition-seed 7 --out set.json

    Args:
        action: make.
        out: file to write. It holds the maps, the scenarios and their certificates.
        maps: folder with map_server maps (default: five generated buildings per seed).
        condition_seed: one or several seeds. Each generates its own scenarios on every map.
        per_map: number of scenarios per map and seed.
    """
    from shmoo_mjx.base import progress
    from shmoo_mjx.evaluation.scenario_set import make_set

    with progress.stages() as report:
        count = make_set(out, maps, condition_seed, per_map=per_map, progress=report)
    print(f"{out}: {count} scenario{'s' * (count != 1)}")
    return 0


def object_(
    action: Positional[Literal["add"]],
    source: Positional[Path],
    *,
    friction: bounded.Friction,
    mass: bounded.Mass | None = None,
    wheels: Literal["none", "casters", "rear"] = "none",
    wheel_radius: bounded.WheelRadius = 0.04,
    rolling: bounded.Rolling = 0.02,
    swivel_friction: bounded.SwivelFriction = 0.05,
    scale: bounded.Scale = 1.0,
    up: Literal["auto", "y", "z"] = "auto",
    hull: bool = False,
    out: Path | None = None,
) -> int:
    """Convert a mesh (STL, OBJ, PLY, OFF, GLB, glTF, Collada) or an MJCF file into an object file for scenarios.

    Example: shmoo object add chair.stl --mass 7 --friction 0.4 --wheels casters

    Args:
        action: add.
        source: mesh file, or MJCF file (.xml) of one rigid object.
        friction: Coulomb friction coefficient of feet or wheels on the floor.
        mass: mass of the whole object [kg]; required for a mesh (default: the mass in the MJCF file).
        wheels: none (the object slides on feet), casters (four), or rear (two fixed rear wheels, two front casters).
        wheel_radius: radius of the wheels [m].
        rolling: rolling resistance coefficient of each wheel.
        swivel_friction: dry friction of each caster's swivel [N m].
        scale: metres per unit of the file: 0.001 for millimetres, 0.01 for centimetres, 0.0254 for inches.
        up: upward axis of the file: y, z, or auto (y for GLB and glTF, the stated axis for Collada, z otherwise).
        hull: use the mass distribution of the convex hull, for a mesh that is not closed.
        out: file to write (default: NAME.json in the current folder).
    """
    from shmoo_mjx.plant.mesh import add_object

    print(
        add_object(
            source,
            mass,
            friction,
            wheels=wheels,
            wheel_radius=wheel_radius,
            rolling=rolling,
            swivel_friction=swivel_friction,
            scale=scale,
            up=up,
            hull=hull,
            out=out,
        )
    )
    return 0


def view(
    what: Positional[str] = "robot",
    *,
    seed: Seed = 0,
    record: Path | None = None,
    out: Path = Path("runs/view"),
    seconds: bounded.Seconds = 8.0,
    window: bool = True,
) -> int:
    """Show a scene and drive the robot with the keyboard. Without a display, write a picture and a film instead.

    Example: shmoo view cart --seed 3 --record data/mine

    Args:
        what: robot, demo, box, cart, wheelchair, an object file (*.json) or a scenario file (*.yaml).
        seed: seed of the object or the demo.
        record: data set to which the drive is added when the window closes.
        out: folder for scene.png and view.mp4 if no window opens.
        seconds: length of the film [s].
        window: open a window if there is a display (--no-window always writes the film).
    """
    from shmoo_mjx.plant.render import has_display
    from shmoo_mjx.run import teleop
    from shmoo_mjx.run import view as viewing

    if record is not None:
        check_seed(
            "--record: --seed", seed, UNSEEN_SEED - 1
        )  # The drive becomes training data, so seeds of test objects are excluded.
    scene = viewing.scene_named(what, seed)
    if window and has_display():
        print("\n".join(teleop.KEYS.values()))
        viewing.interactive(scene, record)
        return 0
    if record is not None:
        raise ShmooError("--record needs a display, for the keyboard; shmoo collect records scripted operators.")
    for path in viewing.film(scene, out, seconds):
        print(path)
    return 0


def experiment(
    name: Positional[str],
    *,
    seed: Seed | None = None,
    condition_seed: ConditionSeed = 0,
    json: Path | None = None,
    quick: bool = False,
    data: Path | None = None,
    maps: Path | None = None,
    scenarios: bounded.ScenariosOrSet | None = None,
    policies: tuple[str, ...] = (),
    weights: Path | None = None,
    pushes: Path | None = None,
    out: Path = Path("runs/experiments"),
    senses: bounded.Senses | None = None,
    runs: bounded.Runs | None = None,
    only: tuple[str, ...] = (),
    minutes: bounded.Minutes | None = None,
    buildings: bounded.Buildings | None = None,
    workers: bounded.Workers | None = None,
) -> int:
    """Run an experiment, such as navigation or pushing; shmoo list experiments lists them.

    The name all runs every experiment for users and writes a page of results. For developers: faults injects faults
    into the demo, and soak runs for hours of simulated time.

    Example: shmoo experiment object_model --json object_model.json

    Example: shmoo experiment faults --runs 2 --only camera_gone person_walks

    Args:
        name: name of the experiment, or all.
        seed: seed of training, operators and noise; of the first demo for faults and of the first building for soak
            (default: 0; 900 for faults; 950 for soak).
        condition_seed: seed of the test objects or scenarios. A new number gives a new test set.
        json: file for the result (default: OUT/NAME.json).
        quick: short form of the same shape.
        data: data set of experiments that use one, made if absent. For real_pushing: folder of recorded pushes.
        maps: folder with map_server maps, for navigation and lifelong (default: generated buildings).
        scenarios: for navigation and lifelong: number of scenarios per map. For navigation, also a scenario set in
            place of maps (a file made by shmoo scenarios make, or a shipped set: arena, floor_plans).
        policies: names of policies (navigation, lifelong) or pushing controllers (pushing) to compare (default: all,
            for lifelong only ours; shmoo list policies, shmoo list controllers). Navigation and pushing also take your
            own, as package.module:Name.
        weights: file with trained weights (default: the shipped ones).
        pushes: folder of recorded pushes, for real_pushing as a part of all.
        out: folder for figures and intermediate results.
        senses: real (simulated camera, odometry and joint torques; the default) or perfect (ground truth of the
            simulator).
        runs: for faults: runs per fault (default: 20, or 1 with --quick).
        only: for faults: names of the faults to run (default: all; shmoo list faults).
        minutes: for soak: simulated time per building [min] (default: 60, or 2 with --quick).
        buildings: for soak: number of buildings (default: 10, or 1 with --quick).
        workers: number of processes (default: chosen by the experiment).
    """
    from shmoo_mjx.base import progress
    from shmoo_mjx.base.guard import EXPERIMENT, check_output
    from shmoo_mjx.evaluation.registry import check_options, experiment_named, run_experiment
    from shmoo_mjx.evaluation.result import ExperimentOptions, table, write_result

    target = json or out / f"{name}.json"
    check_output(target, EXPERIMENT)
    first_seed = 0 if name == "all" else experiment_named(name).first_seed
    sizes = {"runs": runs, "only": only or None, "minutes": minutes, "buildings": buildings}
    others = {"data": data, "maps": maps, "scenarios": scenarios, "policies": policies or None, "pushes": pushes,
              "weights": weights, "senses": senses}  # fmt: skip
    check_options(name, [option for option, value in (others | sizes).items() if value is not None])
    sizes = {option: value for option, value in (sizes | {"workers": workers}).items() if value is not None}
    count, scenario_set = (None, scenarios) if isinstance(scenarios, Path) else (scenarios, None)
    if scenario_set is not None:
        from shmoo_mjx.evaluation.scenario_set import find_set

        if name != "navigation" or maps is not None:
            raise ShmooError(f"--scenarios {scenario_set}: a scenario set is for navigation alone, without --maps.")
        scenario_set = find_set(scenario_set)
    with progress.stages() as report:
        options = ExperimentOptions(
            seed=first_seed if seed is None else seed,
            condition_seed=condition_seed,
            quick=quick,
            data=data,
            maps=maps,
            scenarios=count,
            scenario_set=scenario_set,
            weights=weights,
            out=out,
            progress=report,
            senses=senses or "real",
            policies=policies,
            sizes=sizes,
        )
        if name == "all":
            from shmoo_mjx.evaluation.everything import run_all

            page, left_out = run_all(options, pushes)
            for other, reason in left_out.items():
                print(f"{other} was left out: {reason}")
            print(page)
            return 0
        result = run_experiment(name, options)
    write_result(target, result)
    print(experiment_named(name).printed(result) or table(result))
    print(target)
    return 0


def bench(
    name: Positional[str],
    files: Positional[tuple[Path, ...]] = (),
    *,
    json: Path | None = None,
    quick: bool = False,
    peers_python: Path | None = None,
    ratios: bool = False,
    maps: Path | None = None,
    seed: Seed = 0,
    out: Path = Path("runs/benchmarks"),
) -> int:
    """Measure the speed of a part, or compare two results of one machine; shmoo list benchmarks lists the parts.

    Example: shmoo bench mppi --peers-python peers/bin/python --json mppi.json

    Example: shmoo bench compare old.json new.json

    Args:
        name: name of the benchmark, all, or compare. Compare ends with code 1 if a part takes over 20 % longer.
        files: for compare: the older result, then the newer one.
        json: file for the result (default: OUT/bench_NAME.json).
        quick: short form of the same shape.
        peers_python: Python interpreter with torch and pytorch-mppi (default: this one). Missing packages are left out.
        ratios: for compare: compare only ratios, for results of two machines; the limit is then 1.9 times.
        maps: for navigation: folder of map_server maps; one trial per map is timed too.
        seed: seed of random weights and noise.
        out: folder for the result.
    """
    from shmoo_mjx.base import progress
    from shmoo_mjx.base.guard import EXPERIMENT, check_output
    from shmoo_mjx.evaluation.result import write_result

    suite = benchmark_suite()
    if name == "compare":
        text, slower = suite.compare_files(files, ratios)
        print(text)
        return int(slower)
    target = json or out / f"bench_{name}.json"
    check_output(target, EXPERIMENT)
    with progress.stages() as report:
        options = suite.BenchOptions(quick, peers_python, seed, report, maps)
        result = suite.run_all(options, out) if name == "all" else suite.run_benchmark(name, options)
    write_result(target, result)
    print(suite.describe(result))
    print(target)
    return 0


def sweep(
    config: Positional[Path],
    *,
    out: Path | None = None,
    weights: Path | None = None,
    quick: bool = False,
    estimate: bool = False,
    memory_gb: bounded.GigaBytes | None = None,
    jobs: bounded.Jobs = 0,
    cluster: Literal["slurm", "local"] = "slurm",
    options: tuple[str, ...] = (),
    senses: bounded.Senses | None = None,
) -> int:
    """Push objects in thousands of randomised MJX worlds and map when pushes succeed. Resumes after an interruption.

    Example: shmoo sweep push_mass_friction --quick

    Args:
        config: sweep file (docs/sweeps.md), or the name of a shipped sweep.
        out: folder for shards, table and figures (default: runs/sweeps/NAME).
        weights: file with trained weights (default: the shipped ones).
        quick: short form of the same shape.
        estimate: print the expected time and memory, and run nothing.
        memory_gb: memory limit for one batch of worlds [GB] (default: the free memory).
        jobs: number of cluster jobs that share the work; 0 runs everything in this process.
        cluster: with --jobs: slurm, or local (processes on this machine).
        options: with --jobs: submitit settings, such as timeout_min=60 gpus_per_node=1 slurm_partition=gpu.
        senses: real or perfect; replaces the sweep's own value (default: the sweep's, or else real).
    """
    from shmoo_mjx.base import progress
    from shmoo_mjx.sweep.command import carry_out

    made = carry_out(
        config,
        out,
        weights=weights,
        short=quick,
        only_estimate=estimate,
        memory_gb=memory_gb,
        jobs=jobs,
        cluster=cluster,
        options=options,
        progress=progress.stages,
        senses=senses,
    )
    for path in made:
        print(path)
    return 0


def list_(
    what: Positional[
        Literal[
            "all",
            "scenarios",
            "sets",
            "maps",
            "objects",
            "weights",
            "methods",
            "experiments",
            "policies",
            "controllers",
            "faults",
            "sweeps",
            "benchmarks",
            "settings",
        ]
    ] = "all",
) -> int:
    """List what is shipped, with the command to use each item.

    Example: shmoo list settings

    Args:
        what: kind of item. All leaves out the settings.
    """  # fmt: skip
    from shmoo_mjx.evaluation.catalogue import KINDS, lines

    print("\n".join(lines([kind for kind in KINDS if kind != "settings"] if what == "all" else [what])))
    if what == "all":
        print("shmoo list settings shows the settings of a run, for --set.")
    return 0


def doctor() -> int:
    """Check versions, device, renderer, video encoder and weights, and print a remedy for each failure.

    Example: shmoo doctor
    """
    from shmoo_mjx.run.doctor import report

    return report()


def completion(shell: Positional[Literal["bash", "zsh", "fish"]]) -> int:
    """Print a script that makes a shell complete commands and options.

    Example: shmoo completion bash > ~/.local/share/bash-completion/completions/shmoo

    Args:
        shell: bash, zsh or fish.
    """
    return _run(["--tyro-print-completion", shell])


_COMMANDS: dict[str, Callable[..., int]] = {
    "demo": demo,
    "navigate": navigate,
    "push": push,
    "live": live,
    "report": report,
    "view": view,
    "scenarios": scenarios,
    "object": object_,
    "map": map_,
    "train": train,
    "collect": collect,
    "experiment": experiment,
    "sweep": sweep,
    "list": list_,
    "bench": bench,
    "doctor": doctor,
    "replay": replay,
    "completion": completion,
}
"""All commands, in the order of `shmoo --help`."""
_MOVED = {"faults": "experiment faults", "soak": "experiment soak"}
_NEED_NO_DEVICE = ("doctor", "completion", "list")
_GO_ON = ("collect", "train", "scenarios", "experiment", "sweep")
"""Commands that resume after an interruption."""


def _run(arguments: list[str] | None = None) -> int:
    """Run the command given by the arguments (default: those of this process) and return its exit code."""
    words = _joined(sys.argv[1:] if arguments is None else arguments)
    if words == ["--version"]:
        print(f"shmoo_mjx {shmoo_mjx.__version__}")
        return 0
    if words and not words[0].startswith("-") and words[0] not in _COMMANDS:
        if moved := _MOVED.get(words[0]):
            raise ShmooError(f"there is no command {words[0]!r}; use shmoo {moved}, with the same options.")
        near = get_close_matches(words[0], _COMMANDS, 1)
        hint = f"did you mean {near[0]}?" if near else f"choose from {', '.join(_COMMANDS)}."
        raise ShmooError(f"there is no command {words[0]!r}; {hint}")
    if words and words[0] in _COMMANDS and words[0] not in _NEED_NO_DEVICE and not {"--help", "-h"} & set(words):
        check_environment()
    commands = {name: with_verbosity(with_inputs_kept(command)) for name, command in _COMMANDS.items()}
    code: int = tyro.extras.subcommand_cli_from_dict(
        commands,
        prog="shmoo",
        description=str(shmoo_mjx.__doc__).partition("\n")[0],
        args=words,
        # Without this text tyro parses its own source code to find one, a fifth of the time that --help takes.
        config=(tyro.conf.arg(help="shmoo COMMAND --help lists the options of a command."),),  # type: ignore[arg-type]
    )
    return code


def _joined(words: list[str]) -> list[str]:
    """Join ``--start -1,2,0`` to ``--start=-1,2,0``, because the parser takes a leading minus for an option."""
    joined: list[str] = []
    for word in words:
        if joined and joined[-1] in ("--start", "--goal") and re.match(r"-[\d.]", word):
            joined[-1] += f"={word}"
        else:
            joined.append(word)
    return joined


def main() -> None:
    """Entry point of ``shmoo``. Bad input prints one sentence and ends with exit code 2."""
    prepare_environment()
    try:
        code = _run()
    except ShmooError as error:
        print(f"shmoo: {error}", file=sys.stderr)
        code = 2
    except BrokenPipeError:
        # The reader closed the pipe. Without this, Python fails again when it flushes stdout at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        code = 1
    except OSError as error:
        where, full = error.filename or "a file", error.errno in (errno.ENOSPC, errno.EDQUOT)
        remedy = "make room, or choose another place" if full else "choose a place that can be read and written"
        print(f"shmoo: {where}: {error.strerror or error}; {remedy}.", file=sys.stderr)
        code = 2
    except KeyboardInterrupt:
        goes_on = {*_GO_ON} & {*sys.argv[1:2]}
        print(f"shmoo: stopped{'; run the same command again to go on' if goes_on else ''}.", file=sys.stderr)
        code = 130
    sys.exit(code)
