"""Render clips for combiners: the same frames at several sample counts.

python bench/combine_clips.py --out DIR --scenes SCENES [--motions examples/motions] [--held-out]

DIR/spp01, DIR/spp02 ... hold a clip file each for every window of a scene; half of the scenes are files, half are
generated. Sample counts are nested: the frame at 4 spp is the mean of the first 4 samples of the frame at 32. Its
reference is the mean of all others (all but one, where they are odd), in two halves, and not cleaned: a combiner that
trains against references cleaned by a denoiser learns to return that denoiser's frames. With --held-out the clips show
the scene files that training leaves out. Run again, it goes on where it stopped. `rtdenoise estimates DIR/spp*`
denoises them.
"""

from __future__ import annotations

import gc
import sys
import time
from dataclasses import replace
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))  # this checkout, whatever rtdenoise is installed
from bench import harness

# isort: split
import numpy as np

from rtdenoise.data.clip_file import clip_path, read_facts, write_clip
from rtdenoise.errors import InputError
from rtdenoise.render import draw
from rtdenoise.render.frames import describe_frame, motion_between, samples_of
from rtdenoise.render.options import ClipOptions, find_scenes
from rtdenoise.render.stage import Stage, start_mitsuba
from rtdenoise.render.streams import NOISY, stream_seed
from rtdenoise.render.windows import candidates, choose, look_through

HELD_OUT = ("street", "dining-room", "staircase2", "bathroom")
ACTIVE_SHARE = 0.5  # of the windows, chosen for activity; the others are random


def render_levels(stage: Stage, number: int, levels: tuple[int, ...], half: int, options: ClipOptions) -> dict:
    """Sample count -> all layers of frame `number`, [H, W, C] float32.

    One wavefront traces every sample of the frame, max(levels) + 2 · half a pixel. The first ones are the noisy frame,
    all others its reference.
    """
    start_mitsuba()
    import drjit as dr

    from rtdenoise.render import tracing

    stage.at(number)
    size, total = options.size, levels[-1] + 2 * half
    camera = stage.scene.camera(number)
    sampler = tracing.make_sampler(stream_seed(options.seed, number, NOISY), size[0] * size[1] * total)
    ray = tracing.primary_rays(sampler, size, total, camera)
    hit = tracing.first_hit(stage.mitsuba, ray, sampler, stage.object_ids, stage.holes)
    light = tracing.trace(stage.mitsuba, sampler, ray, options.max_depth, stage.holes)
    dr.eval(hit, light)
    direct, indirect = (samples_of(part, size, total) * stage.exposure for part in light)
    color = direct + indirect
    emission = samples_of(hit["emission"], size, total) * stage.exposure
    albedo, normal = (samples_of(hit[name], size, total) for name in ("albedo", "normal"))
    shared = {k: samples_of(hit[k], size, total)[:, :, 0] for k in ("depth", "position", "id")}
    frames = {n: describe_frame(stage.scene, n, size) for n in (number - 1, number, number + 1)}
    for layer, other in (("motion", number - 1), ("motion_next", number + 1)):
        shared[layer] = motion_between(shared["position"], shared["id"], frames[number], frames[other])
    found = {}
    for spp in levels:
        seen = np.maximum(albedo[:, :, :spp].mean(2), emission[:, :, :spp].mean(2))
        rest = halves(levels, half, spp)
        found[spp] = shared | {
            "reference": color[:, :, -2 * rest :].mean(2), "reference_half": color[:, :, -rest:].mean(2),
            "indirect_reference": indirect[:, :, -2 * rest :].mean(2),
            "indirect_reference_half": indirect[:, :, -rest:].mean(2),
            "color": color[:, :, :spp].mean(2), "indirect": indirect[:, :, :spp].mean(2),
            "albedo": np.clip(seen, 0, 1), "normal": normal[:, :, :spp].mean(2),
            "samples": np.full((*size, 1), spp, np.float32),
        }  # fmt: skip
    return found


def halves(levels: tuple[int, ...], half: int, spp: int) -> int:
    """Samples a pixel in each half of the reference of the noisy frame at `spp`."""
    return (levels[-1] + 2 * half - spp) // 2


def facts_of(levels: tuple[int, ...], half: int, spp: int, options: ClipOptions) -> dict:
    """What the options say of every clip at `spp`."""
    return {
        "generator": options.generator, "seed": options.seed, "frames": options.frames, "size": list(options.size),
        "max_depth": options.max_depth, "spp": spp, "reference_spp": 2 * halves(levels, half, spp),
    }  # fmt: skip


