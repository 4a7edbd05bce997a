"""Draw the scenes of training clips: seeds are drawn until features show a usable scene."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from .card import COMPOSED, GENERATED
from .frames import calibrate, features, uncovered
from .options import ClipOptions
from .scenes import procedural, wide
from .scenes.assets import read_library
from .scenes.composed import compose
from .scenes.dress import dress
from .scenes.file import open_file
from .scenes.pictures import find_pictures, hang
from .scenes.procedural import log_uniform
from .scenes.scene import Scene
from .scenes.sunlit import sunlit
from .scenes.takes import compose_take, film_take
from .stage import Stage
from .windows import Survey, candidates, mean, survey

SCENE_SHARE = 0.5  # of the scenes that come from --scenes, where that is given,
FILE_SHARE = 0.33  # and in sets with assets
VIEWS = ((720, 1280), (810, 1440), (900, 1600), (1080, 1920))  # pictures with assets, smallest first: height, width
MAX_TAKES = 4  # drawings of a take; the last one is taken if it shows anything
MAX_ATTEMPTS = {1: 12, 2: 8, 3: 8}  # drawings of a generator's scene; the last one is taken as it is
HELD_OUT = range(2_000_000, 2_000_100)  # seeds of generated scenes to evaluate on: no training set draws them
MIN_UNCOVERED = 0.015  # share of uncovered pixels, mean over a clip of generator 1 whose kind uncovers
MIN_UNCOVERED_IN_WINDOW = {"uncovering": 0.015, "entering": 0.01, "dark to light": 0.01}  # in the best one, by kind


# --- generator 1 ------------------------------------------------------------------------------------------------------


def probe(stage: Stage, frames: int) -> dict[str, float]:
    """Facts of a clip from its first hits alone, at 64×64.

    `uncovered`: share of pixels that were hidden in the previous frame, mean over the frames, 0 for one; `sky`: share
    of pixels without a hit; `near`: distance of the nearest twentieth; `speed`: of the fastest hundredth, in widths a
    frame.
    """
    size = (64, 64)
    seen = [features(stage, n, size) for n in range(frames)]
    one_pixel = size[1] / procedural.PIXELS
    shares = [uncovered(b["motion"], a["motion_next"], one_pixel).mean() for a, b in pairwise(seen)]
    depth = np.concatenate([f["depth"].ravel() for f in seen])
    speed = np.concatenate([np.linalg.norm(f["motion"], axis=-1).ravel() for f in seen]) / size[1]
    return {
        "uncovered": mean(np.array(shares)),
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
        wanted = MIN_UNCOVERED if facts["kind"] == "uncovering" and frames > 1 else 0.0
        good = facts["uncovered"] >= wanted and facts["sky"] < 0.75 and facts["near"] > 0.3 and facts["speed"] < 0.25
        last = attempt == MAX_ATTEMPTS[1] - 1
        if good or last:
            facts |= calibrate(stage, facts["brightness"], frames // 2)
            if (facts["evenness"] > 0.12 and facts["noise"] < 5.5) or last:
                return stage, facts
    raise AssertionError("unreachable")


# --- takes ------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Take:
    """A scene that is loaded, exposed and surveyed, ready for windows to be cut from its picture."""

    stage: Stage
    found: Survey
    view: tuple[int, int]  # height, width of the picture
    frames: int  # of every clip, the lead-in included
    facts: dict


def draw_takes(group: int, options: ClipOptions, wanted: Collection[int]) -> Iterator[tuple[int, Take]]:
    """Yield (k, take) for those takes of scene number `group` that are wanted; the scene is loaded once."""
    rng = np.random.default_rng([options.seed, group])
    if options.assets:
        yield from _draw_assets(group, options, wanted, rng)
        return
    calm = options.calm > 0 and bool(rng.uniform() < options.calm)
    from_file = options.scenes and rng.uniform() < SCENE_SHARE
    draw = _draw_file if from_file else _draw_generated
    if take := draw(group, options, calm, rng):
        yield 0, take


def _draw_assets(
    group: int, options: ClipOptions, wanted: Collection[int], rng: np.random.Generator
) -> Iterator[tuple[int, Take]]:
    """Takes of a composition of assets, or of a scene file with other cameras, in large pictures."""
    if options.scenes and rng.uniform() < FILE_SHARE:
        file, motion = options.scenes[rng.integers(len(options.scenes))]
        scene = open_file(Path(file), motion or None)
        stage, facts = Stage(scene), scene.facts | _source(file, scene)

        def direct(rng, frames: int, width: int) -> Scene:
            return film_take(scene, stage.mitsuba, rng, frames, width)
    else:
        composition = compose(read_library(options.assets, options.allow_unlicensed), int(rng.integers(1 << 31)))
        stage, facts = Stage(composition.scene), composition.scene.facts | {"source": COMPOSED}

        def direct(rng, frames: int, width: int) -> Scene | None:
            return compose_take(composition, stage.mitsuba, rng, frames, width)

    for k in sorted(wanted):
        rng = np.random.default_rng([options.seed, group, 3, k + 1])
        view = VIEWS[rng.integers(len(VIEWS))]
        frames = options.length if options.frames_are_given else _draw_length(rng)
        for attempt in range(MAX_TAKES):
            scene = direct(rng, frames, view[1])
            if scene is None:
                break  # nothing can be seen here
            found = survey(stage.direct(scene), frames, view)
            stage.exposure = 1.0
            light = calibrate(stage, log_uniform(rng, 0.1, 1.0), frames // 2)
            if attempt == MAX_TAKES - 1 or (found.sky < 0.7 and light["evenness"] > 0.04 and light["noise"] < 40):
                if np.isfinite(light["noise"]):
                    yield k, Take(stage, found, view, frames, facts | light | {"scene": group, "take": k})
                break


def _draw_length(rng: np.random.Generator) -> int:
    """Frames of the clips of a take."""
    return int(rng.integers(8, 11)) if rng.uniform() < 0.85 else int(rng.choice([16, 20, 24, 32]))


def _source(file: str, scene: Scene) -> dict:
    """Where a scene file comes from, for the card."""
    licence = Path(file).with_name("LICENSE.txt")
    text = licence.read_text(encoding="utf-8", errors="replace") if licence.is_file() else ""
    return {"source": scene.name, "licence": text, "kind": "scene file", "place": scene.name}


def _draw_file(group: int, options: ClipOptions, calm: bool, rng: np.random.Generator) -> Take | None:
    """One of the scene files; unless it is calm, with further objects that cross the view. None where it is dark."""
    file, motion = options.scenes[rng.integers(len(options.scenes))]
    frames = options.filmed
    opened = open_file(Path(file), motion or None)
    scene = _papered(_at_rest(opened) if calm else dress(opened, rng, frames), options, group)
    stage = Stage(scene)
    found = survey(stage, frames, options.view)
    if not np.isfinite(calibrate(stage, scene.facts.get("brightness", 0.5), frames // 2)["noise"]):
        return None
    facts = scene.facts | _source(file, scene) | ({"kind": "calm scene file"} if calm else {})
    return Take(stage, found, options.view, options.length, facts)


def _draw_generated(group: int, options: ClipOptions, calm: bool, rng: np.random.Generator) -> Take:
    """A scene of `wide`, with a sun in some: the first attempt that shows something, near enough and well lit."""
    seed, frames = scene_seed(rng), options.filmed
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
        most = max(w.uncovered for w in candidates(found, options.size, options.length))
        wanted = MIN_UNCOVERED_IN_WINDOW.get(scene.facts["kind"], 0.0)
        if last or (found.sky < 0.75 and found.near > 0.3 and most >= wanted):
            light = calibrate(stage, scene.facts["brightness"], frames // 2)
            if last or (light["evenness"] > 0.08 and light["noise"] < 8):
                facts = scene.facts | light | {"source": GENERATED, "scene_seed": seed}
                return Take(stage, found, options.view, options.length, facts)
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
