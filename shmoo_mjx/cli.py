"""The command line: thin, each command calls one function of the package. Heavy imports wait until a command runs."""

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
    """Run the whole story on a generated floor plan: push a box away, recognise a locked wheelchair, go round.

    Example: shmoo demo --seed 3

    Args:
        seed: draws floor plan, objects and properties; a range such as 0..19 runs each and prints the success rate.
        out: folder that gets one folder per run, demo-SEED.
        weights: trained weights (default: those of the method).
        video: draw episode.mp4 (--no-video is about twice as fast).
        quick: a short form for checks: no video.
        senses: real (camera, odometry, joint torques) or perfect (the simulator's truth).
        scene: generated, or paper (a box of 2.8 kg, an empty wheelchair of 11.9 kg with locked wheels).
        method: ours, frozen (learns nothing of an object), or paper (the paper's system, docs/paper_system.md).
        set: settings of the run, NAME=VALUE, such as control.num_rollouts=128 (shmoo list settings).
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
    """Run a scenario in any ROS map_server map.

    Example: shmoo navigate --map office.yaml --scenario blocked_door.yaml

    Args:
        scenario: scenario file (docs/scenario.md); or give --start and --goal.
        map: map_server YAML; overrides the scenario's own map.
        start: x,y,yaw [m, rad] of the robot, without a scenario file.
        goal: x,y [m], without a scenario file.
        out: folder for result.json, report.html and episode.mp4.
        weights: trained weights (default: those of the method).
        video: draw episode.mp4.
        record: write episode.rrd too, a 3-D recording to scrub through (needs the package rerun-sdk).
        senses: real or perfect; overrides the scenario's own (default: real).
        real_time: run against the wall clock: what computing really takes passes in the world, and each missed
            deadline is reported.
        policy: package.module:Name of your own navigation policy, in the place of ours.
        method: ours, frozen (learns nothing of an object), or paper (the paper's system, docs/paper_system.md).
        set: settings of the run, NAME=VALUE, such as control.num_rollouts=128 (shmoo list settings).
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
    seed: Seed = 0,
    start: str = "-1.3,0,0",
    out: Path = Path("runs/push"),
    weights: Path | None = None,
    video: bool = True,
    record: bool = False,
    senses: bounded.Senses = "real",
    method: bounded.Method = "ours",
) -> int:
    """Push one object to a pose on an open floor, with report and film.

    Example: shmoo push wheelchair --goal 1.5,0,0.8 --set mass=12 friction=0.6

    Args:
        family: box, cart, wheelchair, or an object file that shmoo object add has made. It stands at 0,0,0.
        goal: x,y,yaw [m, rad] to which the object is to be brought.
        set: properties of the object as in a scenario file (docs/scenario.md), such as mass=12, of which the others are
            drawn; and settings of the run, such as control.num_rollouts=128 (shmoo list settings).
        seed: draws the properties that are not set, and all noise.
        start: x,y,yaw [m, rad] of the robot.
        out: folder for result.json, report.html and episode.mp4.
        weights: trained weights (default: those of the method).
        video: draw episode.mp4.
        record: write episode.rrd too, a 3-D recording to scrub through (needs the package rerun-sdk).
        senses: real or perfect.
        method: ours, frozen (learns nothing of an object), or paper (the paper's system, docs/paper_system.md).
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
) -> int:
    """Watch the robot think in the browser, set its goals, and move things in its way (needs viser and mjviser).

    Example: shmoo live "demo 3"

    Args:
        scene: "demo SEED", a scenario of the package such as box_in_doorway, or a scenario or map file.
        host: network interface to listen on. Whoever reaches it can use the page.
        port: where the page is; the next free one if it is in use.
        senses: real or perfect.
        weights: trained weights (default: the shipped ones).
        out: folder for scenes and reports that are saved on the page.
        seconds: end after this wall-clock time [s] (default: when Ctrl-C is pressed).
    """
    from shmoo_mjx.live.command import run_live

    return run_live(scene, host=host, port=port, senses=senses, weights=weights, out=out, seconds=seconds)


def replay(run: Positional[Path], *, weights: Path | None = None) -> int:
    """Feed a run's recorded observations to the navigator again and compare its commands bit for bit.

    Example: shmoo replay runs/demo-0

    Args:
        run: folder that demo or navigate has left.
        weights: those of the run (default: the ones in its folder, or else those of its method).
    """
    from shmoo_mjx.run.replay import replay as compare

    difference = compare(run, weights)
    print(f"{run}: {difference or 'every command is the same, bit for bit'}")
    return 0 if difference is None else 1


def report(
    source: Positional[Path],
    *,
    size: tuple[bounded.Side, bounded.Side] | None = None,
    out: Path = Path("runs/report"),
    weights: Path | None = None,
) -> int:
    """Make the report of a recording of your own robot: what was learned of the object, and whether it can be moved.

    Example: shmoo report log.csv --size 0.5 0.4

    Args:
        source: CSV or Parquet file (docs/make_your_own.md lists its columns); or the folder of a run, to draw it again.
        size: length and width of the object's footprint [m].
        out: folder for report.html, result.json and trace.npz.
        weights: trained weights, for what objects are like (default: the shipped ones).
    """
    if source.is_dir():
        from shmoo_mjx.report.html import write_report

        print(write_report(source))
        return 0
    if size is None:
        raise ShmooError(f"{source}: give the object's --size LENGTH WIDTH in m.")
    from shmoo_mjx.base.assets import WEIGHTS, asset
    from shmoo_mjx.learning.weights import load_weights
    from shmoo_mjx.run.custom_log import write_run

    print(write_run(source, size, out, load_weights(weights or asset(WEIGHTS))))
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
    """Let scripted operators push randomised objects and record a data set; resumes where it was stopped.

    Example: shmoo collect data/train

    Args:
        directory: data set to make or to go on with.
        train: training conditions per family.
        validation: validation conditions per family.
        episodes: episodes per condition.
        seconds: length of an episode [s].
        seed: of the operators.
        workers: processes.
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
    """Train the object model (DAIML) or the robot model on a data set; resumes where it was stopped.

    Example: shmoo train object data/train --out weights.safetensors

    Args:
        what: object (psi, its prior and noise) or robot (R).
        data: data set made by shmoo collect.
        out: weights file; the part that is trained is written into it, the other part is kept (default:
            weights.safetensors, or weights-quick.safetensors with --quick).
        seed: of initialisation and batches.
        quick: a short form of a few minutes, to try the commands; its weights are not for use.
        form: shape of the network: ours, or as the paper prints it.
    """
    from shmoo_mjx.base import progress
    from shmoo_mjx.learning.train import train_part

    target = out or Path("weights-quick.safetensors" if quick else "weights.safetensors")
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
    """Draw a map with the free space of a robot of the given radius.

    Example: shmoo map show office.yaml

    Args:
        action: show.
        map: map_server YAML.
        out: PNG picture to write (default: the map's name with _free_space.png, in the present folder).
        radius: robot radius [m].
    """
    from shmoo_mjx.planning.maps import count_free_unknown, load_map
    from shmoo_mjx.report.map_picture import draw_map

    grid = load_map(map)
    print(draw_map(grid, radius, out or Path(f"{map.stem}_free_space.png")))
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
    """Draw scenarios with certificates on your maps, in one file, so that others can compare on the same ones.

    Example: shmoo scenarios make --maps maps --condition-seed 7 --out set.json

    Args:
        action: make.
        out: file to write: maps, scenarios, and what is known about each.
        maps: folder with map_server maps (default: five buildings are generated for each seed).
        condition_seed: one or several; each draws scenarios of its own on every map.
        per_map: scenarios on each map for each seed.
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
    """Turn a mesh (STL, OBJ, PLY, GLB, Collada) or MJCF file into an object that a scenario can name as its family.

    Example: shmoo object add chair.stl --mass 7 --friction 0.4 --wheels casters

    Args:
        action: add.
        source: mesh file, or MJCF file (.xml) of one rigid object.
        friction: Coulomb coefficient of feet or wheels on the floor.
        mass: of the whole object [kg]; an MJCF file's own if not given.
        wheels: none (slides on its feet), casters, or rear (two fixed wheels behind, casters in front).
        wheel_radius: [m].
        rolling: rolling resistance coefficient of each wheel.
        swivel_friction: dry friction of each caster's swivel [N m].
        scale: metres per unit of the file: 0.001 for millimetres, 0.01 for centimetres, 0.0254 for inches.
        up: which axis of the file points up; auto is y for GLB and glTF, what a Collada file states, else z.
        hull: take the mass distribution of the convex hull, for a mesh that is not closed.
        out: file to write (default: the source's name with .json, in the present folder).
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
    """Show a scene and drive the robot with the keyboard; where no window can open, write a picture and a film.

    Example: shmoo view cart --seed 3 --record data/mine

    Args:
        what: robot, demo, box, cart, wheelchair, an object file (*.json) or a scenario file (*.yaml).
        seed: of the object or the demo.
        record: data set that the drive is added to when the window is closed.
        out: folder for scene.png and view.mp4, where no window can open.
        seconds: length of the film [s].
        window: open a window if there is a display (--no-window always writes the film).
    """
    from shmoo_mjx.plant.render import has_display
    from shmoo_mjx.run import teleop
    from shmoo_mjx.run import view as viewing

    if record is not None:
        check_seed("--record: --seed", seed, UNSEEN_SEED - 1)  # A drive is training data.
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
    senses: bounded.Senses = "real",
    runs: bounded.Runs | None = None,
    only: tuple[str, ...] = (),
    minutes: bounded.Minutes | None = None,
    buildings: bounded.Buildings | None = None,
    workers: bounded.Workers | None = None,
) -> int:
    """Run an experiment: object_model, estimate, outcomes, baselines, ablations, robot_finetune, pushing,
    object_planner, real_pushing, navigation, lifelong; or all of them, with a page of their results. For developers:
    faults (each fault in the demo's scenes) and soak (hours of errands while others move objects).

    Example: shmoo experiment object_model --json object_model.json

    Example: shmoo experiment faults --runs 2 --only camera_gone person_walks

    Args:
        name: which experiment.
        seed: of trainings, operators and noise; of the first demo for faults, of the first building for soak (default:
            0, for faults 900, for soak 950).
        condition_seed: draws the unseen objects or scenarios; another number gives others nobody has looked at.
        json: file for the result (default: OUT/NAME.json).
        quick: a short form of the same shape.
        data: data set, for the experiments that take one (made if absent; real_pushing: a folder of recorded pushes).
        maps: folder with map_server maps, for navigation.
        scenarios: scenarios per map, for navigation; or a scenario set in the place of maps: a file made by shmoo
            scenarios make, or arena or floor_plans, the shipped ones.
        policies: which policies (navigation, lifelong) or pushing controllers (pushing) run, by their names (default:
            all; shmoo list policies, shmoo list controllers); for navigation and pushing also your own, as
            package.module:Name.
        weights: trained weights (default: the shipped ones).
        pushes: folder of recorded pushes, for real_pushing among all.
        out: folder for figures and what an interrupted experiment goes on from.
        senses: real or perfect, of the robots that act in the experiment.
        runs: of each fault, for faults (default: 20, or 1 if quick).
        only: these faults, for faults (default: all; shmoo list faults).
        minutes: simulated time in each building, for soak (default: 60, or 2 if quick).
        buildings: how many, for soak (default: 10, or 1 if quick).
        workers: processes (default: the experiment's own).
    """
    from shmoo_mjx.base import progress
    from shmoo_mjx.base.guard import EXPERIMENT, check_output
    from shmoo_mjx.evaluation.registry import experiment_named, run_experiment
    from shmoo_mjx.evaluation.result import ExperimentOptions, table, write_result

    target = json or out / f"{name}.json"
    check_output(target, EXPERIMENT)
    own = {"runs": ("faults", runs), "only": ("faults", only or None), "minutes": ("soak", minutes),
           "buildings": ("soak", buildings)}  # fmt: skip
    for option, (user, value) in own.items():
        if value is not None and name != user:
            raise ShmooError(f"--{option} is for shmoo experiment {user} alone; leave it out.")
    sizes = {option: value for option, (_, value) in own.items() if value is not None}
    count, scenario_set = (None, scenarios) if isinstance(scenarios, Path) else (scenarios, None)
    if scenario_set is not None:
        from shmoo_mjx.evaluation.scenario_set import find_set

        if name != "navigation" or maps is not None:
            raise ShmooError(f"--scenarios {scenario_set}: a scenario set is for navigation alone, without --maps.")
        scenario_set = find_set(scenario_set)
    with progress.stages() as report:
        options = ExperimentOptions(
            seed=(0 if name == "all" else experiment_named(name).first_seed) if seed is None else seed,
            condition_seed=condition_seed,
            quick=quick,
            data=data,
            maps=maps,
            scenarios=count,
            scenario_set=scenario_set,
            weights=weights,
            out=out,
            progress=report,
            senses=senses,
            policies=policies,
            sizes=sizes if workers is None else sizes | {"workers": workers},
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
    """Measure how fast a part is: mppi (control step), daiml (training), plant, planner, demo, navigation (a trial),
    startup, or all of them; or compare two results of one machine.

    Example: shmoo bench mppi --peers-python peers/bin/python --json mppi.json

    Example: shmoo bench compare old.json new.json

    Args:
        name: which benchmark; all; or compare, which ends with code 1 if anything takes over 20 % longer than it did.
        files: for compare: the older result, then the newer one.
        json: file for the result (default: OUT/bench_NAME.json).
        quick: a short form of the same shape.
        peers_python: Python interpreter with torch and pytorch-mppi (default: this one); absent peers are left out.
        ratios: for compare: only ratios, of results from two machines; up to 1.9 times as much is let pass.
        maps: for navigation: folder of map_server maps, on each of which a trial is timed too.
        seed: of made-up weights and noise.
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
    """Push objects in thousands of randomised MJX worlds and say when pushes succeed; goes on where it was stopped.

    Example: shmoo sweep push_mass_friction --quick

    Args:
        config: sweep file (docs/sweeps.md), or the name of a shipped one.
        out: folder for shards, table and figures (default: runs/sweeps/NAME).
        weights: trained weights (default: the shipped ones).
        quick: a short form of the same shape.
        estimate: only say what time and memory it would take.
        memory_gb: that a batch of worlds may take [GB] (default: what is free).
        jobs: so many jobs of a cluster share the work; 0 is this process alone.
        cluster: with --jobs: slurm, or local for processes of this machine.
        options: with --jobs: settings of submitit, such as timeout_min=60 gpus_per_node=1 slurm_partition=gpu.
        senses: real or perfect; overrides the sweep's own (default: real).
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
    """List what is shipped, a line each with what to type.

    Example: shmoo list settings

    Args:
        what: one kind, or all but the settings.
    """  # fmt: skip
    from shmoo_mjx.evaluation.catalogue import KINDS, lines

    print("\n".join(lines([kind for kind in KINDS if kind != "settings"] if what == "all" else [what])))
    if what == "all":
        print("shmoo list settings shows the settings of a run, for --set.")
    return 0


def doctor() -> int:
    """Check versions, device, renderer and video encoder, and say what to do about each failure.

    Example: shmoo doctor
    """
    from shmoo_mjx.run.doctor import report

    return report()


def completion(shell: Positional[Literal["bash", "zsh", "fish"]]) -> int:
    """Print the script that lets a shell complete commands and options.

    Example: shmoo completion bash > ~/.local/share/bash-completion/completions/shmoo

    Args:
        shell: which shell.
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
"""Users' commands first, then those for developers."""
_MOVED = {"faults": "experiment faults", "soak": "experiment soak"}
_NEED_NO_DEVICE = ("doctor", "completion", "list")
_GO_ON = ("collect", "train", "scenarios", "experiment", "sweep")
"""Commands that go on where they were stopped."""


def _run(arguments: list[str] | None = None) -> int:
    """Run the command that the arguments name (default: those of this process)."""
    words = _joined(sys.argv[1:] if arguments is None else arguments)
    if words == ["--version"]:
        print(f"shmoo_mjx {shmoo_mjx.__version__}")
        return 0
    if words and not words[0].startswith("-") and words[0] not in _COMMANDS:
        if moved := _MOVED.get(words[0]):
            raise ShmooError(f"shmoo {words[0]} is shmoo {moved} now, with the same options.")
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
        # Without a text tyro parses its own source for one, which takes a fifth of the time of --help.
        config=(tyro.conf.arg(help="shmoo COMMAND --help lists its options. For developers: bench, doctor, replay."),),  # type: ignore[arg-type]
    )
    return code


def _joined(words: list[str]) -> list[str]:
    """``--start -1,2,0`` as ``--start=-1,2,0``: a place may begin with a minus without being an option."""
    joined: list[str] = []
    for word in words:
        if joined and joined[-1] in ("--start", "--goal") and re.match(r"-[\d.]", word):
            joined[-1] += f"={word}"
        else:
            joined.append(word)
    return joined


def main() -> None:
    """Entry point. Bad input ends with one sentence and exit code 2."""
    prepare_environment()
    try:
        code = _run()
    except ShmooError as error:
        print(f"shmoo: {error}", file=sys.stderr)
        code = 2
    except BrokenPipeError:
        # Whoever read the output has closed it; Python would try to flush once more at its end.
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
