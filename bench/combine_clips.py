"""Render the clips that the combiner trains on: the same frames at 1, 2, 4 ... 32 samples a pixel.

    python bench/combine_clips.py --out DIR --scenes SCENES --motions examples/motions

DIR/spp01 ... DIR/spp32 hold one clip file each for a window of a scene. Sample counts are nested: the frame at 4 spp is
the mean of the first 4 of its 32 samples. References have samples of their own, in two halves, and are not cleaned:
a combiner that trains against references cleaned by a denoiser learns to return what that denoiser makes.
"""

from __future__ import annotations

import argparse
import gc
import time
from pathlib import Path

import numpy as np

from rtdenoise.data.clips import clip_path, write_clip
from rtdenoise.render.draw import draw_scene
from rtdenoise.render.frames import _image, _stream, describe_frame, motion_between
from rtdenoise.render.options import ClipOptions, find_scenes
from rtdenoise.render.stage import Stage, start_mitsuba
from rtdenoise.render.windows import candidates, choose, look_through

LEVELS = (1, 2, 4, 8, 16, 32)  # samples per pixel of the noisy frames
HALF = 12  # samples per pixel of each half of the reference
WINDOWS = 2  # clips of one scene
HELD_OUT = ("street", "dining-room", "staircase2", "bathroom")
NOISY = 0  # random stream of a frame


def render_levels(stage: Stage, number: int, size: tuple[int, int], seed: int, max_depth: int) -> dict[int, dict]:
    """All layers of frame `number`, [H, W, C] float32, at each sample count of `LEVELS`.

    One wavefront traces every sample of the frame; its first max(LEVELS) samples are the noisy frames', the others the
    reference's two halves.
    """
    start_mitsuba()
    import drjit as dr

    from rtdenoise.render import tracing

    stage.at(number)
    noisy, total = LEVELS[-1], LEVELS[-1] + 2 * HALF
    camera = stage.scene.camera(number)
    sampler = tracing.make_sampler(_stream(seed, number, NOISY), size[0] * size[1] * total)
    ray = tracing.primary_rays(sampler, size, total, camera)
    hit = tracing.first_hit(stage.mitsuba, ray, sampler, stage.object_ids, stage.holes)
    light = tracing.trace(stage.mitsuba, sampler, ray, max_depth, stage.holes)
    dr.eval(hit, light)

    def samples(value) -> np.ndarray:  # [H, W, samples, 3]
        return np.array(value, np.float32).T.reshape(*size, total, 3)

    direct, indirect = (samples(part) * stage.exposure for part in light)
    color = direct + indirect
    emission = samples(hit["emission"]) * stage.exposure
    albedo, normal = samples(hit["albedo"]), samples(hit["normal"])
    shared = {k: _image(hit[k], size, total, first=True) for k in ("depth", "position", "id")}
    frames = {n: describe_frame(stage.scene, n, size) for n in (number - 1, number, number + 1)}
    for layer, other in (("motion", number - 1), ("motion_next", number + 1)):
        shared[layer] = motion_between(shared["position"], shared["id"], frames[number], frames[other])
    for name, image in (("reference", color), ("indirect_reference", indirect)):
        shared[name] = image[:, :, noisy:].mean(2)
        shared[f"{name}_half"] = image[:, :, noisy : noisy + HALF].mean(2)
    levels = {}
    for spp in LEVELS:
        seen = np.maximum(albedo[:, :, :spp].mean(2), emission[:, :, :spp].mean(2))
        levels[spp] = shared | {
            "color": color[:, :, :spp].mean(2), "indirect": indirect[:, :, :spp].mean(2),
            "albedo": np.clip(seen, 0, 1), "normal": normal[:, :, :spp].mean(2),
            "samples": np.full((*size, 1), spp, np.float32),
        }  # fmt: skip
    return levels


def render_scene(out: Path, group: int, options: ClipOptions) -> None:
    """Render the missing clips of scene number `group`."""
    members = range(group * WINDOWS, (group + 1) * WINDOWS)
    if all(clip_path(out / f"spp{LEVELS[-1]:02d}", i).exists() for i in members):
        return
    stage, found, facts = draw_scene(group, options)
    whole = stage.scene
    windows, taken = candidates(found, options.size, options.frames), []
    for index in members:
        clock = time.time()
        rng = np.random.default_rng([options.seed, group, index])
        window = choose(windows, taken, options.size, options.frames, bool(rng.uniform() < 0.5), rng)
        taken.append(window)
        stage.scene = whole
        look_through(stage, window, options.view)
        seed = int(np.random.SeedSequence([options.seed, index]).generate_state(1)[0])
        numbers = range(window.first, window.first + options.frames)
        frames = [render_levels(stage, n, options.size, seed, options.max_depth) for n in numbers]
        told = facts | {
            "index": index, "generator": options.generator, "seed": options.seed, "frames": options.frames,
            "size": list(options.size), "reference_spp": 2 * HALF, "max_depth": options.max_depth,
        }  # fmt: skip
        for spp in LEVELS:
            path = clip_path(out / f"spp{spp:02d}", index)
            path.parent.mkdir(exist_ok=True)
            write_clip(path, [frame[spp] for frame in frames], told | {"spp": spp}, ["samples"])
        print(f"clip {index}: {facts['kind']}, {facts.get('place', '')}, {time.time() - clock:.1f} s", flush=True)
    del stage
    gc.collect()  # Mitsuba scenes are cycles; a left-over one would be part of the next one's kernels


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--scenes", type=Path, required=True, help="folder of NAME/scene.xml")
    parser.add_argument("--motions", type=Path, help="folder of NAME.toml")
    parser.add_argument("--count", type=int, default=80, help="clips")
    parser.add_argument("--size", type=int, default=128)
    parser.add_argument("--frames", type=int, default=7)
    parser.add_argument("--seed", type=int, default=21)
    parser.add_argument("--shard", type=int, nargs=2, default=(0, 1), help="i n: scenes g with g mod n = i")
    options = parser.parse_args()
    start_mitsuba(1)
    options.out.mkdir(parents=True, exist_ok=True)
    scenes = find_scenes(options.scenes, options.motions, HELD_OUT)
    size = (options.size, options.size)
    chosen = ClipOptions(options.count, size, options.frames, options.seed, scenes=scenes, sun=0.3, calm=0.15)
    for group in range(options.count // WINDOWS):
        if group % options.shard[1] == options.shard[0]:
            render_scene(options.out, group, chosen)


if __name__ == "__main__":
    main()
