"""From a scene and its motions to frames: one-sample path tracing, noise-free features, motion both ways, references.

Layers are numpy float32 `[H, W, C]`, row 0 on top. All noisy layers of a frame share their primary rays, which are
jittered uniformly inside the pixel (box filter). With several samples a pixel, radiance, albedo and normal are means;
depth, position, id and both motions are those of the first sample, because a mean of two surfaces lies on neither.
Light is called indirect after two and more surface bounces; `tracing.py` has the details and the albedo of
surfaces that are not diffuse; that of lamps and sky is their radiance, clipped to [0, 1].
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from .. import motion
from ..data import scene_motion
from ..errors import InputError
from ..files import write_atomically
from .scenes.scene import Scene
from .stage import Stage, start_mitsuba

WAVEFRONT = 1 << 21  # rays in flight; bounds memory
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
NOISY, FIRST_HALF, SECOND_HALF, PROBE = range(4)  # random streams of a frame
LAYERS = (
    "color", "indirect", "albedo", "normal", "depth", "motion", "motion_next", "position", "id",
    "reference", "indirect_reference", "half_reference", "half_indirect_reference",
)  # fmt: skip


@dataclass(frozen=True)
class RenderOptions:
    """What is rendered for every frame."""

    size: tuple[int, int] = (180, 320)  # height, width
    spp: int = 1  # samples per pixel of the noisy frames
    reference_spp: int = 256  # of the references, both halves together; 0: no references
    max_depth: int = 6  # path edges, the one to the camera included
    seed: int = 0  # of the noise; the scene has its own


# --- motion -----------------------------------------------------------------------------------------------------------


def describe_frame(scene: Scene, number: int, size: tuple[int, int]) -> dict:
    """The cameras and transforms of a frame, as an entry of `scene.json`; matrices are float64 arrays."""
    camera = scene.camera(number)
    return {
        "number": number,
        "world_to_pixel": camera.world_to_pixel(size),
        "camera_origin": camera.to_world[:3, 3],
        "shot": camera.shot,
        "object_to_world": {o.id: o.motion(number) for o in scene.objects if o.motion is not None},
    }


def motion_between(position: np.ndarray, id: np.ndarray, frame_i: dict, frame_j: dict) -> np.ndarray:
    """`scene_motion.motion_between` from frame i to frame j for one image: [H, W, 3], [H, W, 1] to [H, W, 2]."""
    planes = scene_motion.motion_between(np.moveaxis(position, 2, 0), np.moveaxis(id, 2, 0), frame_i, frame_j)
    return np.ascontiguousarray(np.moveaxis(planes, 0, 2))


def uncovered(motion_now: np.ndarray, previous_motion_next: np.ndarray, threshold: float = 1.0) -> np.ndarray:
    """[H, W] bool: `rtdenoise.motion.occlusion_mask` by the motion of a frame and `motion_next` of the one before."""
    now = _tensor(motion_now)
    return _array(motion.occlusion_mask(motion.dual_motion(now, _tensor(previous_motion_next)), now, threshold))[..., 0]


def _tensor(image: np.ndarray) -> torch.Tensor:
    return torch.from_numpy(image).permute(2, 0, 1)[None]


def _array(image: torch.Tensor) -> np.ndarray:
    return np.ascontiguousarray(image[0].permute(1, 2, 0).numpy())


# --- frames -----------------------------------------------------------------------------------------------------------


def _stream(*key: int) -> int:
    """A 32-bit seed that is different for every key."""
    return int(np.random.SeedSequence(key).generate_state(1)[0])


def _image(value, size, spp: int, first: bool = False) -> np.ndarray:
    """A wavefront value as [H, W, C] float32: the mean over a pixel's samples, or the first of them."""
    array = np.array(value, np.float32)
    array = array.T if array.ndim == 2 else array[:, None]
    array = array.reshape(*size, spp, -1)
    return np.ascontiguousarray(array[:, :, 0] if first else array.mean(2, dtype=np.float64).astype(np.float32))


def features(stage: Stage, number: int, size, spp: int = 1, seed: int = 0) -> dict[str, np.ndarray]:
    """The layers that need no light transport, both motions included, and `emission`; nothing is traced further."""
    start_mitsuba()
    from . import tracing

    stage.at(number)
    camera = stage.scene.camera(number)
    sampler = tracing.make_sampler(_stream(seed, number, NOISY), size[0] * size[1] * spp)
    ray = tracing.primary_rays(sampler, size, spp, camera.world_from_pixel(size))
    hit = tracing.first_hit(stage.mitsuba, ray, sampler, stage.object_ids)
    layers = {k: _image(hit[k], size, spp) for k in ("albedo", "normal", "emission")}
    layers |= {k: _image(hit[k], size, spp, first=True) for k in ("depth", "position", "id")}
    layers["emission"] *= stage.exposure
    layers["albedo"] = np.clip(np.maximum(layers["albedo"], layers["emission"]), 0, 1)
    frames = {n: describe_frame(stage.scene, n, size) for n in (number - 1, number, number + 1)}
    for layer, other in (("motion", number - 1), ("motion_next", number + 1)):
        layers[layer] = motion_between(layers["position"], layers["id"], frames[number], frames[other])
    return layers


