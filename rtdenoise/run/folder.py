"""The output folder of a run: never that of the input; what tells runs apart; the summary that it ends with."""

from __future__ import annotations

import contextlib
import hashlib
import json
import tempfile
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING

from ..data.exr import read_header
from ..data.output_files import protect_input
from ..data.sequences import Sequence
from ..errors import InputError
from ..files import dumps, remove_unfinished, stamp, write_atomically
from ..models.presets import SHRINKAGE
from ..models.weights import bytes_beside, files_of, find
from .options import told_of_shutter
from .summary import SUMMARY

if TYPE_CHECKING:
    from .options import CombineOptions, Options
    from .summary import Summary

INDECISIVE = ("backend", "device", "detect_lens")  # options that leave the files as they are, but for `lens`


def prepare(out: Path, sequence: Sequence, options: Options) -> Path:
    """The output folder, made if need be. Raises InputError where it holds the input or cannot be written to."""
    protect_input(sequence, out, options.layout, options.recombine)
    if sequence.surfaces:
        protect_input(sequence.surfaces.sequence, out, "plain", False)
    try:
        out.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=out).close()
    except OSError as error:
        raise InputError(f"{out}: cannot write there: {error.strerror}") from None
    return out


def refuse_no_folder(hidden: Path) -> None:
    """Raise InputError where a folder in the output folder is a link, or a file: of another program."""
    if hidden.is_symlink() or not (hidden.is_dir() or not hidden.exists()):
        raise InputError(f"{hidden}: not a folder of this program; remove it or choose another --out")


def clear(hidden: Path, is_ours: Callable[[str], object]) -> None:
    """Remove the files of these names from a folder in the output folder, and that unless it holds anything else."""
    if hidden.is_symlink() or not hidden.is_dir():
        return
    remove_unfinished(hidden)
    with contextlib.suppress(OSError):
        for path in hidden.iterdir():
            if is_ours(path.name):
                path.unlink()
        hidden.rmdir()


def refuse_foreign(out: Path, names: Iterable[list[str]]) -> None:
    """Raise InputError where `out`, which has no state, holds a file of the output. `names`: of `output_names`."""
    if clash := [name for name in chain(*names) if (out / name).exists()]:
        raise InputError(
            f"{out / clash[0]}: exists and is not from an earlier run; choose another --out or pass --overwrite"
        )


def digest(sequence: Sequence, options: Options) -> list[str]:
    """Tells runs apart that would write different files: entry k is for the first k frames, whatever comes after."""
    parts = _decisive(options)
    parts["layers"] = [repr(sequence.rules), repr(sequence.layout)]  # a layout of one's own may have been mended
    if options.model != SHRINKAGE:
        files = files_of(find(options.model))
        parts["weights"] = digest_of(files)
        if options.precision in ("auto", "int8") and (in_bytes := bytes_beside(files)):
            parts["bytes"] = digest_of(in_bytes)
    scene = sequence.scene or {}
    parts["scene"] = {key: value for key, value in scene.items() if key != "frames"}
    cameras = {entry["number"]: entry for entry in scene.get("frames", ())}
    others = {}
    if surfaces := sequence.surfaces:
        parts["surfaces"], others = [repr(surfaces.sequence.rules), repr(surfaces.sequence.layout)], surfaces.files
    running = hashlib.sha256(json.dumps(parts, sort_keys=True, default=list).encode())
    found = [running.hexdigest()]
    for frame in sequence.files:
        paths = *frame.files.values(), *others.get(frame.number, ())
        inputs = [stamp(path) for path in paths]
        seen = [cameras.get(frame.number + step) for step in (-1, 0, 1)]  # what its motion is computed from
        running.update(json.dumps([inputs, seen], sort_keys=True).encode())
        found.append(running.hexdigest())
    return found


def digest_of(files: list[Path]) -> str:
    """SHA-256 of their contents, one after the other."""
    return hashlib.sha256(b"".join(file.read_bytes() for file in files)).hexdigest()


