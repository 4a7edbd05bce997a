"""The configuration of the network that writes pixels (`hybrid`). Needs no torch."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from .config import AccumulatedKPNConfig, rounded_up, with_biases


@dataclass(frozen=True)
class HybridConfig(AccumulatedKPNConfig):
    """Kernel prediction and a network that writes pixels, mixed (`hybrid`). The fields of `AccumulatedKPNConfig` are
    those of its kernel prediction."""

    architecture: ClassVar[str] = "hybrid"
    inputs: ClassVar[int] = 9  # of the network that writes pixels: a footprint's radiance, albedo and normal

    recent: int = 8
    footprint: bool = True
    many: bool = False
    """For many samples a pixel: kernels count less, history as it is, and edges and uneven noise are left alone."""
    down: tuple[int, ...] = (32, 48, 64, 80, 96)
    """Channels of the network that writes pixels on its way down, at 1, 1/2, 1/4 ... of the image size."""
    up: tuple[int, ...] = (64, 64, 96, 112)
    """Channels of the first convolution of each level on the way up, at 1, 1/2 ... of the image size."""
    out: tuple[int, ...] = (32, 64, 96, 112)
    """Channels of the second convolution of each."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.footprint:
            raise ValueError("footprint: expected true, got false")
        if not isinstance(self.many, bool):
            raise ValueError(f"many: expected true or false, got {self.many!r}")
        for name in ("down", "up", "out"):
            object.__setattr__(self, name, tuple(getattr(self, name)))
            self.check_widths(name)
        if not len(self.up) == len(self.out) == len(self.down) - 1:
            raise ValueError(f"up, out: expected {len(self.down) - 1} widths each, got {self.up} and {self.out}")

    @property
    def convolutions(self) -> list[tuple[int, int]]:
        """(inputs, outputs) of each convolution on the way down: two at the finest and at the coarsest size, one at
        each between."""
        first, *rest = self.down
        return [(self.inputs, first), (first, first), *zip(self.down, rest, strict=False), (rest[-1], rest[-1])]

    @property
    def levels(self) -> list[tuple[int, int, int, int]]:
        """Channels of each level on the way up, finest first: from the coarser level, of the first convolution, of the
        skip connection (the input itself at full size, pooled features at others), and of the second convolution."""
        skips = self.inputs, *self.down[: len(self.up) - 1]
        return list(zip((*self.out[1:], self.down[-1]), self.up, skips, self.out, strict=True))

    @property
    def shapes(self) -> dict[str, tuple[int, ...]]:
        """As `NetworkConfig.shapes`."""
        shapes = {f"pixels.encoder.{i}.weight": (b, a, 3, 3) for i, (a, b) in enumerate(self.convolutions)}
        for i, (below, first, skip, second) in enumerate(self.levels):
            shapes[f"pixels.decoder.{i}.0.weight"] = first, below + skip, 3, 3
            shapes[f"pixels.decoder.{i}.2.weight"] = second, first, 3, 3
        shapes["pixels.last.weight"] = 3, self.out[0], 3, 3
        return super().shapes | with_biases(shapes)

    @property
    def network_reach(self) -> int:
        """As `NetworkConfig.network_reach`: the pixels' network sees what the kernels made."""
        return super().network_reach + rounded_up(3 * 2 ** len(self.down) + 1)
