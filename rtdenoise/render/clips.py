"""`rtdenoise clips`: a folder of training clips with a data card, rendered scene by scene in several processes or on a
Ray cluster.

Clips are numbered 0 … count − 1; neighbours share a scene (`ClipOptions.clips_per_scene`). A scene, the windows in it
and the noise depend on the options and the clip's number alone, so any machine can render any shard, and a killed run
continues where it stopped.
"""

from __future__ import annotations

import math
import shutil
from collections import Counter
from collections.abc import Callable
from pathlib import Path

from ..data.clip_file import bytes_per_clip, clip_path, read_facts
from ..errors import InputError
from ..evaluate.origin import typed
from ..files import remove_unfinished
from ..run.farm import Farm
from ..run.processes import Processes
from ..wording import counted
from .card import write_card
from .draw import VIEWS
from .options import ClipOptions
from .scene_clips import render_group
from .scenes.assets import read_library, require_models
from .scenes.pictures import find_pictures
from .stage import start_mitsuba
from .windows import COARSE
from .workers import KILLED, only_run, start_worker


def render_clips(out: Path, options: ClipOptions, progress: Callable[[int, int, str], None]) -> dict:
    """Render the missing clips of this shard into a folder, and write its data card. Returns the content of the card.

    `progress(done, total, line)` is called before the first clip, with the disk use, and after every clip.
    Raises InputError where clips are too large, the disk is too small, a worker is killed, another run renders the same
    shard, the shard has no scene, the folder holds clips of other options, or the cluster cannot do it (`run.farm`).
    """
    (shard, shards), scenes = options.shard, math.ceil(options.count / options.clips_per_scene)
    if shard >= scenes:
        raise InputError(f"--shard {shard}/{shards}: is empty: the {options.count} clips show {scenes} scenes; "
                         f"expected {scenes} shards at most")  # fmt: skip
    odd = options.size[0] % COARSE or options.size[1] % COARSE or min(options.size) < 32
    if options.windows_per_take > 1 and odd:
        raise InputError(
            f"clips of {options.size[1]}×{options.size[0]}: sides must be multiples of {COARSE}, from 32 on"
        )
    height, width = VIEWS[0]
    if options.assets and (options.size[0] > height or options.size[1] > width):
        raise InputError(f"clips of {options.size[1]}×{options.size[0]}: are cut from pictures of {width}×{height} and "
                         f"more; expected {width}×{height} at most")  # fmt: skip
    start_mitsuba()  # errors here and below end the run in one line, before any process starts
    if options.textures:
        find_pictures(options.textures)
    if options.assets:
        require_models(read_library(options.assets, options.allow_unlicensed))
    out = Path(out)
    out.mkdir(parents=True, exist_ok=True)
    refuse_other_options(out, options)
    numbers = (i for i in range(options.count) if not clip_path(out, i).exists())
    groups = Counter(i // options.clips_per_scene for i in numbers)  # scene -> its missing clips
    groups = {group: count for group, count in groups.items() if group % shards == shard}
    missing = sum(groups.values())
    with only_run(out, f"{shard}-of-{shards}"):
        remove_unfinished(out)
        progress(0, missing, _disk_use(out, missing, options))
        done = 0
        place = Farm(options.ray, out) if options.ray else Processes(options.workers)
        jobs = [(out, group, options) for group in groups]
        for (_, group, _), clips in place.run(render_group, jobs, start_worker, KILLED):
            done += groups[group] - len(clips)  # rendered by a worker of the cluster that was killed then
            for facts in clips:
                done += 1
                progress(
                    done, missing,
                    f"clip {facts['index']}: {facts['kind']}, {facts['place']}, uncovered "
                    f"{100 * facts['uncovered']:.1f} %, {facts['reference_spp']} spp, {facts['seconds']:.1f} s",
                )  # fmt: skip
        clips = (i for i in range(options.count) if i // options.clips_per_scene in groups)
        if left := [i for i in clips if not clip_path(out, i).exists()]:
            told = f"{counted(len(left), 'clip')}, from {left[0]} on: nothing is seen in their scenes"
            progress(done, missing, f"left out: {told}")
        return write_card(out, typed())


def refuse_other_options(out: Path, options: ClipOptions) -> None:
    """Raise InputError where the folder holds clips made with other options, which must not be mixed. One clip is
    compared."""
    for path in sorted(out.glob("clip_*.safetensors"))[:1]:
        facts = read_facts(path)
        index = int(path.stem.removeprefix("clip_"))
        expected = {
            "generator": options.made_by, "seed": options.clip_seed(index), "size": list(options.size),
            "max_depth": options.max_depth,
        }  # fmt: skip
        if options.frames_are_given:
            expected |= {"frames": options.repeats if options.stills else options.frames}
        if not options.assets and not options.metropolis:  # there they differ from clip to clip
            expected |= {"spp": options.spp}
        found = facts.get("scenes_are_of", {}) | {key: facts.get(key) for key in expected}
        if isinstance(any_pictures := found.get("textures"), bool):  # older sets do not tell which, but for their clips
            folder = facts.get("pictures", {}).get("folder", options.textures_are_of)
            found["textures"] = folder if any_pictures else None
        choice = options.scenes_are_of()
        motions = choice.pop("motions", {})
        for key, value in (expected | choice).items():
            if found.get(key) != value:
                raise InputError(f"{path}: was rendered with {key} = {found.get(key)}, not {value}; choose another "
                                 "--out or the options of that run")  # fmt: skip
        before = found.get("motions", motions)  # of older sets they are not known
        if changed := [name for name in motions if motions[name] != before.get(name)]:
            raise InputError(f"{path}: was rendered with another motion of {changed[0]}; choose another --out, or the "
                             "motion file of that run")  # fmt: skip


def _disk_use(out: Path, missing: int, options: ClipOptions) -> str:
    frames = options.lead_in + options.frames * options.repeats
    needed, free = missing * bytes_per_clip(options.size, frames, options.layers), shutil.disk_usage(out).free
    if needed > free:
        raise InputError(f"{out}: {missing} clips take {_bytes(needed)}, {_bytes(free)} are free")
    return f"{counted(missing, 'clip')} to render, {_bytes(needed)} on disk ({_bytes(free)} are free)"


def _bytes(count: float) -> str:
    return f"{count / 1e9:.1f} GB" if count >= 1e9 else f"{count / 1e6:.1f} MB"