def radiance(stage: Stage, number: int, size, spp: int, seed: int, stream: int, max_depth: int):
    """(beauty, indirect), [H, W, 3] each, from `spp` samples a pixel; long jobs run in pieces of bounded memory."""
    mi = start_mitsuba()
    import drjit as dr

    from . import tracing

    stage.at(number)
    lens = stage.scene.camera(number).world_from_pixel(size)
    pieces = int(np.ceil(spp * size[0] * size[1] / WAVEFRONT))
    total = np.zeros((2, *size, 3))
    for piece, samples in enumerate(np.diff(np.linspace(0, spp, pieces + 1).astype(int))):
        key = (seed, number, stream) if piece == 0 else (seed, number, stream, piece)
        sampler = tracing.make_sampler(_stream(*key), int(size[0] * size[1] * samples))
        ray = tracing.primary_rays(sampler, size, int(samples), lens)
        light = tracing.trace(stage.mitsuba, sampler, ray, max_depth)
        dr.eval(light)  # once: the sums below would trace every channel anew
        if samples > 1:
            light = [mi.Color3f(*(dr.block_sum(channel, int(samples)) for channel in part)) for part in light]
        total += [np.array(part).T.reshape(*size, 3) for part in light]
    direct, indirect = (total * stage.exposure / spp).astype(np.float32)
    return direct + indirect, indirect


def render_frame(stage: Stage, number: int, options: RenderOptions) -> dict[str, np.ndarray]:
    """All layers of one frame."""
    size, seed, depth = options.size, options.seed, options.max_depth
    layers = features(stage, number, size, options.spp, seed)
    del layers["emission"]
    layers["color"], layers["indirect"] = radiance(stage, number, size, options.spp, seed, NOISY, depth)
    if options.reference_spp:
        half = max(options.reference_spp // 2, 1)
        first = radiance(stage, number, size, half, seed, FIRST_HALF, depth)
        second = radiance(stage, number, size, half, seed, SECOND_HALF, depth)
        for name, a, b in zip(("reference", "indirect_reference"), first, second, strict=True):
            layers[name], layers[f"half_{name}"] = (a + b) / 2, a
    return layers


def calibrate(stage: Stage, brightness: float, number: int = 0) -> dict[str, float]:
    """Set the exposure so that what lamps and sky shine on has this mean luminance. Returns

    `evenness`: the median over the mean luminance; `noise`: the relative squared error that one sample a pixel has.
    """
    size, samples = (48, 48), 16
    emission = features(stage, number, size)["emission"].sum(-1)
    halves = [radiance(stage, number, size, samples, k, PROBE, 6)[0] @ LUMINANCE for k in range(2)]
    a, b = (half[emission == 0] for half in halves)
    mean = float(np.mean((a + b) / 2)) if a.size else 0.0
    if mean <= 0:
        return {"evenness": 0.0, "noise": np.inf}
    stage.exposure *= brightness / mean
    relative = (a - b) ** 2 / 2 / (((a + b) / 2) ** 2 + (0.1 * mean) ** 2)
    return {"evenness": float(np.median(a + b) / 2 / mean), "noise": float(relative.mean() * samples)}


# --- sequences --------------------------------------------------------------------------------------------------------


def write_scene_json(scene: Scene, path: Path, numbers: range, size: tuple[int, int]) -> None:
    """Cameras and transforms of these frames and of one more at either end, beside those that the file has already.

    Raises InputError where the file is of another scene, or of this one moved otherwise.
    """
    frames = [describe_frame(scene, n, size) for n in range(numbers[0] - 1, numbers[-1] + 2)]
    document = {
        "format": "rtdenoise-scene-1",
        "width": size[1],
        "height": size[0],
        "objects": {str(o.id): o.name for o in scene.objects},
        "frames": [
            {
                "number": f["number"],
                "world_to_pixel": f["world_to_pixel"].tolist(),
                "camera_origin": f["camera_origin"].tolist(),
                "shot": f["shot"],
                "object_to_world": {str(k): m.tolist() for k, m in f["object_to_world"].items()},
            }
            for f in frames
        ],
    }
    if path.exists():
        document["frames"] = _joined(path, json.loads(path.read_text()), document)
    write_atomically(path, json.dumps(document).encode())


def _joined(path: Path, before: dict, now: dict) -> list[dict]:
    """The frames of both, in order."""
    entries = {entry["number"]: entry for entry in now["frames"]}
    kept = {entry["number"]: entry for entry in before["frames"]}
    same = all(before[key] == now[key] for key in now if key != "frames")
    if not same or any(entries[number] != kept[number] for number in entries.keys() & kept.keys()):
        raise InputError(f"{path}: is of another scene, motion or size; frames of two would be mixed up: choose "
                         "another --out")  # fmt: skip
    return [entry for _, entry in sorted((kept | entries).items())]


def render_sequence(
    scene: Scene, out: str | Path, frames: int, options: RenderOptions, first: int = 0, progress=print
) -> list[Path]:
    """Render frames first … first + frames − 1 to OUT/frame.NNNN.exr, with `scene.json` beside them.

    Frames that are there already are kept: an interrupted run continues where it stopped.
    """
    from ..data.exr import write_layers

    out = Path(out)
    out.mkdir(parents=True, exist_ok=True)
    numbers = range(first, first + frames)
    write_scene_json(scene, out / "scene.json", numbers, options.size)
    paths = {n: out / f"frame.{n:04d}.exr" for n in numbers}
    missing = [n for n in numbers if not paths[n].exists()]
    stage = Stage(scene) if missing else None
    for n in missing:
        layers = render_frame(stage, n, options)
        write_layers(paths[n], {k: layers[k] for k in LAYERS if k in layers})
        progress(f"{paths[n]}")
    return list(paths.values())
