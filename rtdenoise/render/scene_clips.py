"""The clips of one scene: load it once, choose windows with activity, render each and write it."""

from __future__ import annotations

import gc
import time
from dataclasses import replace
from importlib.metadata import PackageNotFoundError, version
from itertools import pairwise
from pathlib import Path

import numpy as np

from ..data.clip_file import LEAD_IN, clip_path, write_clip
from .draw import Take, draw_first, draw_takes, scene_seed
from .frames import MAX_RAYS, RenderOptions, calibrate, grey, light, render_frame, repeat_frame, uncovered
from .options import ClipOptions
from .scenes.caustic import caustic
from .stage import Stage
from .streams import FIRST_HALF, SECOND_HALF
from .windows import candidates, choose, look_through, mean

ACTIVE_SHARE = 0.75  # of the clips whose window is the one with most activity; the others take any window
MORE_SAMPLES = (2, 4, 8, 16, 32, 64)  # factors on the samples of half of the clips, in sets with assets
MORE_MUTATIONS = (1, 2, 4, 8)  # factors on the mutations of clips by Metropolis sampling,
PIXELS_PER_CHAIN = (4, 16)  # and pixels for every chain
FEATURE_SPP = 32  # samples a pixel of the features that references are cleaned by
PILOT_SPP = 16  # samples a pixel from which a reference's error is estimated


def render_group(out: Path, group: int, options: ClipOptions) -> list[dict]:
    """Render the missing clips of scene number `group`. Returns their facts."""
    clips = _render_whole if options.generator == 1 else _render_windows
    if options.metropolis:
        clips = _render_caustic
    try:
        return clips(out, group, options)
    finally:
        gc.collect()  # Mitsuba scenes are cycles; a left-over one would be part of the next one's kernels


def _render_whole(out: Path, index: int, options: ClipOptions) -> list[dict]:
    """The clip of a whole picture, with references of more samples in noisier scenes."""
    clock, seed = time.process_time(), options.clip_seed(index)
    stage, facts = draw_first(seed, options.frames)
    effort = np.clip(np.sqrt(facts["noise"] / 2), 0.5, 1.5)
    reference_spp = max(2 * round(options.reference_spp * effort / 2), 2)
    render = RenderOptions(options.size, options.spp, reference_spp, options.max_depth, seed)
    facts |= {"seed": seed, "index": index, "generator": 1}
    return [_render_clip(clip_path(out, index), stage, range(options.frames), facts, render, clock, options.layers)]


