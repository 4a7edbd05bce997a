"""The configuration of the networks that write pixels (`hybrid`). Needs no torch."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from ..constants import MIX_SHARES, MIX_SHARES_OF_CLEAN, MIX_SHARES_OF_MANY
from .config import AccumulatedKPNConfig, rounded_up, with_biases

SURFACES = "albedo", "normal"  # what has a network of its own where it is cleaned


@dataclass(frozen=True)
class PixelShape:
    """The shape of a U-Net that writes pixels."""

    inputs: int = 3
    down: tuple[int, ...] = (32, 48, 64, 80, 96)
    up: tuple[int, ...] = (64, 64, 96, 112)
    out: tuple[int, ...] = (32, 64, 96, 112)
    twice: bool = False

    @property
    def stages(self) -> list[int]:
        """Convolutions at each size on the way down, finest first."""
        between = len(self.down) - 2
        return [2, *between * [2 if self.twice else 1], 2]

    @property
    def convolutions(self) -> list[tuple[int, int]]:
        """(inputs, outputs) of each convolution on the way down."""
        found, inputs = [], self.inputs
        for width, count in zip(self.down, self.stages, strict=True):
            found += [(inputs, width), *(count - 1) * [(width, width)]]
            inputs = width
        return found

    @property
    def levels(self) -> list[tuple[int, int, int, int]]:
        """Channels of each level on the way up, finest first: from the coarser level, of the first convolution, of the
        skip connection (the input itself at full size, pooled features at others), and of the second convolution."""
        skips = self.inputs, *self.down[: len(self.up) - 1]
        return list(zip((*self.out[1:], self.down[-1]), self.up, skips, self.out, strict=True))

    def shapes(self, prefix: str) -> dict[str, tuple[int, ...]]:
        """Name -> shape of its weights, without biases."""
        shapes = {f"{prefix}.encoder.{i}.weight": (b, a, 3, 3) for i, (a, b) in enumerate(self.convolutions)}
        for i, (below, first, skip, second) in enumerate(self.levels):
            shapes[f"{prefix}.decoder.{i}.0.weight"] = first, below + skip, 3, 3
            shapes[f"{prefix}.decoder.{i}.2.weight"] = second, first, 3, 3
        return shapes | {f"{prefix}.last.weight": (3, self.out[0], 3, 3)}

    @property
    def reach(self) -> int:
        """Pixels: input farther away cannot influence an output."""
        down = sum(count * 2**level for level, count in enumerate(self.stages))
        up = sum(2 * 2**level for level in range(len(self.up)))
        return down + up + 2 ** len(self.up)  # with the last convolution, and pixels within a coarsest cell


@dataclass(frozen=True)
class HybridConfig(AccumulatedKPNConfig):
    """Kernel prediction and a network that writes pixels, mixed (`hybrid`). The fields of `AccumulatedKPNConfig` are
    those of its kernel prediction."""

    architecture: ClassVar[str] = "hybrid"
    inputs: ClassVar[int] = 9  # of the network that writes pixels: a footprint's radiance, albedo and normal

    recent: int = 8
    footprint: bool = True
    many: bool = False
    """For many samples a pixel: kernels count less, history as it is; edges, uneven noise and fireflies stay."""
    down: tuple[int, ...] = PixelShape.down
    """Channels of the network that writes pixels on its way down, at 1, 1/2, 1/4 ... of the image size."""
    up: tuple[int, ...] = PixelShape.up
    """Channels of the first convolution of each level on the way up, at 1, 1/2 ... of the image size."""
    out: tuple[int, ...] = PixelShape.out
    """Channels of the second convolution of each."""
    twice: bool = False
    """Two convolutions at each size on the way down; else one at those between the finest and the coarsest."""
    clean: bool = False
    """Networks of their own, one each, filter albedo and normal before."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.footprint:
            raise ValueError("footprint: expected true, got false")
        for name in ("many", "twice", "clean"):
            if not isinstance(getattr(self, name), bool):
                raise ValueError(f"{name}: expected true or false, got {getattr(self, name)!r}")
        for name in ("down", "up", "out"):
            object.__setattr__(self, name, tuple(getattr(self, name)))
            self.check_widths(name)
        if not len(self.up) == len(self.out) == len(self.down) - 1:
            raise ValueError(f"up, out: expected {len(self.down) - 1} widths each, got {self.up} and {self.out}")

    @property
    def pixels(self) -> PixelShape:
        """The shape of the network that writes pixels."""
        return PixelShape(self.inputs, self.down, self.up, self.out, self.twice)

    @property
    def surfaces(self) -> dict[str, PixelShape]:
        """Those of the networks that filter albedo and normal."""
        return dict.fromkeys(SURFACES, PixelShape()) if self.clean else {}

    @property
    def shares(self) -> tuple[float, float, float]:
        """As the constants of `ops.mix` say."""
        return MIX_SHARES_OF_MANY if self.many else MIX_SHARES_OF_CLEAN if self.clean else MIX_SHARES

    @property
    def kernels_need_history(self) -> bool:
        """Whether, in frames as those of Cycles (`Frame.more_history`), the kernels' picture shows only where a pixel
        around has a history: what is written from clean albedo and normal is better there (docs/notes/many.md)."""
        return self.many and self.clean

    @property
    def shapes(self) -> dict[str, tuple[int, ...]]:
        """As `NetworkConfig.shapes`."""
        shapes = self.pixels.shapes("pixels")
        for name, shape in self.surfaces.items():
            shapes |= shape.shapes(f"pixels.surfaces.{name}")
        return super().shapes | with_biases(shapes)

    @property
    def network_reach(self) -> int:
        """As `NetworkConfig.network_reach`: the pixels' network sees what the kernels made, and filtered surfaces; a
        firefly is seen by the pixels beside it."""
        surfaces = max((shape.reach for shape in self.surfaces.values()), default=0)
        return super().network_reach + rounded_up(self.pixels.reach + surfaces + 1)
