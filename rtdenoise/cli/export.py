"""`rtdenoise export`."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from ..errors import InputError


@dataclass(frozen=True)
class Export:
    """Write the shaders, weights and dispatches of a network for an engine that denoises without Python."""

    out: Path
    """New folder for export.json, glsl/, spirv/, weights.bin and sample/."""
    model: str = "default"
    """The network: 'hybrid', 'hybrid-many', 'hybrid-fast', 'hybrid-large', 'hybrid-large-many', 'default', 'many',
    'fast', 'paper', or a .safetensors file that `rtdenoise train` wrote."""
    size: str = "1280x720"
    """WIDTHxHEIGHT of the frames, in pixels."""
    precision: Literal["fp32", "fp16"] = "fp32"
    """Of the stored activations."""
    recent: int | None = None
    """Recent frames to keep, 20 bytes a pixel each (hybrids: 32); 0: a running mean, at some quality. As many as the
    network keeps unless given."""

    def run(self) -> None:
        from ..glsl.export import export

        done = export(self.out, self.model, read_size(self.size), self.precision == "fp16", self.recent)
        print(
            f"{self.out}: {done.shaders} shaders, {done.dispatches} dispatches a frame, {done.weights / 1e6:.1f} MB of "
            "weights, two sample frames with checksums; docs/use/engines.md explains export.json"
        )
        if not done.spirv:
            print("GLSL alone: for SPIR-V install glslang (Debian: apt install glslang-tools), then export to another "
                  "folder")  # fmt: skip


def read_size(text: str) -> tuple[int, int]:
    """(H, W) from "WIDTHxHEIGHT". Raises InputError for anything else."""
    match = re.fullmatch(r"([1-9]\d{0,4})[x×]([1-9]\d{0,4})", text)
    if not match:
        raise InputError(f"--size: expected WIDTHxHEIGHT such as 1280x720, of 99999 at most each, got {text!r}")
    return int(match[2]), int(match[1])