def refuse_other(out: Path, state: Mapping, options: Options, fingerprint: str) -> None:
    """Raise InputError where the state in `out` (`denoise.read_state`) is of a run with another fingerprint."""
    if state["fingerprint"] == fingerprint:
        return
    before = _by_files(state["options"])
    now = json.loads(json.dumps(_decisive(options)))  # tuples become lists, as in `before`
    changed = [key for key in now if key in before and before[key] != now[key]]  # `combine` has other options
    told = ", ".join(
        f"{key.replace('_', '-')} {_shown(before[key])}, now {_shown(now[key])}" for key in changed
    )
    unseen = "another input, layout or weights: a finished frame's input was changed or removed, perhaps"
    other = f"other options: {told}" if told else unseen
    raise InputError(f"{out}: holds frames of a run with {other}; choose another --out or pass --overwrite")


class Written:
    """The finished files, as one digest of their names and sizes in bytes."""

    def __init__(self, out: Path, frames: Iterable[list[str]]) -> None:
        self._out, self._hash = out, hashlib.sha256()
        for names in frames:
            self.add(names)

    def add(self, names: list[str]) -> None:
        """Take in the files of one more frame."""
        for name in names:
            self._hash.update(f"{name}\0{(self._out / name).stat().st_size}\n".encode("utf-8", "surrogateescape"))

    @property
    def digest(self) -> str:
        """Hexadecimal."""
        return self._hash.hexdigest()


def are_finished(out: Path, frames: list[list[str]], size: tuple[int, int], written: str) -> bool:
    """Whether all files of these frames are there. Raises InputError where one is no complete EXR file of this size
    (height, width) any more, or the files are not those of `written`, a `Written.digest`."""
    finished = list(chain(*frames))
    if any(not (out / name).exists() for name in finished):
        return False
    for name in finished:
        _refuse_junk(out / name, size)
    if written != Written(out, frames).digest:
        raise InputError(f"{out}: a finished frame has another size in bytes than it was written with; pass "
                         "--overwrite to denoise all of them again")  # fmt: skip
    return True


def told_of_output(sequence: Sequence, options: Options | CombineOptions) -> list[str]:
    """What the user should know of the files."""
    if sequence.demodulated and options.layout == "plain" and not options.recombine:
        return ["R,G,B is light without the surface's colour, as in the input: --recombine makes the beauty of it, "
                "--layout source puts it in its layer"]  # fmt: skip
    return []


def conclude(
    out: Path, sequence: Sequence, options: Options | CombineOptions, notes: list[str], summary: Summary
) -> None:
    """End a run into `out`: put into its summary all that there is to say, each once, `notes` of before the first
    frame in front, and write it."""
    told = [*notes, *told_of_shutter(options), *told_of_output(sequence, options), *summary.notes]
    told += [sequence.drifts.told] if options.lens else []
    summary.notes = list(dict.fromkeys(told))
    write_summary(out / SUMMARY, sequence, options, summary)


def write_summary(path: Path, sequence: Sequence, options: Options, summary: Summary) -> None:
    """Write what a run did as JSON."""
    plan = summary.plan and summary.plan.to_json()
    document = {
        "frames": len(sequence), "first": sequence.numbers[0], "last": sequence.numbers[-1], "size": sequence.size,
        "options": asdict(options), **asdict(summary), "plan": plan,
    }  # fmt: skip
    write_atomically(path, (dumps(document, indent=1) + "\n").encode())


def _decisive(options: Options) -> dict:
    """The options that change the files."""
    parts = {name: value for name, value in asdict(options).items() if name not in INDECISIVE}
    if not (options.surfaces or getattr(options, "motion_blur", False)):
        parts = {name: value for name, value in parts.items() if not name.startswith("shutter")}
    return _by_files(parts)


def _by_files(options: Mapping) -> dict:
    """Options in which other renders count by their files alone, whatever their folders are called."""
    second = {"second": "another render"} if options.get("second") else {}
    return {**options, "surfaces": bool(options.get("surfaces")), **second}


def _shown(value: object) -> object:
    return "none" if value == "" else value


def _refuse_junk(path: Path, size: tuple[int, int]) -> None:
    try:
        header = read_header(path)
        problem = None if (header.height, header.width) == size else f"{header.width}×{header.height} pixels"
    except InputError as error:
        problem = str(error).removeprefix(f"{path}: ")
    if problem:
        raise InputError(f"{path}: this frame was finished, and has been damaged or replaced since ({problem}); remove "
                         "it, or pass --overwrite")  # fmt: skip
