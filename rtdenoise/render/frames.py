"""All layers of one frame of a scene: noisy light, features, exact motion both ways, references.

Layers are numpy float32 `[H, W, C]`, row 0 on top. All noisy layers of a frame share their primary rays, jittered
uniformly inside the pixel (box filter). With several samples a pixel, radiance, albedo and normal are means over the
samples; depth, position, id and both motions are those of the first sample, because a mean of two surfaces lies on
neither. Light after two or more surface bounces is indirect. `tracing.py` defines the albedo of every kind of surface;
lamps and sky have their radiance, clipped to [0, 1], as albedo.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch

from .. import motion
from ..color import luminance
from ..data import scene_motion
from ..frame import OCCLUSION_THRESHOLD
from .metropolis import MetropolisOptions, metropolis
from .scenes.scene import Scene
from .stage import Stage, start_mitsuba
from .streams import FEATURES, FIRST_HALF, NOISY, PROBE, SECOND_HALF, stream_seed

MAX_RAYS = 1 << 21  # in flight at once; bounds memory
MAX_DEPTH = 6  # path edges while the exposure is measured
LAYERS = (
    "color", "indirect", "albedo", "normal", "depth", "motion", "motion_next", "position", "id",
    "reference", "indirect_reference", "reference_half", "indirect_reference_half", "large", "small", "proposals",
    "albedo_reference", "normal_reference",
)  # fmt: skip


@dataclass(frozen=True)
class RenderOptions:
    """The options of rendering a frame."""

    size: tuple[int, int] = (180, 320)  # height, width
    spp: int = 1  # samples, or mutations, per pixel of the noisy frames
    reference_spp: int = 256  # of the references, both halves together; 0: no references
    max_depth: int = 6  # path edges, the one to the camera included
    seed: int = 0  # of the noise; the scene has its own
    metropolis: MetropolisOptions | None = None  # None: path tracing
    feature_spp: int = 0  # of albedo_reference and normal_reference; 0: none


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


def uncovered(
    motion_now: np.ndarray, previous_motion_next: np.ndarray, threshold: float = OCCLUSION_THRESHOLD
) -> np.ndarray:
    """`rtdenoise.motion.occlusion_mask`, `[H, W]` bool, from a frame's motion and the `motion_next` of the frame
    before."""
    now = _tensor(motion_now)
    return _array(motion.occlusion_mask(motion.dual_motion(now, _tensor(previous_motion_next)), now, threshold))[..., 0]


def _tensor(image: np.ndarray) -> torch.Tensor:
    return torch.from_numpy(image).permute(2, 0, 1)[None]


def _array(image: torch.Tensor) -> np.ndarray:
    return np.ascontiguousarray(image[0].permute(1, 2, 0).numpy())


# --- frames -----------------------------------------------------------------------------------------------------------


def grey(image: np.ndarray) -> np.ndarray:
    """Rec. 709 luminance: [H, W, 3] to [H, W]."""
    return luminance(_tensor(image))[0, 0].numpy()


def samples_of(value, size, spp: int) -> np.ndarray:
    """A wavefront value as [H, W, spp, C] float32."""
    array = np.array(value, np.float32)
    array = array.T if array.ndim == 2 else array[:, None]
    return array.reshape(*size, spp, -1)


def _wavefronts(size, spp: int, *key: int) -> Iterator[tuple[int, int]]:
    """(seed, samples a pixel) of the pieces in which `spp` samples a pixel are traced: at most `MAX_RAYS` rays are in
    flight, or one a pixel."""
    pieces = min(int(np.ceil(spp * size[0] * size[1] / MAX_RAYS)), spp)
    for piece, samples in enumerate(np.diff(np.linspace(0, spp, pieces + 1).astype(int)).tolist()):
        yield stream_seed(*key) if piece == 0 else stream_seed(*key, piece), samples


def features(stage: Stage, number: int, size, spp: int = 1, seed: int = 0) -> dict[str, np.ndarray]:
    """The layers of the first hits alone, both motions and the radiance that the hit surfaces emit (`emission`)."""
    start_mitsuba()
    from . import tracing

    stage.at(number)
    camera = stage.scene.camera(number)
    layers: dict[str, np.ndarray] = {}
    for key, samples in _wavefronts(size, spp, seed, number, NOISY):
        sampler = tracing.make_sampler(key, size[0] * size[1] * samples)
        ray = tracing.primary_rays(sampler, size, samples, camera)
        hit = tracing.first_hit(stage.mitsuba, ray, sampler, stage.object_ids, stage.holes)
        for k in ("albedo", "normal", "emission"):
            mean = samples_of(hit[k], size, samples).mean(2, dtype=np.float64)
            layers[k] = layers.get(k, 0.0) + mean * (samples / spp)
        for k in {"depth", "position", "id"} - layers.keys():
            layers[k] = samples_of(hit[k], size, samples)[:, :, 0]
    layers = {k: np.ascontiguousarray(layer, np.float32) for k, layer in layers.items()}
    if stage.holes or camera.aperture > 0:  # rays start behind holes, or beside the middle of the lens
        distance = np.linalg.norm(layers["position"] - camera.to_world[:3, 3], axis=-1, keepdims=True)
        layers["depth"] = np.where(layers["id"] > 0, distance, 0).astype(np.float32)
    layers["emission"] *= stage.exposure
    layers["albedo"] = np.clip(np.maximum(layers["albedo"], layers["emission"]), 0, 1)
    frames = {n: describe_frame(stage.scene, n, size) for n in (number - 1, number, number + 1)}
    for layer, other in (("motion", number - 1), ("motion_next", number + 1)):
        layers[layer] = motion_between(layers["position"], layers["id"], frames[number], frames[other])
    return layers


def radiance(stage: Stage, number: int, size, spp: int, seed: int, stream: int, max_depth: int):
    """(beauty, indirect), [H, W, 3] each, from `spp` samples a pixel."""
    mi = start_mitsuba()
    import drjit as dr

    from . import tracing

    stage.at(number)
    camera = stage.scene.camera(number)
    total = np.zeros((2, *size, 3))
    for key, samples in _wavefronts(size, spp, seed, number, stream):
        sampler = tracing.make_sampler(key, size[0] * size[1] * samples)
        ray = tracing.primary_rays(sampler, size, samples, camera)
        light = tracing.trace(stage.mitsuba, sampler, ray, max_depth, stage.holes)
        dr.eval(light)  # once: the sums below would trace every channel anew
        if samples > 1:
            light = [mi.Color3f(*(dr.block_sum(channel, samples) for channel in part)) for part in light]
        total += [np.array(part).T.reshape(*size, 3) for part in light]
    direct, indirect = (total * stage.exposure / spp).astype(np.float32)
    return direct + indirect, indirect


def render_frame(
    stage: Stage, number: int, options: RenderOptions, halves: Sequence[dict[str, np.ndarray]] = ()
) -> dict[str, np.ndarray]:
    """All layers of one frame. `halves`: the `light` of its references, where that is known."""
    layers = features(stage, number, options.size, options.spp, options.seed)
    del layers["emission"]
    layers |= light(stage, number, options, options.spp, NOISY)
    if options.reference_spp:
        half = max(options.reference_spp // 2, 1)
        streams = FIRST_HALF, SECOND_HALF
        first, second = halves or (light(stage, number, options, half, stream) for stream in streams)
        for name, source in (("reference", "color"), ("indirect_reference", "indirect")):
            layers[name], layers[f"{name}_half"] = (first[source] + second[source]) / 2, first[source]
    if options.feature_spp:
        clean = features(stage, number, options.size, options.feature_spp, stream_seed(options.seed, FEATURES))
        layers |= {f"{name}_reference": clean[name] for name in ("albedo", "normal")}
    return layers


def repeat_frame(
    stage: Stage, number: int, options: RenderOptions, count: int, frame: dict[str, np.ndarray]
) -> list[dict[str, np.ndarray]]:
    """`frame` of `render_frame` as the first of `count` frames of one instant: each has noise of its own, the
    references are the same, and nothing moves."""
    held = {name: layer for name, layer in frame.items() if "reference" in name}
    seeds = (stream_seed(options.seed, NOISY, i) for i in range(1, count))
    others = (replace(options, seed=seed, reference_spp=0, feature_spp=0) for seed in seeds)
    frames = [frame, *(render_frame(stage, number, other) | held for other in others)]
    return [f | {name: np.zeros_like(f[name]) for name in ("motion", "motion_next")} for f in frames]


def light(stage: Stage, number: int, options: RenderOptions, samples: int, stream: int) -> dict[str, np.ndarray]:
    """`color` and `indirect` from `samples` samples a pixel; by Metropolis sampling also its own layers."""
    by = options.metropolis
    if by and (stream == NOISY or by.references == "pssmlt"):
        return metropolis(stage, number, options.size, samples, options.seed, stream, options.max_depth, by)[0]
    beauty, indirect = radiance(stage, number, options.size, samples, options.seed, stream, options.max_depth)
    return {"color": beauty, "indirect": indirect}


def calibrate(stage: Stage, brightness: float, number: int = 0) -> dict[str, float]:
    """Set the exposure so that the lit surfaces of frame `number` have the mean luminance `brightness`.

    Returns `evenness`, the median luminance over the mean, and `noise`, the relative squared error of one sample a
    pixel; 0 and infinity where no lit surface is seen.
    """
    size, samples = (48, 48), 16
    emission = features(stage, number, size)["emission"].sum(-1)
    halves = [grey(radiance(stage, number, size, samples, k, PROBE, MAX_DEPTH)[0]) for k in range(2)]
    a, b = (half[emission == 0] for half in halves)
    mean = float(np.mean((a + b) / 2)) if a.size else 0.0
    if mean <= 0:
        return {"evenness": 0.0, "noise": np.inf}
    stage.exposure *= brightness / mean
    relative = (a - b) ** 2 / 2 / (((a + b) / 2) ** 2 + (0.1 * mean) ** 2)
    return {"evenness": float(np.median(a + b) / 2 / mean), "noise": float(relative.mean() * samples)}
