"""The sequences that methods are measured on: with references, at one or more samples per pixel.

shot/               frames with references: the input at the base spp
shot/spp4/          the same frames at 4 spp with features; references are read from shot/
shot/samples.json   {"spp": 1, "sample_ms": 38.5}: the base spp (default: as the files note it, or 1), and the time in
                    ms that one more sample per pixel takes to render, to convert samples to time; both are optional
converged/          with `reference`: the same frames, converged, where shot/ holds no references
"""

from __future__ import annotations

import hashlib
import json
import math
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from torch import Tensor

from ..data.opening import open_sequence
from ..data.sequences import Sequence
from ..errors import InputError
from ..files import read_json, stamp
from ..frame import Frame
from ..metrics.image import decibels, masked_mean, reference_mse
from ..run.pairs import are_same
from .measure import check_references
from .sequence import Frames

LAYERS = ("reference", "reference_half")
EXTRA = ("components", "position", "samples")  # that some methods read beside the usual ones, where there are any


@dataclass(frozen=True)
class Source:
    """A sequence with references, and its inputs at other sample counts."""

    name: str
    folder: Path
    base: Sequence
    spp: int  # of the base
    sample_ms: float | None  # render time of one sample per pixel a frame; None: not known
    limit: int | None  # frames; None: all
    options: dict  # for `open_sequence`
    converged: Sequence | None = field(default=None, repr=False)  # the references, if they are in files of their own

    @classmethod
    def open(
        cls, folder: str | Path, signal: str, preset: str, limit: int | None, reference: str | Path | None = None
    ) -> Source:
        """`reference`: a folder with the same frames, converged; None: `folder` has the references as layers.

        Raises InputError where frames, references or (between frames) motion are missing, the frames of `reference` are
        other ones or hold the same light, or samples.json is not as above.
        """
        folder = Path(folder)
        if not folder.is_dir():
            raise InputError(f"{folder}: expected a folder of EXR files: results go by its name")
        options = {"signal": signal, "preset": preset, "layers": (*LAYERS, *EXTRA)}
        base = open_sequence(folder, **options)
        converged = None if reference is None else _same_frames(open_sequence(reference, **options), base, limit)
        base.require(*(["motion"] if len(base) > 1 else []))
        if not converged:
            try:
                base.require("reference")
            except InputError as error:
                raise InputError(f"{error}; or name a folder of converged frames: --reference DIR") from None
        elif not converged.has("reference"):
            _refuse_same(converged, base, len(base.numbers[:limit]))
        facts = _facts(folder / "samples.json")
        spp, sample_ms = facts.get("spp", round(base.header.samples) or 1), facts.get("sample_ms")
        return cls(folder.resolve().name, folder, base, spp, sample_ms, limit, options, converged)

    def at(self, spp: int) -> Sequence:
        """The sequence at that many samples per pixel. Raises InputError where there is none, or its frames differ."""
        if spp == self.spp:
            return self.base
        folder = self.folder / f"spp{spp}"
        if not folder.is_dir():
            raise InputError(f"{folder}: no input at {spp} spp; render the same frames into it, or say in "
                             f"{self.folder / 'samples.json'} if these have as many")  # fmt: skip
        return _same_frames(open_sequence(folder, **self.options), self.base, self.limit)

    @property
    def length(self) -> int:
        """How many frames are measured."""
        return min(len(self.base), self.limit or len(self.base))

    def frames(self, spp: int) -> Frames:
        """The frames at that many samples, with references. Raises InputError where references are not finite.

        `samples` is what the files say, or else `spp`: methods that correct frames depend on it.
        """
        sequence = self.at(spp)
        elsewhere = self.converged is not None or sequence is not self.base  # the references

        def read(i: int) -> Frame:
            frame = sequence[i].with_samples(spp)
            return replace(frame, **self.references(i)) if elsewhere else frame

        frames = Frames(self.length, read)
        check_references(frames)
        return frames

    def references(self, i: int) -> dict[str, Tensor | None]:
        """`reference` and `reference_half` of frame i, as fields of `Frame`."""
        frame = (self.converged or self.base)[i]
        if self.converged and frame.reference is None:  # a converged render holds the truth in its noisy layers
            return {"reference": frame.radiance, "reference_half": None}
        return {layer: getattr(frame, layer) for layer in LAYERS}

    def fingerprint(self, spp: int) -> str:
        """A string that differs between inputs whose errors may differ."""
        sequences = [self.base, self.at(spp), *([self.converged] if self.converged else [])]
        paths = [path for sequence in sequences for f in sequence.files for path in f.files.values()]
        facts = [[*path.parts[-2:-1], *stamp(path)] for path in paths]
        text = json.dumps([facts, self.length, self.options, *self._read_by()], sort_keys=True, default=list)
        return hashlib.sha256(text.encode()).hexdigest()[:16]

    def _read_by(self) -> list:
        """What the frames depend on beside their files: a layout of one's own, cameras that motion comes from."""
        own = [repr(self.base.layout)] if self.options["preset"].endswith(".toml") else []
        computed = self.base.scene and not {"depth", "motion", "motion_next"} <= self.base.available.keys()
        return [*own, *([self.base.scene] if computed else [])]


