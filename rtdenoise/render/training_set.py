"""`rtdenoise render --preset train`: clips of windows in which something happens, several from every loaded scene.

Clips are numbered 0 … count − 1. Four neighbours (`CLIPS_PER_SCENE`) share a scene, which is loaded, and its kernels
compiled, once. Scene g, the windows in it, the noise: all depend on (seed, number of the clip) alone, so any machine
can render any shard, and a killed run goes on where it was.
"""

from __future__ import annotations

import gc
import shlex
import shutil
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ..data.clips import bytes_per_clip, clip_path, write_clip
from ..errors import InputError
from .card import GENERATED, write_card
from .clips import refuse_others, versions
from .draw import dress
from .frames import FIRST_HALF, LUMINANCE, SECOND_HALF, RenderOptions, calibrate, radiance, render_frame
from .scenes import wide as procedural_wide
from .scenes.file import open_file
from .scenes.pictures import find_pictures, hang
from .scenes.scene import Scene
from .scenes.sunlit import sunlit
from .stage import Stage, start_mitsuba
from .windows import COARSE, Survey, candidates, choose, look_through, survey
from .workers import only_run, run_jobs

CLIPS_PER_SCENE = 4
ACTIVE = 0.75  # probability that a clip's window is the one with most activity; otherwise any window
SCENE_SHARE = 0.5  # of the scenes that come from --scenes, where that is given
ATTEMPTS = 8  # drawings of a procedural scene
HELD_OUT = range(2_000_000, 2_000_100)  # seeds of generated scenes to evaluate on: no training set draws them
UNCOVERING = {"uncovering": 0.015, "entering": 0.01, "dark to light": 0.01}  # least share in the best window, by kind
PILOT = 16  # samples a pixel from which a reference's error is estimated


@dataclass(frozen=True)
class SetOptions:
    """What a training set is made of."""

    count: int = 300  # clips
    size: tuple[int, int] = (128, 128)  # height, width
    frames: int = 10
    seed: int = 0
    spp: int = 1  # samples per pixel of the noisy frames
    reference_error: float = 0.01  # relative squared error that a reference of beauty may have,
    reference_range: tuple[int, int] = (32, 512)  # with no fewer and no more samples a pixel than these
    max_depth: int = 6  # path edges
    workers: int = 2  # processes of one thread each
    shard: tuple[int, int] = (0, 1)  # (i, n): this run does the scenes g with g mod n = i
    scenes: tuple[tuple[str, str], ...] = ()  # (scene file, motion file or "") to mix in
    generator: int = procedural_wide.VERSION  # version of the wide one: 2 or 3
    sun: float = 0.0  # share of the generated scenes that a sun shines on
    calm: float = 0.0  # share of the scenes in which nothing but the camera moves
    textures: str = ""  # folder of pictures that some surfaces get; "": none

    def scenes_are_of(self) -> dict:
        """What decides which scenes there are and how they are rendered, beside seed, size, frames and samples: clips
        of different ones must not lie in one folder. Without paths of the machine."""
        files = [[Path(f).parent.name, bool(motion)] for f, motion in self.scenes]
        textures = bool(self.textures)
        shares = {"sun": self.sun, "calm": self.calm}
        return shares | {"files": files, "textures": textures, "reference_error": self.reference_error}


def parse_shard(text: str) -> tuple[int, int]:
    """(i, n) of 'i/n'. Raises InputError."""
    i, _, n = text.partition("/")
    if not (i.isdecimal() and n.isdecimal() and int(i) < int(n)):
        raise InputError(f"--shard {text}: expected i/n with 0 ≤ i < n, such as 0/4")
    return int(i), int(n)


def find_scenes(folder: Path, motions: Path | None, exclude: tuple[str, ...]) -> tuple[tuple[str, str], ...]:
    """(scene file, motion file or "") of every FOLDER/NAME/scene.xml but the excluded, with MOTIONS/NAME.toml."""
    files = [f for f in sorted(Path(folder).glob("*/scene.xml")) if f.parent.name not in exclude]
    if not files:
        raise InputError(f"{folder}: no scenes found; expected folders NAME/scene.xml besides {', '.join(exclude)}")
    scripts = [Path(motions) / f"{f.parent.name}.toml" if motions else None for f in files]
    return tuple((str(f), str(s) if s and s.is_file() else "") for f, s in zip(files, scripts, strict=True))


# --- one scene --------------------------------------------------------------------------------------------------------


def _view(size: tuple[int, int]) -> tuple[int, int]:
    """The picture that windows are cut from: twice as high and wide."""
    return 2 * size[0], 2 * size[1]


