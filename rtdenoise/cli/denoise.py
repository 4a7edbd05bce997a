"""`rtdenoise denoise`."""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from glob import glob, has_magic
from itertools import pairwise, takewhile
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import OmitArgPrefixes, Positional, arg

from ..errors import InputError
from ..run.farm import Farm
from ..run.options import CombineOptions, Options
from ..run.processes import Place, Processes
from ..run.summary import Summary
from ..run.threads import cpu_limit
from ..wording import counted
from .failures import line
from .progress import frame_progress, progress_bar

CORES = 4  # for a shot
SEEN = 1.02  # factor between frames from which on a change of all light is told
KILLED = "a process was killed (out of memory?); run the same command again with fewer --workers"


@dataclass(frozen=True)
class Denoise:
    """Denoise sequences of EXR files: one file of the same name each, the result in R,G,B."""

    sources: Annotated[Positional[tuple[str, ...]], arg(metavar="SEQ ...", help_behavior_hint="(one or more)")]
    """Folder of EXR files, or a glob in quotes. Several folders, or a glob of folders such as 'shots/*', are several
    shots: each gets a folder of its name in --out."""
    out: Path
    """Folder for the denoised files; never the folder of the input."""
    settings: OmitArgPrefixes[Options] = field(default_factory=Options)
    overwrite: bool = False
    """Denoise all frames again, whatever --out holds."""
    preview: bool = False
    """Also write preview.png and an animation: noisy | denoised | reference."""
    progress: Literal["bar", "lines"] = "bar"
    """How far it is: a bar, or a line such as 3/24 after each frame, of several shots after each shot, for programs
    that show it themselves."""
    workers: Annotated[int | None, arg(help_behavior_hint="(default: one for every four cores)")] = None
    """Shots that are denoised at a time, by a process each."""
    ray: Annotated[str | None, arg(metavar="ADDRESS")] = None
    """Denoise several shots on an existing Ray cluster: HOST:PORT, 'auto' or ray://HOST:PORT."""

    def run(self) -> None:
        if self.workers is not None and self.workers < 1:
            raise InputError(f"--workers: expected 1 or more, got {self.workers}")
        if self.ray and self.workers:
            raise InputError("--workers: is for processes of this machine; with --ray Ray shares out the shots")
        refuse_file(self.out)
        shots = find_shots(self.sources, self.out)
        if shots is None and self.ray:
            raise InputError("--ray: shares out shots, and a sequence is one; name several, or a glob: 'shots/*'")
        if shots is None:
            self._denoise_one(self.sources[0])
        else:
            self._denoise_many(shots)

    def _denoise_one(self, source: str) -> None:
        with frame_progress(self.progress, "denoising") as on_frame:
            lines = denoise_shot(self, source, self.out, on_frame)
        lines += ["--workers: shares out shots, and a sequence is one"] * (self.workers is not None)
        print(f"{self.out}: " + "\n".join(lines))

    def _denoise_many(self, shots: dict[str, str]) -> None:
        """Raises InputError where a shot does, after the others."""
        jobs = [(self._of(name), source, self.out / name) for name, source in shots.items()]
        failed = 0
        with progress_bar("denoising shots") as bar:
            task = bar.add_task("denoise", total=len(shots))
            lines = self.progress == "lines"
            if not lines:
                bar.update(task, completed=0)
            results = self._place(len(shots)).run(_try, jobs, _start, KILLED)
            for done, (job, said) in enumerate(results, start=1):
                failed += isinstance(said, InputError)
                told_of = f"failed: {said}" if isinstance(said, InputError) else "; ".join(said)
                bar.console.print(f"{job[2]}: {told_of}", soft_wrap=True)
                if lines:
                    print(f"{done}/{len(shots)}", flush=True)
                else:
                    bar.update(task, completed=done)
        if failed:
            others = "; the others are denoised" if failed < len(shots) else ""
            raise InputError(f"{failed} of {len(shots)} shots failed, as told above{others}")

    def _of(self, shot: str) -> Denoise:
        """This command for one of several shots."""
        surfaces = self.settings.surfaces and str(Path(self.settings.surfaces) / shot)
        return replace(self, settings=replace(self.settings, surfaces=surfaces))

    def _place(self, shots: int) -> Place:
        """Where so many shots are denoised."""
        if self.ray:
            return Farm(self.ray, self.out, CORES, gpu=self.settings.device != "cpu")
        cores = min(os.cpu_count() or 1, cpu_limit() or sys.maxsize)
        workers = min(self.workers or max(1, cores // CORES), shots)
        return Processes(workers, max(1, cores // workers))


def refuse_file(out: Path) -> None:
    """Raise InputError where --out is called like a picture: a folder of that name would come out."""
    if out.suffix.lower() == ".exr" and not out.is_dir():
        raise InputError(f"--out: expected a folder, in which a file has its name in the input; got {out}")


def find_shots(sources: tuple[str, ...], out: Path) -> dict[str, str] | None:
    """Name -> folder, or glob, of each of several shots; None where `sources` is one sequence. The name is that of the
    folder, with as much of its path as tells all shots apart.

    Raises InputError where nothing is named, a shot twice, or its frames as if they were shots.
    """
    if not sources:
        raise InputError("no sequence: name a folder of EXR files")
    folders = [folder for source in sources for folder in _folders(source, out)]
    _refuse_frames(folders)
    if len(folders) == 1 and folders == list(sources):
        return None
    paths = [Path(folder).resolve() for folder in folders]
    if twice := [folder for folder, path in zip(folders, paths, strict=True) if paths.count(path) > 1]:
        raise InputError(f"{twice[0]}: is named twice")
    for shorter in (_folder_of, _without_pattern):
        short = [shorter(path) for path in paths]
        if len(set(short)) == len(short):
            paths = short
            break
    names = [path.name for path in paths]
    if len(set(names)) < len(names):
        shared = os.path.commonpath([path.parent for path in paths])
        names = [path.relative_to(shared).as_posix() for path in paths]
    return dict(zip(names, folders, strict=True))


def _refuse_frames(sources: list[str]) -> None:
    """Raise InputError where two files of one folder differ in numbers only: a shell has put them for a glob."""
    found: dict[tuple[Path, str], str] = {}
    for source in sources:
        path = Path(source)
        other = found.setdefault((path.parent, re.sub(r"\d+", "0", path.name)), source)
        if other != source and path.suffix.lower() == ".exr" and path.is_file():
            raise InputError(
                f"{other} and {path.name}: frames of one shot, as it seems, and each would be denoised alone; "
                f"name their folder, {path.parent}, or put the glob in quotes; for single pictures, give one a command"
            )


def _folder_of(path: Path) -> Path:
    """For a glob of files their folder."""
    return path.parent if has_magic(path.name) and not path.exists() else path


def _without_pattern(path: Path) -> Path:
    """For a glob of files a path that holds no pattern: `shot/L` for `shot/*_L.exr`, `shot` for `shot/*.exr`."""
    if _folder_of(path) == path:
        return path
    rest = re.sub(r"\[.*?\]|[*?]", "", path.stem).strip("._- ")
    return path.parent / rest if rest else path.parent


def _folders(source: str, out: Path) -> list[str]:
    """The folders that a glob names, but for `out` and those in it, where the glob begins elsewhere; `source` itself
    where it is no glob of folders."""
    if not has_magic(source) or Path(source).exists():
        return [source]

    def is_output(path: str | Path) -> bool:
        return Path(path).resolve().is_relative_to(out.resolve())

    begins_there = is_output(Path(*takewhile(lambda part: not has_magic(part), Path(source).parts)))
    found = sorted(path for path in glob(source) if Path(path).is_dir() and (begins_there or not is_output(path)))
    return found or [source]


def denoise_shot(
    command: Denoise, source: str, out: Path, on_frame: Callable[[int, int], None] = lambda done, total: None
) -> list[str]:
    """Denoise one sequence. Returns what there is to say about it. Raises InputError as `run.denoise.denoise`."""
    from ..run.denoise import denoise
    from ..run.memory import keep_freed

    keep_freed()
    lines = told(denoise(source, out, command.settings, command.overwrite, on_frame))
    return lines + (write_preview(command.settings, source, out) if command.preview else [])


def write_preview(options: Options | CombineOptions, source: str, out: Path) -> list[str]:
    """Write the preview of a finished run. Returns what there is to say about it."""
    from ..data.opening import open_sequence
    from ..run.preview import preview

    sequence = open_sequence(
        source, signal=options.signal, preset=options.preset, layers=("reference",), allow_gaps=options.allow_gaps
    )
    files = preview(sequence, out, options.layout, options.recombine)
    lines = [f"preview: {', '.join(map(str, files))}"]
    return lines + ["preview.gif has 256 colours; install ffmpeg for preview.mp4"] * (files[-1].suffix == ".gif")


def _try(command: Denoise, source: str, out: Path) -> list[str] | InputError:
    """`denoise_shot` in a process of its own: an error is handed back, so that other shots go on."""
    try:
        return denoise_shot(command, source, out)
    except Exception as error:
        if (said := line(error)) is not None:
            return InputError(said)
        raise


def _start(threads: int) -> None:
    """Prepare a process: its share of the cores."""
    try:
        import torch
    except ModuleNotFoundError:  # the shaders do without
        return
    torch.set_num_threads(threads)


def told(summary: Summary, stage: str = "denoiser") -> list[str]:
    """What a run did, a line a fact. Counts of replaced and left out include the frames of interrupted runs before."""
    frames = summary.written + summary.skipped
    lines = [f"{counted(summary.written, 'frame')} written, {summary.skipped} were there"]
    if summary.written:
        lines.append(f"{stage}: {1000 * summary.seconds / summary.written:.0f} ms a frame")
    lines += summary.notes
    of_all = f" of {counted(frames, 'frame')}"
    lines += [f"replaced: {what} in {counted(count, 'pixel')}{of_all}" for what, count in summary.replaced.items()]
    passed_on = ((name, counted(count, "pixel")) for name, count in summary.passed_on.items())
    lines += [f"passed on as in the input: NaN in {pixels} of {name}" for name, pixels in passed_on]
    lines += [f"work saved: {what} in {count} of {frames} frames" for what, count in summary.left_out.items() if count]
    pairs = pairwise((1.0, *summary.exposure))
    changes = (max(gain / before, before / gain) for before, gain in pairs if gain != 1)
    if factors := [factor for factor in changes if factor > SEEN]:
        lines.append(f"exposure: all light changes in {len(factors)} of {frames} frames, by a factor of up to "
                     f"{max(factors):.3g}, and history with it")  # fmt: skip
    if summary.cuts:
        lines.append(f"cuts: history starts anew at frame {', '.join(map(str, summary.cuts))}")
    if summary.gaps:
        from ..data.files import describe_gap

        missing = ", ".join(map(describe_gap, summary.gaps))
        lines.append(f"gaps: history starts anew after each; missing: {missing}")
    return lines
