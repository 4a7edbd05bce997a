"""Draw the scenes of training clips: seeds are drawn until a scene is fit to be seen, judged from features alone."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from .card import GENERATED
from .frames import calibrate, features, uncovered
from .options import ClipOptions
from .scenes import procedural, wide
from .scenes.dress import dress
from .scenes.file import open_file
from .scenes.pictures import find_pictures, hang
from .scenes.scene import Scene
from .scenes.sunlit import sunlit
from .stage import Stage
from .windows import Survey, candidates, survey

SCENE_SHARE = 0.5  # of the scenes that come from --scenes, where that is given
MAX_ATTEMPTS = {1: 12, 2: 8, 3: 8}  # drawings of a generator's scene; the last one is taken as it is
HELD_OUT = range(2_000_000, 2_000_100)  # seeds of generated scenes to evaluate on: no training set draws them
MIN_UNCOVERED = 0.015  # share of pixels, mean over a clip of generator 1 that is meant to uncover
MIN_UNCOVERED_IN_WINDOW = {"uncovering": 0.015, "entering": 0.01, "dark to light": 0.01}  # in the best one, by kind


# --- generator 1 ------------------------------------------------------------------------------------------------------


def probe(stage: Stage, frames: int) -> dict[str, float]:
    """Facts of a clip from its first hits alone, at 64×64.

    `uncovered`: share of pixels that were hidden in the previous frame, mean over the frames; `sky`: share of pixels
    without a hit; `near`: distance of the nearest twentieth; `speed`: of the fastest hundredth, in widths a frame.
    """
    size = (64, 64)
    seen = [features(stage, n, size) for n in range(frames)]
    one_pixel = size[1] / procedural.PIXELS
    shares = [uncovered(b["motion"], a["motion_next"], one_pixel).mean() for a, b in pairwise(seen)]
    depth = np.concatenate([f["depth"].ravel() for f in seen])
    speed = np.concatenate([np.linalg.norm(f["motion"], axis=-1).ravel() for f in seen]) / size[1]
    return {
        "uncovered": float(np.mean(shares)),
        "sky": float((depth == 0).mean()),
        "near": float(np.quantile(depth[depth > 0], 0.05)) if (depth > 0).any() else 0.0,
        "speed": float(np.quantile(speed, 0.99)),
    }


def draw_first(seed: int, frames: int = procedural.CLIP_FRAMES) -> tuple[Stage, dict]:
    """The first drawing of a seed's scene that makes a good clip, loaded and exposed, and its facts."""
    for attempt in range(MAX_ATTEMPTS[1]):
        scene = procedural.procedural(seed, attempt)
        stage = Stage(scene)
        facts = scene.facts | probe(stage, frames)
        wanted = MIN_UNCOVERED if facts["kind"] == "uncovering" else 0.0
        good = facts["uncovered"] >= wanted and facts["sky"] < 0.75 and facts["near"] > 0.3 and facts["speed"] < 0.25
        last = attempt == MAX_ATTEMPTS[1] - 1
        if good or last:
            facts |= calibrate(stage, facts["brightness"], frames // 2)
            if (facts["evenness"] > 0.12 and facts["noise"] < 5.5) or last:
                return stage, facts
    raise AssertionError("unreachable")


# --- windows ----------------------------------------------------------------------------------------------------------


def draw_scene(group: int, options: ClipOptions) -> tuple[Stage, Survey, dict]:
    """Scene number `group` of a set, loaded, exposed and surveyed, and its facts."""
    rng = np.random.default_rng([options.seed, group])
    calm = options.calm > 0 and bool(rng.uniform() < options.calm)
    if options.scenes and rng.uniform() < SCENE_SHARE:
        return _draw_file(group, options, calm, rng)
    return _draw_generated(group, options, calm, rng)


def _draw_file(group: int, options: ClipOptions, calm: bool, rng: np.random.Generator) -> tuple[Stage, Survey, dict]:
    """One of the scene files; unless it is calm, with objects more that cross the view."""
    file, motion = options.scenes[rng.integers(len(options.scenes))]
    frames = 2 * options.frames
    opened = open_file(Path(file), motion or None)
    scene = _papered(_at_rest(opened) if calm else dress(opened, rng, frames), options, group)
    stage = Stage(scene)
    found = survey(stage, frames, options.view)
    calibrate(stage, scene.facts.get("brightness", 0.5), frames // 2)
    licence = Path(file).with_name("LICENSE.txt")
    facts = {"source": scene.name, "licence": licence.read_text() if licence.is_file() else ""}
    return stage, found, scene.facts | facts | {"kind": "calm scene file" if calm else "scene file",
                                                "place": scene.name}  # fmt: skip


def _draw_generated(
    group: int, options: ClipOptions, calm: bool, rng: np.random.Generator
) -> tuple[Stage, Survey, dict]:
    """A scene of `wide`, with a sun in some: the first attempt that shows something, near enough and well lit."""
    seed, frames = scene_seed(rng), 2 * options.frames
    sunny = rng.uniform() < options.sun
    attempts = MAX_ATTEMPTS[options.generator]
    for attempt in range(attempts):
        scene = wide.procedural(seed, attempt, frames, options.view[1], options.generator, calm)
        if sunny:
            scene = sunlit(scene, np.random.default_rng([options.seed, group, 1, attempt + 1]))
        scene = _papered(scene, options, group, attempt)
        stage = Stage(scene)
        found = survey(stage, frames, options.view)
        last = attempt == attempts - 1
        most = max(w.uncovered for w in candidates(found, options.size, options.frames))
        wanted = MIN_UNCOVERED_IN_WINDOW.get(scene.facts["kind"], 0.0)
        if last or (found.sky < 0.75 and found.near > 0.3 and most >= wanted):
            light = calibrate(stage, scene.facts["brightness"], frames // 2)
            if last or (light["evenness"] > 0.08 and light["noise"] < 8):
                return stage, found, scene.facts | light | {"source": GENERATED, "scene_seed": seed}
    raise AssertionError("unreachable")


def scene_seed(rng: np.random.Generator) -> int:
    """The seed of a generated scene, never a held-out one."""
    seed = int(rng.integers(1 << 31))
    return seed + len(HELD_OUT) if seed in HELD_OUT else seed


def _at_rest(scene: Scene) -> Scene:
    """The scene with objects that stand still; the camera keeps its path."""
    return replace(scene, objects=tuple(replace(o, motion=None) for o in scene.objects))


def _papered(scene: Scene, options: ClipOptions, group: int, attempt: int = 0) -> Scene:
    """The scene with pictures on some surfaces; they have random numbers of their own, so nothing else changes."""
    if not options.textures:
        return scene
    return hang(scene, find_pictures(options.textures), np.random.default_rng([options.seed, group, 2, attempt + 1]))
