"""`rtdenoise clips`: sets of training clips, rendered or cut from shots."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import Positional, arg

from ..errors import InputError
from ..wording import counted
from .progress import progress_bar
from .render import at_least_one, not_negative, refuse_odd_references, refuse_too_many_paths

OF_WINDOWS = {"scenes", "motions", "exclude", "sun", "calm", "textures", "reference_error", "assets", "lead_in"}
OF_GENERATED = {"sun", "calm", "textures", "generator", "frames"}
OF_SHOTS = {"reference", "preset"}
OF_PATHS = {
    "scenes", "motions", "exclude", "generator", "sun", "calm", "textures", "assets", "allow_unlicensed",
    "reference_error", "lead_in", "repeats", "most_spp",
}  # fmt: skip
OF_CHAINS = {"chains", "attribution"}
OF_BOTH = {"shots", "out", "count", "frames", "size", "width", "height", "seed", "spp"}


@dataclass(frozen=True)
class Clips:
    """Make training clips: windows of animated scenes, rendered with Mitsuba 3, or windows of your own frames."""

    shots: Annotated[Positional[tuple[str, ...]], arg(metavar="SHOT ...", help_behavior_hint="(none: render)")] = ()
    """Folders of EXR files to cut clips from: noisy frames, features and references."""
    out: Path = field(kw_only=True)
    """Folder for the clips; existing ones are kept, so running again continues."""
    count: int = 300
    """Clips of the set."""
    generator: Literal[1, 2, 3] = 3
    """Version of the procedural scenes; 2 made the older sets of the shipped weights, 1 renders whole pictures."""
    scenes: Path | None = None
    """Folder of NAME/scene.xml; half of the scenes are drawn from these."""
    motions: Path | None = None
    """With --scenes: folder of NAME.toml, the motions of these scenes."""
    exclude: tuple[str, ...] = ("street", "dining-room", "staircase2", "bathroom")
    """With --scenes: names that are left out, to validate on; of others than the default ones each must be there."""
    sun: float = 0.0
    """Share of the generated scenes that a sun shines on, with sharp shadows (0 to 1)."""
    calm: float = 0.0
    """Share of the scenes in which nothing but the camera moves, slowly where they are generated (0 to 1)."""
    textures: Path | None = None
    """Folder of PNG, JPEG or WebP pictures that some surfaces get as textures."""
    assets: Path | None = None
    """Folder of a library with an index.json: clips are windows of large pictures of rooms, streets, table tops,
    gardens and showrooms composed of its models; a third are of --scenes, where given, with other cameras."""
    allow_unlicensed: bool = False
    """With --assets: use assets whose licence is unknown, too."""
    frames: int = 10
    """Frames of each clip; with --assets 8 to 10, some 16 to 32, or so many where there is a lead-in, or with
    --frames 1 stills of more cameras."""
    lead_in: int = 0
    """Frames before these, noisy and without references: `rtdenoise train --lead-in` begins with their history."""
    repeats: int = 1
    """With --frames 1: renders of each still with noise of their own, the frames of a clip without motion."""
    size: int = 128
    """Pixels: width and height, unless those are given."""
    width: int | None = None
    """Pixels."""
    height: int | None = None
    """Pixels."""
    spp: Annotated[int | None, arg(help_behavior_hint="(default: 1, of a SHOT what its files tell)")] = None
    """Samples per pixel of the noisy frames; with --assets half of the clips have 2 to 64 times as many. With pssmlt
    mutations: a quarter of the clips each have 1, 2, 4 and 8 times as many. With SHOT: of frames that do not tell by a
    layer samples."""
    most_spp: int | None = None
    """With --assets: the most samples per pixel of the noisy frames (default: 64 times --spp).
    --most-spp 1 renders frames of one sample alone."""
    reference_error: float = 0.01
    """Relative squared error that references of beauty may have; sets their samples, 32 to 512 (with --assets 128,
    stills from 16 on)."""
    reference_spp: int | None = None
    """With --generator 1: samples per pixel of the references (default: 64), more in noisier scenes. With pssmlt:
    mutations, of both halves together: an even number (default: 256)."""
    max_depth: int | None = None
    """Longest light path, in edges (default: 6, with pssmlt 8)."""
    integrator: Literal["path", "pssmlt"] = "path"
    """pssmlt: caustic scenes by Metropolis sampling, with the layers large, small and proposals."""
    chains: int | None = None
    """With pssmlt: chains in parallel (default: one for every 4 or 16 pixels, drawn for each clip)."""
    attribution: Literal["made", "replaced"] = "made"
    """With pssmlt: a state's light counts as large or small by the step that made it, or that replaced it."""
    reference: Annotated[tuple[Path, ...], arg(help_behavior_hint="(default: the layers of SHOT)")] = ()
    """With SHOT: folders of converged renders of the same frames, one a shot, where the references are in other
    files."""
    preset: str = "auto"
    """With SHOT: layout of the files, as for inspect."""
    seed: int = 0
    """Of the set; with --generator 1, of the scene of clip 0, clip i has seed + i."""
    shard: str = "0/1"
    """'i/n' renders the i-th of n equal parts of the set, counted from 0."""
    workers: int = 2
    """Processes, of one thread each."""
    ray: Annotated[str | None, arg(metavar="ADDRESS")] = None
    """Render on an existing Ray cluster: HOST:PORT, 'auto' or ray://HOST:PORT; a clip takes one core."""

    def run(self) -> None:
        counts = "count", "frames", "width", "height", "size", "spp", "max_depth", "workers", "chains", "repeats"
        at_least_one(self, *counts)
        not_negative(self, "seed", "reference_spp", "lead_in")
        if self.shots:
            self._cut()
        else:
            self._render()

    def _cut(self) -> None:
        if unused := self._given() - OF_SHOTS - OF_BOTH:
            raise InputError(f"{_option(min(unused))}: is for rendering, and does not go with SHOT")
        from ..training.shots import CutOptions, cut_clips

        size = (self.height or self.size, self.width or self.size)
        options = CutOptions(self.count, size, self.frames, self.seed, self.preset, self.spp or 0)
        with progress_bar("cutting") as bar:
            task = bar.add_task("cut", total=None)
            count = cut_clips(
                self.shots, self.out, options, self.reference,
                lambda done, total: bar.update(task, completed=done, total=total),
                lambda line: bar.console.print(line, soft_wrap=True),
            )  # fmt: skip
        print(f"{self.out}: {counted(count, 'clip')}; DATA.md says what they are")

    def _render(self) -> None:
        if unused := self._given() & OF_SHOTS:
            raise InputError(f"{_option(min(unused))}: goes with SHOT")
        for name in ("sun", "calm"):
            if not 0 <= (share := getattr(self, name)) <= 1:
                raise InputError(f"--{name}: expected a share from 0 to 1, got {share}")
        if not self.reference_error > 0:
            raise InputError(f"--reference-error: expected more than 0, got {self.reference_error}")
        self._refuse_unused_options()
        from ..render.clips import render_clips
        from ..render.metropolis import MetropolisOptions, chains_of
        from ..render.options import ClipOptions, find_scenes, parse_shard, require_scenes

        size, spp = (self.height or self.size, self.width or self.size), self.spp or 1
        refuse_too_many_paths(size, spp)
        metropolis = None
        if self.integrator == "pssmlt":
            refuse_odd_references(self.reference_spp)
            metropolis = MetropolisOptions(self.chains or 0, attribution=self.attribution)
            chains_of(metropolis, size, spp)
        scenes = ()
        if self.scenes:
            scenes = find_scenes(self.scenes, self.motions, self.exclude)
            require_scenes(self.scenes, set(self.exclude) - set(Clips.exclude))
        options = ClipOptions(
            self.count, size, self.frames, self.seed, spp, self.reference_error, self._reference_range(),
            self.reference_spp or (256 if metropolis else 64), self.max_depth or (8 if metropolis else 6),
            self.workers, parse_shard(self.shard),
            scenes, self.generator, self.sun, self.calm, str(self.textures or ""), str(self.assets or ""),
            self.allow_unlicensed, self.lead_in, self.repeats, self.most_spp, self.ray or "", metropolis,
        )  # fmt: skip
        with progress_bar("rendering") as bar:
            task = bar.add_task("render", total=None)

            def report(done: int, total: int, line: str) -> None:
                bar.update(task, completed=done, total=total)
                bar.console.print(line, soft_wrap=True)

            card = render_clips(self.out, options, report)
        print(f"{self.out}: {counted(card['clips'], 'clip')}; DATA.md says what they are")

    def _reference_range(self) -> tuple[int, int]:
        if not self.assets:
            return 32, 512
        return 16 if self.frames == 1 else 32, 128

    def _refuse_unused_options(self) -> None:
        """Raise InputError for options that the generator does not take."""
        given = self._given()
        if self.integrator == "pssmlt":
            if unused := given & OF_PATHS:
                raise InputError(f"{_option(min(unused))}: goes with --integrator path; pssmlt draws caustic scenes")
        elif unused := given & OF_CHAINS:
            raise InputError(f"{_option(min(unused))}: goes with --integrator pssmlt")
        if self.generator == 1 and (unused := given & OF_WINDOWS):
            raise InputError(f"{_option(min(unused))}: goes with --generator 2 and 3, not with 1")
        if self.generator != 1 and self.integrator == "path" and self.reference_spp is not None:
            raise InputError("--reference-spp: goes with --generator 1 and pssmlt; other sets take --reference-error")
        if self.reference_spp == 0:
            raise InputError("--reference-spp: clips are for training and need references; expected 2 or more, got 0")
        drawn = OF_GENERATED - ({"frames"} if self.frames == 1 or self.lead_in else set())
        if self.assets and (unused := given & drawn):
            raise InputError(f"--{min(unused)}: is for generated scenes, not for --assets")
        if self.most_spp is not None and not self.assets:
            raise InputError("--most-spp: goes with --assets; other sets have --spp samples a pixel")
        if self.most_spp is not None and self.most_spp < (spp := self.spp or 1):
            raise InputError(f"--most-spp: expected {spp} (--spp) or more, got {self.most_spp}")
        if self.repeats > 1 and not (self.assets and self.frames == 1):
            raise InputError("--repeats: is for stills, --assets with --frames 1")
        if self.lead_in and self.assets and self.frames == 1:
            raise InputError("--lead-in: is for clips; stills have no frames before them")
        if self.allow_unlicensed and not self.assets:
            raise InputError("--allow-unlicensed: goes with --assets")
        if given >= {"ray", "workers"}:
            raise InputError("--workers: is for processes of this machine; with --ray every core of the cluster works")
        if given & {"motions", "exclude"} and not self.scenes:
            raise InputError("--motions, --exclude: go with --scenes")

    def _given(self) -> set[str]:
        """Fields of the options that differ from their defaults."""
        return {option.name for option in fields(self) if getattr(self, option.name) != option.default}


def _option(name: str) -> str:
    """The option of a field, as it is typed."""
    return f"--{name.replace('_', '-')}"