def refuse_other_options(out: Path, levels: tuple[int, ...], half: int, options: ClipOptions) -> None:
    """Raise InputError where a folder holds clips made with other options. One clip of each level is compared."""
    for spp in levels:
        for path in sorted((out / f"spp{spp:02d}").glob("clip_*.safetensors"))[:1]:
            found = read_facts(path)
            for name, value in facts_of(levels, half, spp, options).items():
                if found.get(name) != value:
                    raise InputError(f"{path}: was rendered with {name} = {found.get(name)}, not {value}; choose "
                                     "another --out or the options of that run")  # fmt: skip


def render_scene(
    out: Path, group: int, each: int, levels: tuple[int, ...], half: int, options: ClipOptions, held: bool
) -> None:
    """Render the missing ones of `each` clips of scene number `group`; a held-out scene is the file of that number."""
    members = range(group * each, (group + 1) * each)
    if all(clip_path(out / f"spp{levels[-1]:02d}", i).exists() for i in members):
        return
    if held:
        rng = np.random.default_rng([options.seed, group])
        take = draw._draw_file(group, replace(options, scenes=(options.scenes[group],)), False, rng)
    else:
        take = next((take for _, take in draw.draw_takes(group, options, [0])), None)
        if take is None:
            print(f"scene {group}: nothing can be seen", flush=True)
            return
    stage, facts = take.stage, take.facts
    whole, windows, taken = stage.scene, candidates(take.found, options.size, options.frames), []
    for index in members:
        clock = time.time()
        rng = np.random.default_rng([options.seed, group, index])
        window = choose(windows, taken, options.size, options.frames, bool(rng.uniform() < ACTIVE_SHARE), rng)
        taken.append(window)
        stage.scene = whole
        look_through(stage, window, take.view)
        seeded = replace(options, seed=int(np.random.SeedSequence([options.seed, index]).generate_state(1)[0]))
        numbers = range(window.first, window.first + options.frames)
        frames = [render_levels(stage, n, levels, half, seeded) for n in numbers]
        for spp in levels:
            path = clip_path(out / f"spp{spp:02d}", index)
            path.parent.mkdir(exist_ok=True)
            write_clip(
                path,
                [frame[spp] for frame in frames],
                facts | {"index": index} | facts_of(levels, half, spp, options),
                ["samples"],
            )
        print(f"clip {index}: {facts['kind']}, {facts.get('place', '')}, {time.time() - clock:.1f} s", flush=True)
    del stage, take
    gc.collect()  # Mitsuba scenes are cycles; a left-over one would be part of the next one's kernels


def main(
    out: Path,
    scenes: Path | None = None,
    motions: Path | None = None,
    held_out: bool = False,
    count: int = 80,
    size: int = 128,
    frames: int = 7,
    levels: tuple[int, ...] = (1, 2, 4, 8, 16, 32),
    half: int = 12,
    seed: int = 21,
    windows: int = 1,
    assets: Path | None = None,
    shard: tuple[int, int] = (0, 1),
) -> None:
    """Render `count` clips.

    Args:
        out: Folder for the clips.
        scenes: Folder of NAME/scene.xml; without it all scenes are generated.
        motions: Folder of NAME.toml.
        held_out: The scenes that training leaves out, `windows` clips each, instead of all others.
        count: Number of clips.
        size: Side of a clip in pixels.
        frames: Frames of a clip.
        levels: Samples per pixel of the noisy frames, in ascending order.
        half: Half the samples per pixel that no noisy frame holds.
        seed: Of everything.
        windows: Clips of one scene.
        assets: A library, as `rtdenoise clips --assets` takes it: compositions take the place of generated scenes, and
            windows are cut from pictures of 1280×720 pixels and more.
        shard: (i, n): scenes g with g mod n = i.
    """
    if held_out and scenes is None:
        raise InputError("--held-out: goes with --scenes")
    if [*levels] != sorted({*levels}) or not levels or levels[0] < 1:
        raise InputError(f"--levels: expected counts from 1 on in ascending order, got {' '.join(map(str, levels))}")
    if min(half, windows) < 1:
        raise InputError(f"--half, --windows: expected 1 or more, got {half} and {windows}")
    files = find_scenes(scenes, motions, () if held_out else HELD_OUT) if scenes else ()
    if held_out:
        files = tuple(pair for pair in files if Path(pair[0]).parent.name in HELD_OUT)
    options = ClipOptions(count, (size, size), frames, seed, scenes=files, sun=0.3, calm=0.15, assets=str(assets or ""))
    refuse_other_options(out, levels, half, options)
    start_mitsuba(1)
    out.mkdir(parents=True, exist_ok=True)
    for group in range(len(files) if held_out else count // windows):
        if group % shard[1] == shard[0]:
            render_scene(out, group, windows, levels, half, options, held_out)


if __name__ == "__main__":
    harness.run(main, __doc__)
