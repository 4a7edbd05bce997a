"""Choose scenes: draw a seed until it makes a good clip, judged cheaply, and find scenes by name."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from ..errors import InputError
from .frames import calibrate, features, uncovered
from .scenes import procedural, textures
from .scenes import wide as procedural_wide
from .scenes.extras import SHAPES, free_place
from .scenes.file import open_file
from .scenes.motions import Motion, rigid
from .scenes.pictures import find_pictures, hang
from .scenes.sample import sample
from .scenes.scene import Material, Object, Scene
from .scenes.sunlit import sunlit
from .stage import Stage

UNCOVERING = 0.015  # least share of uncovered pixels in a clip that is drawn to uncover
ATTEMPTS = 12


def open_scene(name: str, motion: str | Path | None = None, folder: str | Path | None = None) -> Scene:
    """`sample`, `procedural:SEED` or `wide:SEED` (generators 1 and 2), `sunlit:SEED` (generator 3, with a sun), or a
    Mitsuba XML file, set in motion by a TOML file. `folder` holds pictures that some surfaces of a `wide` scene get."""
    if folder and not name.startswith("wide:"):
        raise InputError(f"--textures {folder}: goes with wide:SEED or --preset train, not with '{name}'")
    if name.endswith(".xml"):
        scene = open_file(name, motion)
        return _exposed(scene) if "brightness" in scene.facts else scene
    if motion:
        raise InputError(f"{motion}: a motion file goes with a Mitsuba XML scene, not with '{name}'")
    kind, _, seed = name.partition(":")
    if name == "sample":
        return sample()
    if kind == "procedural" and seed.isdecimal():
        stage, facts = draw(int(seed))
        return replace(stage.scene, exposure=stage.exposure, facts=facts)
    if kind == "wide" and seed.isdecimal():
        scene = procedural_wide.procedural(int(seed), version=2)
        rng = np.random.default_rng([2, int(seed), 0, 0])
        return _exposed(hang(scene, find_pictures(folder), rng) if folder else scene)
    if kind == "sunlit" and seed.isdecimal():
        scene = procedural_wide.procedural(int(seed))
        return _exposed(sunlit(scene, np.random.default_rng([procedural_wide.VERSION, int(seed), 1])))
    raise InputError(f"unknown scene '{name}'; expected sample, procedural:SEED, wide:SEED or sunlit:SEED with a whole "
                     "number, or a .xml file")  # fmt: skip


def _exposed(scene: Scene) -> Scene:
    stage = Stage(scene)
    if not np.isfinite(calibrate(stage, scene.facts["brightness"])["noise"]):
        raise InputError(f"{scene.file or scene.name}: nothing lit is seen in frame 0; move the camera's start")
    return replace(scene, exposure=stage.exposure)


def probe(stage: Stage, frames: int) -> dict[str, float]:
    """Facts of a clip from its features alone, at 64×64: nothing is traced beyond the first hit.

    `uncovered`: share of pixels that were hidden in the previous frame, a mean over the frames; `sky`: share of pixels
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


def draw(seed: int, frames: int = procedural.CLIP_FRAMES) -> tuple[Stage, dict]:
    """The first drawing of a seed's scene that makes a good clip, loaded and exposed, and its facts."""
    for attempt in range(ATTEMPTS):
        scene = procedural.procedural(seed, attempt)
        stage = Stage(scene)
        facts = scene.facts | probe(stage, frames)
        wanted = UNCOVERING if facts["kind"] == "uncovering" else 0.0
        good = facts["uncovered"] >= wanted and facts["sky"] < 0.75 and facts["near"] > 0.3 and facts["speed"] < 0.25
        last = attempt == ATTEMPTS - 1
        if good or last:
            facts |= calibrate(stage, facts["brightness"], frames // 2)
            if (facts["evenness"] > 0.12 and facts["noise"] < 5.5) or last:
                return stage, facts
    raise AssertionError("unreachable")


def dress(file: Path, motion: str | None, rng: np.random.Generator, frames: int) -> Scene:
    """A scene file with its motion and one to three objects more that cross the view; for a clip of `frames`."""
    scene = open_file(file, motion)
    stage, start = Stage(scene), (frames - 1) / 2
    camera = scene.camera(start)
    right, forward, origin = (camera.to_world[:3, k] for k in (0, 2, 3))
    depth = features(stage, round(start), (48, 48))["depth"]
    unit = float(np.median(depth[depth > 0])) * np.tan(np.radians(camera.fov / 2)) if (depth > 0).any() else 1.0
    extras = []
    for _ in range(int(rng.integers(1, 4))):
        shape = SHAPES[str(rng.choice(list(SHAPES)))]
        texture = textures.poster(rng) if rng.uniform() < 0.3 else textures.surface(rng)
        kind = str(rng.choice(["diffuse", "plastic", "metal"], p=[0.7, 0.15, 0.15]))
        mesh = shape(unit * rng.uniform(0.05, 0.16))
        place = free_place(stage.mitsuba, camera, mesh, rng)
        if place is None:
            continue
        half_view = float((place - origin) @ forward) * np.tan(np.radians(camera.fov / 2))
        step = procedural.log_uniform(rng, 3, 16) * 2 * half_view / 256  # pixels a frame of a picture 256 wide
        along = right * rng.choice([-1, 1]) + rng.normal(size=3) * 0.1
        velocity = tuple((along / np.linalg.norm(along) * step).tolist())
        move = Motion(tuple(place.tolist()), start, velocity, spin=float(rng.uniform(-8, 8)))
        material = Material(np.clip(texture, 0.02, 0.92), kind, float(rng.uniform(0.15, 0.4)))
        extras.append(
            Object(
                len(scene.objects) + len(extras) + 1,
                "extra",
                mesh.transform(rigid(np.eye(3), place)),
                material,
                motion=move,
            )
        )
    return replace(scene, objects=(*scene.objects, *extras))
