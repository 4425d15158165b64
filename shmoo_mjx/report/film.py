"""The 3-D film of a run: in the scene the robot's plan, its predictions and estimates, beside it the map."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from typing import Any

import numpy as np
from matplotlib.colors import to_rgb
from PIL import Image, ImageDraw

from shmoo_mjx.geometry import se2
from shmoo_mjx.geometry.hands import CONTACT_FORCE
from shmoo_mjx.plant.render import Mark, Shot, shots, tops
from shmoo_mjx.plant.scene import Scene
from shmoo_mjx.report import video, words
from shmoo_mjx.report.style import COLOURS, font, object_colour, outline
from shmoo_mjx.report.trace import Trace
from shmoo_mjx.types import DT

WIDTH, HEIGHT = 1280, 645
"""Size of the 3-D picture [pixels]. With the caption the film has 1280 x 720."""
FPS = 30.0
"""Frames per second of video."""
_INSET = (270, 230)
"""Largest size of the map [pixels]."""
_HOLD = 1.5
"""For how long the last frame stays [s]."""
_FLOOR = 0.012
"""Height of lines on the floor [m]."""
_FAN = 16
"""Number of predicted pushes that are drawn: those of the best option."""
_STEP = 3
"""Stride over the time steps of a predicted push."""
_PER_NEWTON = 0.03
"""Length of the arrow per force [m/N]."""
_ASIDE = 34
"""How far up and to the left of its place a label is [pixels], so that it hides neither arrow nor predictions."""
_EDGE = 6
"""Distance of a label from the picture's edge and of its text from its own [pixels]."""


@dataclass(frozen=True)
class Label:
    """A text at a point of the scene."""

    place: np.ndarray
    """Point in {W} that the label is about ``[3]`` [m]."""
    lines: tuple[str, ...]
    """Lines of text, the first one bold."""
    colour: str
    """Colour of its frame."""
    below: bool = False
    """Whether it stands to the lower right of its place instead of the upper left."""


def film_frames(
    result: dict[str, Any],
    trace: Trace,
    scene: Scene,
    qpos: np.ndarray,
    *,
    speed: float = video.SPEED,
    progress: Callable[[float], None] = lambda fraction: None,
) -> Iterator[np.ndarray]:
    """Frames of the film, at `FPS`.

    Args:
        result: content of ``result.json``.
        trace: trace of the run.
        scene: simulated scene.
        qpos: configurations ``[T, nq]``, one for each sample of the trace.
        speed: seconds of the run per second of video, a multiple of ``FPS * DT``.
        progress: called with the finished share of the frames.

    Yields:
        uint8 images ``[720, 1280, 3]``.
    """
    samples = np.arange(0, len(qpos), max(1, round(speed / FPS / DT)))
    drawn = _Drawn(result, trace, tops(scene))
    pictures = shots(
        scene,
        qpos[samples],
        width=WIDTH,
        height=HEIGHT,
        distance=4.0,
        follow=0.08,
        marks=lambda i, hands: drawn.marks(int(samples[i]), hands),
    )
    view = video.top_down(result, trace, video.fitting(result, trace, _INSET))
    frame = np.zeros(0)
    for i, (k, shot) in enumerate(zip(samples, pictures, strict=True)):
        progress(i / len(samples))
        t = float(trace.t[k])
        picture = _labelled(shot, drawn.labels(int(k)), pushing=result.get("push_to") is not None)
        frame = video.compose(
            picture, words.caption_at(result, t), video.topdown_image(view, t), clock=f"{t:.0f} s   {speed:g}x speed"
        )
        yield frame
    for _ in range(round(_HOLD * FPS)):
        yield frame


