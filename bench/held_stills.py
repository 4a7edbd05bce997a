"""Render stills of the scenes that training leaves out, for `held.py`: windows of pictures at 1280×720 and more.

python bench/held_stills.py --out DIR --scenes SCENES --assets LIBRARY [--motions examples/motions]

DIR/spp01, DIR/spp04 ... hold --count stills of every scene, each level other ones. Cameras, windows and exposures are
those of `rtdenoise clips --assets`; the library is not shown.
"""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))  # this checkout, whatever rtdenoise is installed
from bench import harness
from bench.combine_clips import HELD_OUT

# isort: split
from rtdenoise.data.clip_file import clip_path
from rtdenoise.render import draw, scene_clips
from rtdenoise.render.options import ClipOptions, find_scenes
from rtdenoise.render.stage import start_mitsuba


def main(
    out: Path,
    scenes: Path,
    assets: Path,
    motions: Path | None = None,
    levels: tuple[int, ...] = (1, 4, 16, 64),
    count: int = 3,
    size: int = 192,
    reference: tuple[int, int] = (96, 160),
    seed: int = 900,
) -> None:
    """Render what is missing.

    Args:
        out: Folder for the stills.
        scenes: Folder of NAME/scene.xml.
        assets: Library of assets, whose presence makes large pictures.
        motions: Folder of NAME.toml.
        levels: Samples a pixel of the noisy frames.
        count: Stills of each scene and level.
        size: Side of a still in pixels.
        reference: Least and most samples a pixel of a reference.
        seed: Of everything.
    """
    start_mitsuba(1)
    draw.FILE_SHARE = 1.0  # scene files alone
    scene_clips.draw_samples = lambda options, rng: options.spp
    files = [pair for pair in find_scenes(scenes, motions, ()) if Path(pair[0]).parent.name in HELD_OUT]
    for level in levels:
        folder = out / f"spp{level:02d}"
        folder.mkdir(parents=True, exist_ok=True)
        for number, file in enumerate(files):
            paths = [clip_path(folder, number * count + i) for i in range(count)]
            if all(path.exists() for path in paths):
                continue
            options = ClipOptions(
                count, (size, size), 1, seed + number + 10 * level, level, 0.01, reference, workers=1, scenes=(file,),
                assets=str(assets),
            )  # fmt: skip
            part = out / f"{level}-{number}"
            part.mkdir(exist_ok=True)
            scene_clips.render_group(part, 0, options)
            for i, path in enumerate(paths):
                clip_path(part, i).replace(path)
            part.rmdir()


if __name__ == "__main__":
    harness.run(main, __doc__)