def _render_caustic(out: Path, index: int, options: ClipOptions) -> list[dict]:
    """The clip of a caustic scene by Metropolis sampling, with a number of mutations and a number of chains of its
    own."""
    clock, rng = time.process_time(), np.random.default_rng([options.seed, index])
    scene = caustic(scene_seed(rng), options.frames)
    stage = Stage(scene)
    light = calibrate(stage, scene.facts["brightness"], options.frames // 2)
    mutations = options.spp * int(rng.choice(MORE_MUTATIONS))
    pixels = options.size[0] * options.size[1]
    chains = options.metropolis.chains or max(pixels // int(rng.choice(PIXELS_PER_CHAIN)), 1)
    metropolis = replace(options.metropolis, chains=chains)
    seed = int(np.random.SeedSequence([options.seed, index]).generate_state(1)[0])
    render = RenderOptions(options.size, mutations, options.reference_spp, options.max_depth, seed, metropolis)
    facts = scene.facts | light | {
        "seed": options.seed, "index": index, "generator": options.made_by, "samples": mutations,
        "integrator": "pssmlt", "chains": chains, "scenes_are_of": options.scenes_are_of(),
    }  # fmt: skip
    numbers = range(options.frames)
    return [_render_clip(clip_path(out, index), stage, numbers, facts, render, clock, options.layers)]


def _render_windows(out: Path, group: int, options: ClipOptions) -> list[dict]:
    """The missing clips of a scene's takes; windows depend only on other windows of their take."""
    first = group * options.clips_per_scene
    members = range(first, min(first + options.clips_per_scene, options.count))
    missing = [i for i in members if not clip_path(out, i).exists()]
    wanted = {(i - first) // options.windows_per_take for i in missing}
    rendered = []
    clock = time.process_time()
    for k, take in draw_takes(group, options, wanted):
        start = first + k * options.windows_per_take
        mine = range(start, min(start + options.windows_per_take, options.count))
        rendered += _render_take(out, group, take, mine, missing, options, clock)
        clock = time.process_time()
    return rendered


def _render_take(
    out: Path, group: int, take: Take, members: range, missing: list[int], options: ClipOptions, clock: float
) -> list[dict]:
    stage, whole, taken, rendered = take.stage, take.stage.scene, [], []
    windows = candidates(take.found, options.size, take.frames)
    for index in members:  # existing clips too: a window depends on those before it
        rng = np.random.default_rng([options.seed, group, index])
        active = bool(rng.uniform() < ACTIVE_SHARE) and not options.stills
        window = choose(windows, taken, options.size, take.frames, active, rng)
        taken.append(window)
        if index not in missing:
            continue
        stage.scene = whole
        look_through(stage, window, take.view)
        more = {
            "seed": options.seed, "index": index, "generator": options.generator,
            "scenes_are_of": options.scenes_are_of(), "uncovered": window.uncovered,
            "view_uncovered": mean(take.found.uncovered[1:]), "motion": window.motion,
            "chosen": "activity" if active else "at random", "window": [window.top, window.left, *take.view],
        }  # fmt: skip
        seed = int(np.random.SeedSequence([options.seed, index]).generate_state(1)[0])
        numbers = range(window.first, window.first + take.frames)
        samples = draw_samples(options, rng)
        middle = numbers[(options.lead_in + len(numbers)) // 2]  # of the frames with references
        spp, error, halves = reference_samples(stage, middle, options, samples, seed)
        feature_spp = min(FEATURE_SPP, MAX_RAYS // (options.size[0] * options.size[1])) if options.assets else 0
        render = RenderOptions(options.size, samples, spp, options.max_depth, seed, feature_spp=feature_spp)
        more |= {"reference_error": error} | ({"samples": samples} if options.assets else {})
        facts, path = take.facts | more, clip_path(out, index)
        if options.stills:
            rendered.append(_render_still(path, stage, numbers[0], facts, render, clock, options, halves))
        else:
            facts |= {LEAD_IN: options.lead_in} if options.lead_in else {}
            rendered.append(_render_clip(path, stage, numbers, facts, render, clock, options.layers))
        clock = time.process_time()
    stage.scene = whole
    return rendered


def draw_samples(options: ClipOptions, rng: np.random.Generator) -> int:
    """Samples a pixel of a clip's noisy frames; with assets half of the clips have more than `options.spp`, unless
    `most_spp` forbids it."""
    most = MORE_SAMPLES[-1] if options.most_spp is None else options.most_spp // options.spp
    factors = [factor for factor in MORE_SAMPLES if factor <= most]
    if not options.assets or rng.uniform() < 0.5 or not factors:
        return options.spp
    return options.spp * int(rng.choice(factors))


def reference_samples(
    stage: Stage, number: int, options: ClipOptions, samples: int, seed: int
) -> tuple[int, float, list[dict]]:
    """(samples a pixel of both halves together, the error they are expected to leave, both halves where these are
    rendered already) for the target error.

    Two halves of PILOT_SPP / 2 samples give the error of their mean, mean((a − b)² / 4) relative to the squared mean;
    it falls as one over the number of samples. A pixel counts 1 at most: no number of samples would tame a firefly.
    A reference has at least twice the `samples` of the noisy frame.
    """
    pilot = RenderOptions(options.size, max_depth=options.max_depth, seed=seed)
    halves = [light(stage, number, pilot, PILOT_SPP // 2, stream) for stream in (FIRST_HALF, SECOND_HALF)]
    a, b = (grey(half["color"]) for half in halves)
    mean = (a + b) / 2
    squared = (a - b) ** 2 / 4 / (mean**2 + (0.1 * mean.mean()) ** 2 + 1e-12)
    error = float(np.minimum(squared, 1).mean())
    low, high = options.reference_range
    half = np.clip(np.ceil(PILOT_SPP * error / options.reference_error / 2), low // 2, high // 2)
    spp = 2 * int(max(half, samples if samples > 1 else 0))
    return spp, error * PILOT_SPP / spp, halves if spp == PILOT_SPP else []


def _render_clip(
    path: Path, stage: Stage, numbers: range, facts: dict, render: RenderOptions, clock: float, layers: tuple[str, ...]
) -> dict:
    """Render the frames `numbers`, write them, return the facts; `clock` is the processor time at which work began.
    Frames of a lead-in get no references: these layers are zero."""
    noisy, lead_in = replace(render, reference_spp=0, feature_spp=0), facts.get(LEAD_IN, 0)
    first = [render_frame(stage, number, noisy) for number in numbers[:lead_in]]
    frames = [render_frame(stage, number, render) for number in numbers[lead_in:]]
    nothing = {name: np.zeros_like(layer) for name, layer in frames[0].items() if "reference" in name}
    frames = [frame | nothing for frame in first] + frames
    return _write(path, frames, facts | {"first_frame": numbers[0]}, render, clock, layers)


def _render_still(
    path: Path, stage: Stage, number: int, facts: dict, render: RenderOptions, clock: float, options: ClipOptions,
    halves: list[dict],
) -> dict:  # fmt: skip
    """As `_render_clip`, for one frame, of whose references `halves` may be rendered already."""
    frame = render_frame(stage, number, render, halves)
    frames = repeat_frame(stage, number, render, options.repeats, frame) if options.repeats > 1 else [frame]
    return _write(path, frames, facts | {"first_frame": number}, render, clock, options.layers)


def _write(
    path: Path, frames: list[dict], facts: dict, render: RenderOptions, clock: float, layers: tuple[str, ...]
) -> dict:
    for frame in frames:
        frame["samples"] = np.full((*render.size, 1), render.spp, np.float32)
    if "uncovered" not in facts:
        shares = [uncovered(b["motion"], a["motion_next"]).mean() for a, b in pairwise(frames)]
        facts |= {"uncovered": float(np.mean(shares)) if shares else 0.0}
    facts = facts | {
        "frames": len(frames) - facts.get(LEAD_IN, 0), "size": list(render.size), "spp": render.spp,
        "reference_spp": render.reference_spp, "max_depth": render.max_depth,
        "seconds": time.process_time() - clock, "versions": versions(),
    }  # fmt: skip
    write_clip(path, frames, facts, layers)
    return facts


def versions() -> dict[str, str]:
    """Versions of the packages that make a clip."""

    def installed(name: str) -> str:
        try:
            return version(name)
        except PackageNotFoundError:
            return "unknown"

    return {name: installed(name) for name in ("rtdenoise", "mitsuba", "drjit")}
