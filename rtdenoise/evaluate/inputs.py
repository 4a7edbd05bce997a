"""What is measured on: sequences with references, at one and at more samples per pixel.

shot/               frames with references: the input at the base spp
shot/spp4/          the same frames at 4 spp, with features but without references: those of shot/ are taken
shot/samples.json   {"spp": 1, "sample_ms": 38.5}: the base spp (1 where there is no such file), and what one more
                    sample a pixel costs the renderer, which turns samples into time; both optional
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch

from ..color import display_exposure
from ..data.sequences import Sequence, open_sequence
from ..errors import InputError
from ..frame import Frame
from ..metrics.image import decibels, masked_mean, reference_mse

LAYERS = ("reference", "reference_half")


@dataclass(frozen=True)
class Source:
    """A sequence with references, and where its inputs at other sample counts are."""

    name: str
    folder: Path
    base: Sequence
    spp: int  # of the base
    sample_ms: float | None  # render time of one sample per pixel a frame; None: not known
    limit: int | None  # frames; None: all
    options: dict  # for `open_sequence`

    @classmethod
    def open(cls, folder: str | Path, signal: str, preset: str, limit: int | None) -> Source:
        """Raises InputError where frames, references or motion are missing, or samples.json is not what it should
        be."""
        if not Path(folder).is_dir():
            raise InputError(f"{folder}: expected a folder of EXR files: results go by its name")
        options = {"signal": signal, "preset": preset, "layers": LAYERS}
        base = open_sequence(folder, **options).require("reference", "motion")
        facts = _facts(Path(folder) / "samples.json")
        return cls(
            Path(folder).resolve().name, Path(folder), base, facts.get("spp", 1), facts.get("sample_ms"), limit, options
        )

    def at(self, spp: int) -> Sequence:
        """The sequence at that many samples per pixel. Raises InputError where there is none, or it does not fit."""
        if spp == self.spp:
            return self.base
        folder = self.folder / f"spp{spp}"
        if not folder.is_dir():
            raise InputError(f"{folder}: no input at {spp} spp; render the same frames into it (--spp {spp})")
        sequence = open_sequence(folder, **self.options)
        if sequence.size != self.base.size or sequence.numbers[: self.length] != self.base.numbers[: self.length]:
            raise InputError(f"{folder}: expected the frames {self.base.numbers} of size {self.base.size} as in "
                             f"{self.folder}, found {sequence.numbers} of {sequence.size}")  # fmt: skip
        return sequence

    @property
    def length(self) -> int:
        """How many frames are measured."""
        return min(len(self.base), self.limit or len(self.base))

    def frames(self, spp: int) -> list[Frame]:
        """All frames at that many samples, with the references of the base."""
        sequence, references = self.at(spp), (self.base[i] for i in range(self.length))
        return [
            replace(sequence[i], reference=base.reference, reference_half=base.reference_half)
            for i, base in enumerate(references)
        ]

    def fingerprint(self, spp: int) -> str:
        """Tells inputs apart that would give other errors."""
        paths = [path for sequence in (self.base, self.at(spp)) for f in sequence.files for path in f.files.values()]
        facts = [[*path.parts[-2:], path.stat().st_size, path.stat().st_mtime_ns] for path in paths]
        text = json.dumps([facts, self.length, self.options], sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()[:16]


def reference_errors(frames: list[Frame]) -> dict[str, float | None]:
    """`reference_relmse` and `reference_psnr`: the errors that the references themselves have, from their halves; None
    where these are not known.

    r₁ being one half, E[(r - r₁)²] is the variance of r: that of a half is twice as large, and r₁ makes up half of r.
    """
    if any(frame.reference_half is None for frame in frames):
        return {"reference_relmse": None, "reference_psnr": None}
    scale = display_exposure(torch.cat([frame.reference for frame in frames]))
    pairs = [(frame.reference * scale, frame.reference_half * scale) for frame in frames]
    relative = [masked_mean((r - half).square() / (r.square() + 0.01), None) for r, half in pairs]
    shown = [reference_mse(frame.reference, frame.reference_half, scale) for frame in frames]
    return {"reference_relmse": float(np.mean(relative)), "reference_psnr": decibels(float(np.mean(shown)))}


def _facts(path: Path) -> dict:
    if not path.is_file():
        return {}
    try:
        facts = json.loads(path.read_text())
        return {"spp": int(facts.get("spp", 1)), "sample_ms": facts.get("sample_ms") and float(facts["sample_ms"])}
    except (ValueError, TypeError, AttributeError) as error:
        raise InputError(f'{path}: expected {{"spp": 1, "sample_ms": 38.5}}, found otherwise ({error})') from None
