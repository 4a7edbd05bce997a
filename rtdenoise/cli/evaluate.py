"""The commands `evaluate` and `report`; what they need is imported when they run."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from tyro.conf import Positional

from ..errors import InputError


@dataclass(frozen=True)
class Evaluate:
    """Measure error and time of many methods on sequences with references, in one run; what is there is kept."""

    sources: Positional[tuple[str, ...]]
    """Folders of EXR files with references; docs/report.md says how inputs at more samples are laid out."""
    out: Path
    """Folder for evaluation.json and the pictures."""
    methods: tuple[str, ...] = ()
    """Names as in docs/report.md (default: all), or NAME=FILE: the network of your own weights, under that name."""
    precision: tuple[str, ...] = ("fp32",)
    """'fp32', 'bf16'."""
    metrics: tuple[str, ...] = ()
    """Names as in docs/report.md (default: all but 'fovvideovdp')."""
    spp: tuple[int, ...] = (1,)
    """Samples per pixel of the inputs; n other than the sequence's own are read from its folder spp<n>."""
    signal: str = "color"
    """'color', 'indirect', or 'both' into OUT/color and OUT/indirect."""
    preset: str = "auto"
    """Layout of the files, as for inspect."""
    frames: int | None = None
    """At most so many of each sequence."""
    device: str = "auto"
    """'auto' (CUDA where there is a GPU), 'cpu' or 'cuda'."""

    def run(self) -> None:
        from ..evaluate.run import Options as EvaluateOptions
        from ..evaluate.run import run
        from ..models.inference import choose_device

        if not self.sources:
            raise InputError("no sequence: name one folder or more")
        if low := [n for n in (*self.spp, *([] if self.frames is None else [self.frames])) if n < 1]:
            raise InputError(f"--spp and --frames: expected 1 or more, got {low[0]}")
        device = choose_device(self.device)
        for signal in ("color", "indirect") if self.signal == "both" else (self.signal,):
            options = EvaluateOptions(
                self.methods, self.precision, self.metrics, self.spp, signal, self.preset, self.frames, device
            )
            out = self.out / signal if self.signal == "both" else self.out
            document = run(list(self.sources), out, options)
            print(f"{out}: {len(document.results)} results; `rtdenoise report {out}` draws them")


@dataclass(frozen=True)
class Report:
    """Turn what `evaluate` measured into report.html (one file, no network), report.md and report.png."""

    folder: Positional[Path]
    """Where evaluate wrote."""
    pictures: tuple[str, ...] = ()
    """Methods whose pictures the page holds (default: all)."""
    sequences: tuple[str, ...] = ()
    """Sequences whose pictures it holds (default: all)."""

    def run(self) -> None:
        from ..report import report

        written = report(self.folder, self.pictures, self.sequences)
        print("report:", ", ".join(str(path) for path in written))
        if "report.png" not in [path.name for path in written]:
            print("report.png needs matplotlib: pip install 'rtdenoise[bench]'")