def open_stage(group: int, options: SetOptions) -> tuple[Stage, Survey, dict]:
    """Load scene number `group`: a procedural one that is fit to be seen, or one of the files; exposed and surveyed."""
    rng = np.random.default_rng([options.seed, group])
    view, frames = _view(options.size), 2 * options.frames
    calm = options.calm > 0 and bool(rng.uniform() < options.calm)
    if options.scenes and rng.uniform() < SCENE_SHARE:
        file, motion = options.scenes[rng.integers(len(options.scenes))]
        if calm:
            scene = _at_rest(open_file(Path(file), motion or None))
        else:
            scene = dress(Path(file), motion or None, rng, frames)
        scene = _papered(scene, options, group)
        stage = Stage(scene)
        found = survey(stage, frames, view)
        calibrate(stage, scene.facts.get("brightness", 0.5), frames // 2)
        licence = Path(file).with_name("LICENSE.txt")
        source = {"source": scene.name, "licence": licence.read_text() if licence.is_file() else ""}
        kind = "calm scene file" if calm else "scene file"
        return stage, found, scene.facts | source | {"kind": kind, "place": scene.name}
    seed = scene_seed(rng)
    sunny = rng.uniform() < options.sun
    for attempt in range(ATTEMPTS):
        scene = procedural_wide.procedural(seed, attempt, frames, view[1], options.generator, calm)
        if sunny:
            scene = sunlit(scene, np.random.default_rng([options.seed, group, 1, attempt + 1]))
        scene = _papered(scene, options, group, attempt)
        stage = Stage(scene)
        found = survey(stage, frames, view)
        last = attempt == ATTEMPTS - 1
        most = max(w.uncovered for w in candidates(found, options.size, options.frames))
        fit = found.sky < 0.75 and found.near > 0.3 and most >= UNCOVERING.get(scene.facts["kind"], 0.0)
        if fit or last:
            light = calibrate(stage, scene.facts["brightness"], frames // 2)
            if (light["evenness"] > 0.08 and light["noise"] < 8) or last:
                return stage, found, scene.facts | light | {"source": GENERATED, "scene_seed": seed}
    raise AssertionError("unreachable")


def scene_seed(rng: np.random.Generator) -> int:
    """The seed of a generated scene, none that is held out."""
    seed = int(rng.integers(1 << 31))
    return seed + len(HELD_OUT) if seed in HELD_OUT else seed


def _at_rest(scene: Scene) -> Scene:
    """With objects that stand still; the camera goes its way."""
    return replace(scene, objects=tuple(replace(o, motion=None) for o in scene.objects))


def _papered(scene: Scene, options: SetOptions, group: int, attempt: int = 0) -> Scene:
    """With pictures on some surfaces; drawn apart from the rest, so that the scene is otherwise that without them."""
    if not options.textures:
        return scene
    return hang(scene, find_pictures(options.textures), np.random.default_rng([options.seed, group, 2, attempt + 1]))


def reference_samples(stage: Stage, number: int, options: SetOptions, seed: int) -> tuple[int, float]:
    """(samples a pixel, both halves together; the error they are expected to leave) for the target error.

    Two halves of PILOT / 2 samples give the error of their mean, mean((a − b)² / 4) relative to the squared mean; it
    falls as one over the number of samples. A pixel counts 1 at most: no number of samples would tame a firefly.
    """
    a, b = (
        radiance(stage, number, options.size, PILOT // 2, seed, stream, options.max_depth)[0] @ LUMINANCE
        for stream in (FIRST_HALF, SECOND_HALF)
    )
    mean = (a + b) / 2
    squared = (a - b) ** 2 / 4 / (mean**2 + (0.1 * mean.mean()) ** 2 + 1e-12)
    error = float(np.minimum(squared, 1).mean())
    low, high = options.reference_range
    spp = 2 * int(np.clip(np.ceil(PILOT * error / options.reference_error / 2), low // 2, high // 2))
    return spp, error * PILOT / spp


def render_group(out: Path, group: int, options: SetOptions) -> list[dict]:
    """Render the clips of one scene that are not there yet. Returns their facts."""
    members = range(group * CLIPS_PER_SCENE, min((group + 1) * CLIPS_PER_SCENE, options.count))
    missing = [i for i in members if not clip_path(out, i).exists()]
    clock = time.process_time()
    stage, found, facts = open_stage(group, options)
    opening = time.process_time() - clock
    whole, view = stage.scene, _view(options.size)
    windows, taken, rendered = candidates(found, options.size, options.frames), [], []
    for index in members:  # also for clips that are there: a window depends on those before it
        rng = np.random.default_rng([options.seed, group, index])
        active = bool(rng.uniform() < ACTIVE)
        window = choose(windows, taken, options.size, options.frames, active, rng)
        taken.append(window)
        if index not in missing:
            continue
        stage.scene = whole
        look_through(stage, window, view)
        more = {
            "seed": options.seed, "index": index, "generator": options.generator,
            "scenes_are_of": options.scenes_are_of(), "uncovered": window.uncovered,
            "view_uncovered": float(found.uncovered[1:].mean()), "motion": window.motion,
            "chosen": "activity" if active else "at random", "window": [window.top, window.left, *view],
        }  # fmt: skip
        more["scene_seconds"] = opening if not rendered else 0.0
        rendered.append(_render_clip(clip_path(out, index), stage, window.first, facts | more, options))
    del stage
    gc.collect()  # Mitsuba scenes are cycles; a left-over one would be part of the next one's kernels
    return rendered


def _render_clip(path: Path, stage: Stage, first: int, facts: dict, options: SetOptions) -> dict:
    """Render and write frames from `first` on. The facts' seconds are processor time: of this clip, and, for the first
    one of a scene, of loading, surveying and exposing it."""
    clock = time.process_time()
    seed = int(np.random.SeedSequence([options.seed, facts["index"]]).generate_state(1)[0])
    spp, error = reference_samples(stage, first + options.frames // 2, options, seed)
    render = RenderOptions(options.size, options.spp, spp, options.max_depth, seed)
    frames = []
    for number in range(first, first + options.frames):
        layers = render_frame(stage, number, render)
        layers["reference_half"] = layers.pop("half_reference")
        layers["indirect_reference_half"] = layers.pop("half_indirect_reference")
        frames.append(layers)
    facts = facts | {
        "first_frame": first, "frames": options.frames, "size": list(options.size), "spp": options.spp,
        "reference_spp": spp, "reference_error": error, "max_depth": options.max_depth,
        "seconds": facts["scene_seconds"] + time.process_time() - clock, "versions": versions(),
    }  # fmt: skip
    write_clip(path, frames, facts)
    return facts


# --- the set ----------------------------------------------------------------------------------------------------------


def render_set(out: Path, options: SetOptions, progress: Callable[[int, int, str], None]) -> dict:
    """Render the clips of this shard into a folder, with a data card. Clips that are there already are kept.

    `progress(done, total, line)` is called before the first clip, with the disk use, and after every clip.
    Raises InputError where the disk is too small, a worker is killed, another run does the same shard, or the folder
    holds clips of other options.
    """
    if options.size[0] % COARSE or options.size[1] % COARSE or min(options.size) < 8 * COARSE:
        raise InputError(
            f"clips of {options.size[1]}×{options.size[0]}: sides must be multiples of {COARSE}, from 32 on"
        )
    start_mitsuba()  # fails here, in one line, rather than in every process,
    if options.textures:
        find_pictures(options.textures)  # and so do pictures that cannot be opened
    out = Path(out)
    out.mkdir(parents=True, exist_ok=True)
    before = {"calm": 0.0}  # an option that is younger than the record
    refuse_others(out, options, options.generator, lambda index: options.seed, options.scenes_are_of(), before)
    shard, shards = options.shard
    groups: dict[int, int] = {}  # scene -> clips of it that are missing
    for i in range(options.count):
        group = i // CLIPS_PER_SCENE
        if group % shards == shard and not clip_path(out, i).exists():
            groups[group] = groups.get(group, 0) + 1
    missing = sum(groups.values())
    with only_run(out, f"{shard}-of-{shards}"):
        progress(0, missing, _disk_use(out, missing, options))
        done = 0
        for _, clips in run_jobs(render_group, [(out, group, options) for group in groups], options.workers):
            for facts in clips:
                done += 1
                progress(
                    done, missing,
                    f"clip {facts['index']}: {facts['kind']}, {facts['place']}, uncovered "
                    f"{100 * facts['uncovered']:.1f} %, {facts['reference_spp']} spp, {facts['seconds']:.1f} s",
                )  # fmt: skip
        return write_card(out, shlex.join([Path(sys.argv[0]).name, *sys.argv[1:]]))


def _disk_use(out: Path, missing: int, options: SetOptions) -> str:
    needed, free = missing * bytes_per_clip(options.size, options.frames), shutil.disk_usage(out).free
    if needed > free:
        raise InputError(f"{out}: {missing} clips take {_bytes(needed)}, {_bytes(free)} are free")
    return f"{missing} clips to render, {_bytes(needed)} on disk ({_bytes(free)} are free)"


def _bytes(count: float) -> str:
    return f"{count / 1e9:.1f} GB" if count >= 1e9 else f"{count / 1e6:.1f} MB"