def reference_errors(frames: Frames | list[Frame]) -> dict[str, float | None]:
    """`reference_relmse` and `reference_psnr`: the references' own errors, from their halves; None without halves.

    With r₁ one half of the samples of r, E[(r - r₁)²] is the variance of r: a half has twice the variance, and r₁ is
    half of r.
    """
    scale, relative, shown = Frames.of(frames).exposure, [], []
    for frame in frames:
        if frame.reference_half is None:
            return {"reference_relmse": None, "reference_psnr": None}
        r, half = frame.reference * scale, frame.reference_half * scale
        relative.append(masked_mean((r - half).square() / (r.square() + 0.01), None))
        shown.append(reference_mse(frame.reference, frame.reference_half, scale))
    return {"reference_relmse": float(np.mean(relative)), "reference_psnr": decibels(float(np.mean(shown)))}


def _same_frames(sequence: Sequence, base: Sequence, limit: int | None) -> Sequence:
    """`sequence`, which must have the size and the first `limit` frame numbers of `base`."""
    expected = base.numbers[:limit]
    if sequence.size != base.size or sequence.numbers[: len(expected)] != expected:
        raise InputError(f"{sequence.files[0].path.parent}: expected {_told(base, expected)} as in "
                         f"{base.files[0].path.parent}, found {_told(sequence, sequence.numbers)}")  # fmt: skip
    return sequence


def _refuse_same(converged: Sequence, base: Sequence, count: int) -> None:
    """The first, the middle and the last of `count` frames are compared."""
    both = [sequence.only(("radiance",)) for sequence in (base, converged)]
    if are_same(tuple(sequence.read(i).radiance for sequence in both) for i in sorted({0, count // 2, count - 1})):
        raise InputError(f"{converged.files[0].path}: is the same picture as {base.files[0].path}: name the converged "
                         "frames (--reference)")  # fmt: skip


def _told(sequence: Sequence, numbers: tuple[int, ...]) -> str:
    height, width = sequence.size
    return f"{len(numbers)} frames {numbers[0]} to {numbers[-1]} of {width}×{height}"


def _facts(path: Path) -> dict:
    if not path.is_file():
        return {}
    facts = read_json(path)
    try:
        spp, sample_ms = facts.get("spp", 1), float(facts.get("sample_ms") or 0)
        if isinstance(spp, bool) or int(spp) != spp or spp < 1 or not 0 <= sample_ms < math.inf:
            raise ValueError(f"spp {spp!r}, sample_ms {sample_ms:g}")
        return ({"spp": int(spp)} if "spp" in facts else {}) | {"sample_ms": sample_ms or None}
    except (ValueError, TypeError, AttributeError, OverflowError) as error:
        raise InputError(f'{path}: expected {{"spp": 1, "sample_ms": 38.5}}, found otherwise ({error})') from None
