"""`rtdenoise inspect`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from tyro.conf import Positional, arg


@dataclass(frozen=True)
class Inspect:
    """Print what a sequence holds: layers, layout preset, motion statistics, and whether its motion vectors follow the
    convention."""

    source: Annotated[Positional[str], arg(metavar="SEQ")]
    """Folder of EXR files, or a glob in quotes."""
    signal: str = "color"
    """'color' or 'indirect'."""
    preset: str = "auto"
    """Layout of the files: 'auto', 'native', 'cycles', 'mitsuba', 'falcor', 'bmfr', 'oidn', 'noisebase', or a .toml
    file."""
    allow_gaps: bool = False
    """Accept missing frame numbers."""
    verbose: bool = False
    """Also list the work that every frame needs."""

    def run(self) -> None:
        from ..run.inspect import inspect, next_step, render_text

        options = {"signal": self.signal, "preset": self.preset, "allow_gaps": self.allow_gaps}
        found = inspect(self.source, **options)
        given = {name: value for name, value in options.items() if value != getattr(Inspect, name)}
        print(f"{render_text(found, verbose=self.verbose)}\n\nnext: {next_step(found, given)}")
