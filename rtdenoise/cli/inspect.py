"""`rtdenoise inspect`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
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
    write: Annotated[Path | None, arg(metavar="FILE.toml")] = None
    """Write a layout preset for files that no preset knows, layers by the names of channels and files, or for frames
    of Cycles whose motion vectors are otherwise. What these mean is measured."""
    verbose: bool = False
    """Also list the work that every frame needs."""

    def run(self) -> None:
        from ..errors import InputError
        from ..run.inspect import inspect
        from ..run.inspect_text import next_step, render_text

        preset = self.preset
        if self.write:
            from ..run.describe import write_description

            if preset != "auto":
                raise InputError(f"--write describes files that no preset knows: leave out --preset {preset}")
            notes = write_description(self.source, self.write, self.signal, self.allow_gaps)
            preset = str(self.write)
            print("\n".join([f"wrote {preset}", *(f"  {layer + ':':<12} {told}" for layer, told in notes.items()), ""]))
        options = {"signal": self.signal, "preset": preset, "allow_gaps": self.allow_gaps}
        found = inspect(self.source, **options)
        given = {name: value for name, value in options.items() if value != getattr(Inspect, name)}
        print(f"{render_text(found, verbose=self.verbose)}\n\nnext: {next_step(found, given)}")
