"""The clips of one scene: load it once, choose windows in which something happens, render each and write it."""

from __future__ import annotations

import gc
import time
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import numpy as np

from ..data.clips import clip_path, write_clip
from .draw import draw_first, draw_scene
from .frames import FIRST_HALF, SECOND_HALF, RenderOptions, grey, radiance, render_frame
from .options import ClipOptions
from .stage import Stage
from .windows import candidates, choose, look_through

ACTIVE_SHARE = 0.75  # of the clips whose window is the one with most activity; the others take any window
PILOT_SPP = 16  # samples a pixel from which a reference's error is estimated


def render_group(out: Path, group: int, options: ClipOptions) -> list[dict]:
    """Render the missing clips of scene number `group`. Returns their facts."""
    clips = _render_whole if options.generator == 1 else _render_windows
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
    return [_render_clip(clip_path(out, index), stage, range(options.frames), facts, render, clock)]


def _render_windows(out: Path, group: int, options: ClipOptions) -> list[dict]:
    first = group * options.clips_per_scene
    members = range(first, min(first + options.clips_per_scene, options.count))
    missing = [i for i in members if not clip_path(out, i).exists()]
    clock = time.process_time()
    stage, found, facts = draw_scene(group, options)
    whole, windows, taken, rendered = stage.scene, candidates(found, options.size, options.frames), [], []
    for index in members:  # existing clips too: a window depends on those before it
        rng = np.random.default_rng([options.seed, group, index])
        active = bool(rng.uniform() < ACTIVE_SHARE)
        window = choose(windows, taken, options.size, options.frames, active, rng)
        taken.append(window)
        if index not in missing:
            continue
        stage.scene = whole
        look_through(stage, window, options.view)
        more = {
            "seed": options.seed, "index": index, "generator": options.generator,
            "scenes_are_of": options.scenes_are_of(), "uncovered": window.uncovered,
            "view_uncovered": float(found.uncovered[1:].mean()), "motion": window.motion,
            "chosen": "activity" if active else "at random", "window": [window.top, window.left, *options.view],
        }  # fmt: skip
        seed = int(np.random.SeedSequence([options.seed, index]).generate_state(1)[0])
        numbers = range(window.first, window.first + options.frames)
        spp, error = reference_samples(stage, numbers[len(numbers) // 2], options, seed)
        render = RenderOptions(options.size, options.spp, spp, options.max_depth, seed)
        more |= {"reference_error": error}
        rendered.append(_render_clip(clip_path(out, index), stage, numbers, facts | more, render, clock))
        clock = time.process_time()
    return rendered


def reference_samples(stage: Stage, number: int, options: ClipOptions, seed: int) -> tuple[int, float]:
    """(samples a pixel of both halves together, the error they are expected to leave) for the target error.

    Two halves of PILOT_SPP / 2 samples give the error of their mean, mean((a − b)² / 4) relative to the squared mean;
    it falls as one over the number of samples. A pixel counts 1 at most: no number of samples would tame a firefly.
    """
    a, b = (
        grey(radiance(stage, number, options.size, PILOT_SPP // 2, seed, stream, options.max_depth)[0])
        for stream in (FIRST_HALF, SECOND_HALF)
    )
    mean = (a + b) / 2
    squared = (a - b) ** 2 / 4 / (mean**2 + (0.1 * mean.mean()) ** 2 + 1e-12)
    error = float(np.minimum(squared, 1).mean())
    low, high = options.reference_range
    spp = 2 * int(np.clip(np.ceil(PILOT_SPP * error / options.reference_error / 2), low // 2, high // 2))
    return spp, error * PILOT_SPP / spp


def _render_clip(path: Path, stage: Stage, numbers: range, facts: dict, render: RenderOptions, clock: float) -> dict:
    """Render the frames `numbers`, write them, return the facts; `clock` is the processor time at which work began."""
    frames = [render_frame(stage, number, render) for number in numbers]
    facts = facts | {
        "first_frame": numbers[0], "frames": len(numbers), "size": list(render.size), "spp": render.spp,
        "reference_spp": render.reference_spp, "max_depth": render.max_depth,
        "seconds": time.process_time() - clock, "versions": versions(),
    }  # fmt: skip
    write_clip(path, frames, facts)
    return facts


def versions() -> dict[str, str]:
    """Of the packages that make a clip."""

    def installed(name: str) -> str:
        try:
            return version(name)
        except PackageNotFoundError:
            return "unknown"

    return {name: installed(name) for name in ("rtdenoise", "mitsuba", "drjit")}
