"""Makes docs/figures/demo.png from the film of a run: python benchmarks/demo_figure.py runs/demo-0."""

from __future__ import annotations

import sys
from pathlib import Path

import imageio.v3 as iio
import numpy as np
from PIL import Image

from shmoo_mjx.report.trace import load_result

FPS, SPEED = 15.0, 3.0  # of episode.mp4, as run.py writes it


def main(run: Path, out: Path, width: int = 560) -> None:
    """Six frames: one second after each of the telling transitions, in two columns."""
    result = load_result(run / "result.json")
    steps = [t for t in result["transitions"] if t["to"] in ("approach", "push", "retreat", "done", "follow path")]
    times = [steps[0]["t"] + 1.0, *[t["t"] + 0.8 for t in steps if t["to"] in ("push", "retreat")][:3]]
    last = steps[-1]["t"]
    times += [last - 12.0, last]
    frames = iio.imread(run / "episode.mp4", plugin="FFMPEG")
    tiles = []
    for t in times[:6]:
        picture = Image.fromarray(frames[min(int(t / SPEED * FPS), len(frames) - 1)])
        tiles.append(np.asarray(picture.resize((width, round(picture.height * width / picture.width)))))
    rows = [np.concatenate(tiles[i : i + 2], axis=1) for i in range(0, 6, 2)]
    # 256 colours keep the file small; the renderer's surfaces are plain.
    Image.fromarray(np.concatenate(rows, axis=0)).quantize(256).save(out, optimize=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(__file__).resolve().parent.parent / "docs" / "figures" / "demo.png")
