"""Training clips of procedural scenes: draw, check cheaply, render, write; several processes, resumable."""

from __future__ import annotations

import gc
import shlex
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import numpy as np

from ..data.clips import clip_path, read_facts, write_clip
from ..errors import InputError
from .card import write_card
from .draw import draw
from .frames import RenderOptions, render_frame
from .scenes import procedural
from .stage import start_mitsuba
from .workers import only_run, run_jobs


@dataclass(frozen=True)
class ClipOptions:
    """What a set of clips is made of."""

    count: int = 200  # clips
    size: tuple[int, int] = (128, 128)  # height, width
    frames: int = procedural.CLIP_FRAMES
    seed: int = 0  # scene seed of clip 0; clip i is scene seed + i
    spp: int = 1  # samples per pixel of the noisy frames
    reference_spp: int = 128  # of an averagely noisy scene; half for clean ones, half as much again for the noisiest
    max_depth: int = 6  # path edges
    workers: int = 2  # processes of one thread each


def render_clip(path: Path, seed: int, options: ClipOptions) -> dict:
    """Render one clip to a file. Returns its facts."""
    started = time.perf_counter()
    stage, facts = draw(seed, options.frames)
    effort = np.clip(np.sqrt(facts["noise"] / 2), 0.5, 1.5)
    reference_spp = max(2 * round(options.reference_spp * effort / 2), 2)
    render = RenderOptions(options.size, options.spp, reference_spp, options.max_depth, seed)
    frames = []
    for number in range(options.frames):
        layers = render_frame(stage, number, render)
        layers["reference_half"] = layers.pop("half_reference")
        layers["indirect_reference_half"] = layers.pop("half_indirect_reference")
        frames.append(layers)
    facts |= {
        "seed": seed, "generator": procedural.VERSION, "frames": options.frames, "size": list(options.size),
        "spp": options.spp, "reference_spp": reference_spp, "max_depth": options.max_depth,
        "seconds": time.perf_counter() - started, "versions": versions(),
    }  # fmt: skip
    write_clip(path, frames, facts)
    del stage
    gc.collect()  # Mitsuba scenes are cycles; a left-over one would be part of the next one's kernels
    return facts


def render_clips(out: Path, options: ClipOptions, progress=print) -> dict:
    """Render clips 0 … count − 1 into a folder, with a data card. Clips that are there already are kept.

    Raises InputError where a worker is killed, the disk is full, another run renders into the folder, or one with
    other options has.
    """
    start_mitsuba()  # fails here, in one line, rather than in every process
    out = Path(out)
    out.mkdir(parents=True, exist_ok=True)
    refuse_others(out, options, generator=procedural.VERSION, seeds=lambda index: options.seed + index)
    missing = [i for i in range(options.count) if not clip_path(out, i).exists()]
    with only_run(out, "clips"):
        jobs = [(clip_path(out, i), options.seed + i, options) for i in missing]
        for done, ((path, *_), facts) in enumerate(run_jobs(render_clip, jobs, options.workers), 1):
            progress(
                f"{path.stem}: {facts['kind']}, {facts['place']}, uncovered {100 * facts['uncovered']:.1f} %, "
                f"{facts['reference_spp']} spp, {facts['seconds']:.1f} s ({done} of {len(missing)})"
            )
    return write_card(out, shlex.join([Path(sys.argv[0]).name, *sys.argv[1:]]))


def refuse_others(
    out: Path,
    options,
    generator: int,
    seeds: Callable[[int], int],  # what clip i would say its seed is
    scenes_are_of: dict | None = None,
    before: dict | None = None,
) -> None:
    """Raise InputError where the folder holds clips that were made with other options: they would be mixed up.

    `before` is what `scenes_are_of` was for clips of before there was the option. What else they do not say is taken on
    trust.
    """
    for path in sorted(out.glob("clip_*.safetensors"))[:1]:
        facts = read_facts(path)
        expected = {
            "generator": generator, "seed": seeds(int(path.stem.removeprefix("clip_"))), "size": list(options.size),
            "frames": options.frames, "spp": options.spp, "max_depth": options.max_depth,
        }  # fmt: skip
        wanted = scenes_are_of or {}
        told = {key: facts[key] for key in wanted.keys() & facts.keys()} | facts.get("scenes_are_of", {})
        found = wanted | (before or {}) | told | {key: facts.get(key) for key in expected}
        for key, value in (wanted | expected).items():
            if found[key] != value:
                raise InputError(f"{path}: was rendered with {key} = {found[key]}, not {value}; choose another "
                                 "--out or the options of that run")  # fmt: skip


def versions() -> dict[str, str]:
    """Of what made a clip."""

    def installed(name: str) -> str:
        try:
            return version(name)
        except PackageNotFoundError:
            return "unknown"

    return {name: installed(name) for name in ("rtdenoise", "mitsuba", "drjit")}