@dataclass(frozen=True)
class _Drawn:
    """What is drawn into the scene."""

    result: dict[str, Any]
    trace: Trace
    tops: np.ndarray

    def marks(self, k: int, hands: np.ndarray) -> list[Mark]:
        """Shapes at sample ``k``, with the ``hands [2, 3]`` in {W}."""
        t, shapes = float(self.trace.t[k]), list[Mark]()
        shapes += _polyline(self._plan(t), COLOURS["plan"], 0.02)
        if self.result.get("push_to") is not None:
            target = np.asarray(self.result["push_to"], dtype=float)
            corners = outline(target, self.result["objects"][0]["half_extents"])
            front = se2.transform_point(
                target, np.array([[0.0, 0.0], [self.result["objects"][0]["half_extents"][0], 0.0]])
            )
            shapes += _polyline(np.concatenate([corners, corners[:1]]), COLOURS["goal"], 0.018)
            shapes += _polyline(front, COLOURS["goal"], 0.018)
        elif self.result.get("goal") is not None:
            place = [*self.result["goal"][:2], _FLOOR]
            shapes.append(Mark("disc", place, place, 0.22, (*to_rgb(COLOURS["goal"]), 0.9)))
        number = self._decision(t)
        if number is not None:
            shapes += self._predicted(number)
        return shapes + self._force(k, hands)

    def _plan(self, t: float) -> np.ndarray:
        past = np.flatnonzero(np.asarray(self.trace.plan_times, dtype=float) <= t + 1e-6)
        return np.asarray(self.trace.plans[past[-1]])[:, :2] if len(past) else np.zeros((0, 2))

    def _decision(self, t: float) -> int | None:
        """Index of the last decision, as long as the robot deals with its object."""
        past = [i for i, d in enumerate(self.result["decisions"]) if float(d["t"]) <= t + 1e-6]
        steps = [step for step in self.result["transitions"] if float(step["t"]) <= t + 1e-6]
        deals = bool(steps) and str(steps[-1]["to"]) in ("approach", "make contact", "probe", "push")
        return past[-1] if past and deals else None

    def _predicted(self, number: int) -> list[Mark]:
        """Predicted paths of the object for the option that was chosen, and where it is to end."""
        decision, shapes = self.result["decisions"][number], list[Mark]()
        ends = self.trace.decision_rollouts[number] if number < len(self.trace.decision_rollouts) else ()
        goal = decision.get("goal")
        for line in list(ends)[:_FAN]:
            shapes += _polyline(np.asarray(line)[::_STEP], COLOURS["rollout"], 0.011)
        final = self.result.get("push_to")
        if goal is not None and (final is None or not np.allclose(goal[:2], final[:2], atol=0.01)):
            place = [*goal[:2], _FLOOR]
            shapes.append(Mark("disc", place, place, 0.09, (*to_rgb(COLOURS["decision"]), 1.0)))
        return shapes

    def _force(self, k: int, hands: np.ndarray) -> list[Mark]:
        begin, end = self._arrow(k, hands.mean(axis=0)[:2])
        return [] if end is None else [Mark("arrow", begin, end, 0.025, (*to_rgb(COLOURS["decision"]), 1.0))]

    def _arrow(self, k: int, hands: np.ndarray) -> tuple[np.ndarray, np.ndarray | None]:
        """Ends of the arrow of force, above the pushed object where it does not hide it; no end without contact."""
        pose, force = np.asarray(self.trace.robot_pose[k], dtype=float), np.asarray(self.trace.force[k], dtype=float)
        index = int(self.trace.learned_object[k])
        begin = np.array([*hands, 0.1 + (self.tops[index] if 0 <= index < len(self.tops) else 0.7)])
        if not np.isfinite(force).all() or np.linalg.norm(force) < CONTACT_FORCE:
            return begin, None
        return begin, begin + _PER_NEWTON * np.array([*se2.rotate(force, pose[2]), 0.0])

    def labels(self, k: int) -> list[Label]:
        """Labels at sample ``k``: objects with what the robot believes of them, goal."""
        t, shown = float(self.trace.t[k]), list[Label]()
        for i, item in enumerate(self.result["objects"]):
            pose = np.asarray(self.trace.object_pose[k, i], dtype=float)
            if not np.isfinite(pose).all():
                continue
            believed = words.belief_at(self.result, item["id"], t)
            lines = (words.object_name(self.result, item["id"]), *([believed] if believed else []))
            now = {**item, "registered": words.registered_at(self.result, item["id"], t)}
            estimate = self._estimate(k, i, item.get("true", {}))
            shown.append(Label(np.array([*pose[:2], self.tops[i]]), (*lines, *estimate), object_colour(now, i)))
        pushing = self.result.get("push_to") is not None
        goal = self.result["push_to"] if pushing else self.result.get("goal")
        if goal is not None:
            name = f"goal of {words.the_object(self.result, self.result['objects'][0]['id'])}" if pushing else "goal"
            shown.insert(0, Label(np.array([*goal[:2], 0.05]), (name,), COLOURS["goal"], below=True))
        return shown

    def _estimate(self, k: int, index: int, true: dict[str, float]) -> list[str]:
        """Estimated mass and friction with their 80 % bands, from the first push on, and the true values."""
        mine = np.flatnonzero(np.asarray(self.trace.learned_object[: k + 1]) == index)
        if not len(mine) or "mass" not in self.trace.learned_names:
            return []
        now = dict(zip(self.trace.learned_names, np.asarray(self.trace.learned[mine[-1]], dtype=float), strict=True))
        lines = []
        for name, key, unit in (("mass", "mass", "kg"), ("friction", "friction_x", "N")):
            truth = f", true {_short(true[key])}" if key in true else ""
            lines.append(f"{name} {_short(now[f'{key}_low'])} to {_short(now[f'{key}_high'])} {unit}{truth}")
        return lines


