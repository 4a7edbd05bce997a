"""`rtdenoise evaluate`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from ..errors import InputError
from ..wording import counted
from .lists import split_names
from .progress import progress_bar


@dataclass(frozen=True)
class Evaluate:
    """Measure error and time of several methods on sequences with references, in one run. Results that --out holds
    already are kept."""

    sources: Annotated[Positional[tuple[Path, ...]], arg(metavar="SEQ ...", help_behavior_hint="(one or more)")]
    """Folders of EXR files with references; inputs at n samples per pixel lie in the folder spp<n> of each."""
    out: Path
    """Folder for evaluation.json and the pictures."""
    methods: Annotated[tuple[str, ...], arg(help_behavior_hint="(default: nine)")] = ()
    """Method names, with spaces or commas between them, or 'all'. NAME=FILE measures the network of a weights file
    under that name."""
    precision: tuple[str, ...] = ("fp32",)
    """'fp32', 'bf16', 'int8'."""
    metrics: Annotated[tuple[str, ...], arg(help_behavior_hint="(default: all but fovvideovdp)")] = ()
    """Metric names."""
    spp: Annotated[tuple[int, ...], arg(help_behavior_hint="(default: of the frames in SEQ)")] = ()
    """Samples per pixel of the inputs."""
    reference: Annotated[tuple[Path, ...], arg(help_behavior_hint="(default: the layers of SEQ)")] = ()
    """Folders of converged renders of the same frames, one a sequence, where the references are in other files."""
    signal: str = "color"
    """'color', 'indirect', or 'both' into OUT/color and OUT/indirect."""
    preset: str = "auto"
    """Layout of the files, as for inspect."""
    frames: Annotated[int | None, arg(help_behavior_hint="(default: all)")] = None
    """At most this many frames of each sequence."""
    device: str = "auto"
    """'auto' (CUDA where there is a GPU), 'cpu' or 'cuda'."""

    def run(self) -> None:
        if not self.sources:
            raise InputError("no sequence: name at least one folder")
        if low := [n for n in (*self.spp, *([] if self.frames is None else [self.frames])) if n < 1]:
            raise InputError(f"--spp and --frames: expected 1 or more, got {low[0]}")
        for signal in ("color", "indirect") if self.signal == "both" else (self.signal,):
            self._measure(signal, self.out / signal if self.signal == "both" else self.out)

    def _measure(self, signal: str, out: Path) -> None:
        from rich.console import Console
        from rich.progress import TextColumn

        from ..evaluate.options import EvaluateOptions
        from ..evaluate.registry import choose
        from ..evaluate.run import run
        from ..models.inference import automatic, choose_device
        from ..report.summary import summary

        options = EvaluateOptions(
            split_names(self.methods), split_names(self.precision), split_names(self.metrics), self.spp, signal,
            self.preset, self.frames, choose_device(self.device), self.reference,
        )  # fmt: skip
        with progress_bar("evaluating", TextColumn("{task.description}", markup=False)) as bar:
            task = bar.add_task("", total=None)

            def on_step(label: str, done: int, total: int) -> None:
                bar.update(task, description=label, completed=done, total=total)

            def say(line: str) -> None:
                bar.console.print(line, soft_wrap=True)

            document = run(self.sources, out, options, say, on_step)
        if not document.results:
            raise InputError(f"{out}: nothing was measured, for the reasons above")
        own = automatic(options.device)
        networks = [m for m in choose(options.methods) if m.family == "network" and len(m.precisions) > 1]
        if networks and own not in options.precisions:
            print(f"the networks ran in {', '.join(options.precisions)}; `denoise` runs most in {own} here, which is "
                  f"faster: --precision {own} measures that")  # fmt: skip
        Console(markup=False, emoji=False).print(summary(document.results))
        print(f"{out}: {counted(len(document.results), 'result')}; `rtdenoise report {out}` draws them")