def _short(value: float) -> str:
    """A number with two significant digits, without an exponent."""
    return f"{float(f'{value:.2g}'):.6g}"


def _polyline(points: np.ndarray, colour: str, radius: float) -> list[Mark]:
    raised = [[float(x), float(y), _FLOOR] for x, y in np.asarray(points, dtype=float)[:, :2] if np.isfinite(x + y)]
    # Nearly equal points have no direction.
    pairs = [(a, b) for a, b in pairwise(raised) if np.hypot(a[0] - b[0], a[1] - b[1]) > 1e-3]
    return [Mark("ribbon", a, b, radius, (*to_rgb(colour), 1.0)) for a, b in pairs]


def _labelled(shot: Shot, labels: list[Label], *, pushing: bool) -> np.ndarray:
    """The image with its labels, each beside its place and within the image, and a legend."""
    image = Image.fromarray(shot.image)
    draw = ImageDraw.Draw(image)
    for label in labels:
        x, y = shot.pixels(label.place)
        if not (-80 < x < image.width + 80 and -20 < y < image.height + 20):
            continue
        tag = _tag(label.lines, label.colour)
        side = _ASIDE + np.array(tag.size)
        corner = np.array([x, y]) + (_ASIDE if label.below else -side)
        left, top = np.clip(corner, _EDGE, np.array(image.size) - tag.size - _EDGE)
        end = (left + 8, top + 2) if label.below else (left + tag.width - 8, top + tag.height - 2)
        draw.line([(x, y), end], fill=label.colour, width=2)
        image.paste(tag, (round(left), round(top)), tag)
    legend = _legend(pushing)
    image.paste(legend, (_EDGE, _EDGE), legend)
    return np.asarray(image)


@cache
def _tag(lines: tuple[str, ...], colour: str) -> Image.Image:
    """A label as an RGBA image."""
    fonts = [font(18, bold=True), *[font(15)] * (len(lines) - 1)]
    width = round(max(f.getlength(text) for f, text in zip(fonts, lines, strict=True))) + 2 * _EDGE + 2
    tag = Image.new("RGBA", (width, 23 + 19 * (len(lines) - 1) + _EDGE))
    draw = ImageDraw.Draw(tag)
    draw.rounded_rectangle([0, 0, tag.width - 1, tag.height - 1], 6, (255, 255, 255, 230), colour, width=2)
    for row, (f, text) in enumerate(zip(fonts, lines, strict=True)):
        draw.text((_EDGE + 1, 3 + (0 if row == 0 else 3 + 19 * row)), text, fill="#1f2430", font=f)
    return tag


@cache
def _legend(pushing: bool) -> Image.Image:
    """What the colours of the lines mean, as an RGBA image. An object that is pushed to a pose has no path."""
    names = {"decision": "force of the hands, next place of the object"}
    if not pushing:
        names = {"plan": "planned path", "rollout": "predicted pushes"} | names
    image = Image.new("RGBA", (_EDGE + round(max(map(font(14).getlength, names.values()))) + 36, 20 * len(names) + 6))
    draw = ImageDraw.Draw(image)
    draw.rounded_rectangle([0, 0, image.width - 1, image.height - 1], 6, (255, 255, 255, 200))
    for row, (colour, name) in enumerate(names.items()):
        draw.line([(_EDGE, 13 + 20 * row), (_EDGE + 20, 13 + 20 * row)], fill=COLOURS[colour], width=4)
        draw.text((_EDGE + 27, 4 + 20 * row), name, fill="#1f2430", font=font(14))
    return image
