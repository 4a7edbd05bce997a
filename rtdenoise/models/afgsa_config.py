"""The configuration of guided self-attention (`afgsa`). Needs no torch."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

from .config import CELL, MAX_KERNEL, MAX_WIDTH, Head, NetworkConfig, rounded_up, with_biases

LIGHT, FEATURES = 3, 7  # channels: noisy light; normal 3, nearness 1, albedo 3
EXTRACTORS = (1, 3, 5)  # sides of the convolutions that read the input
MAX_BLOCKS, MAX_SIDE = 16, 32


@dataclass(frozen=True)
class GuidedAttentionConfig(NetworkConfig):
    """A network that denoises each frame alone (`afgsa`)."""

    architecture: ClassVar[str] = "afgsa"
    carries: ClassVar[tuple[str, ...]] = ()
    motion: ClassVar[None] = None
    features: ClassVar[int] = LIGHT + FEATURES

    width: int = 256
    """Channels of every layer."""
    blocks: int = 5
    """Attention blocks, one after the other."""
    block: int = 8
    """Side in pixels of the blocks whose pixels share a window."""
    halo: int = 3
    """Pixels by which a window is larger than its block on every side."""
    attention_heads: int = 4
    """Parts into which the channels are split for attention."""
    guide: str = "guided"
    """'guided': queries and keys from light and features, values from light. 'concatenated': light and features are
    joined in the input and all three come from there. 'none': the network sees no features."""
    unet: tuple[int, ...] = ()
    """Widths of a U-Net in place of extractors and attention blocks, as a control; (): none."""
    output: str = "residual"
    """'residual': added to the logarithm of the light, as in the paper. 'kernel': kernels at three scales filter light
    over albedo."""
    kernel: int = 9
    """Side of the kernels of the output 'kernel', odd."""
    mirrored: bool = True
    """The last convolutions mirror the picture at its borders, as all others do; else zeros lie there."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "unet", tuple(self.unet))
        names = ("width", "blocks", "block", "halo", "attention_heads", "kernel")
        integers = [*(getattr(self, name) for name in names), *self.unet]
        if any(not isinstance(value, int) or isinstance(value, bool) for value in integers):
            raise ValueError(f"expected whole numbers for {', '.join(names)} and unet, got {integers}")
        limits = {"width": (1, MAX_WIDTH), "blocks": (1, MAX_BLOCKS), "block": (1, MAX_SIDE), "halo": (0, MAX_SIDE),
                  "attention_heads": (1, self.width), "kernel": (1, MAX_KERNEL)}  # fmt: skip
        for name, (least, most) in limits.items():
            if not least <= (value := getattr(self, name)) <= most:
                raise ValueError(f"{name}: expected {least} to {most}, got {value}")
        if self.width % (2 * self.attention_heads):
            raise ValueError(
                f"expected a width in {self.attention_heads} heads of an even number each, got {self.width}"
            )
        if not isinstance(self.mirrored, bool):
            raise ValueError(f"mirrored: expected true or false, got {self.mirrored!r}")
        if self.kernel % 2 == 0:
            raise ValueError(f"kernel: expected an odd size up to {MAX_KERNEL}, got {self.kernel}")
        if self.guide not in ("guided", "concatenated", "none"):
            raise ValueError(f"expected a guide 'guided', 'concatenated' or 'none', got {self.guide!r}")
        if self.output not in ("residual", "kernel"):
            raise ValueError(f"expected an output 'residual' or 'kernel', got {self.output!r}")
        if self.unet and not (2 <= len(self.unet) <= 6 and all(1 <= width <= MAX_WIDTH for width in self.unet)):
            raise ValueError(f"unet: expected 2 to 6 widths from 1 to {MAX_WIDTH}, got {self.unet}")

    @property
    def heads(self) -> tuple[tuple[Head, ...], ...]:
        """The residual; or at full size the kernel, at 1/2 and 1/4 the kernel and α."""
        if self.output == "residual":
            return ((Head("residual", 3),),)
        kernel = Head("spatial", self.kernel**2)
        return (kernel,), (kernel, Head("alpha", 1)), (kernel, Head("alpha", 1))

    @property
    def inputs(self) -> tuple[int, int]:
        """Channels of the two extractors: of light, and of the guide (0: there is none)."""
        return {"guided": (LIGHT, FEATURES), "concatenated": (LIGHT + FEATURES, 0), "none": (LIGHT, 0)}[self.guide]

    @property
    def shapes(self) -> dict[str, tuple[int, ...]]:
        """As `NetworkConfig.shapes`."""
        C, (light, guide) = self.unet[0] if self.unet else self.width, self.inputs
        shapes: dict[str, tuple[int, ...]] = {}
        if self.unet:
            for i, (a, b) in enumerate(zip((light + guide, *self.unet), self.unet, strict=False)):
                shapes |= {f"unet.encoder.{i}.0.weight": (b, a, 3, 3), f"unet.encoder.{i}.2.weight": (b, b, 3, 3)}
            for i, (b, a) in enumerate(zip(self.unet, self.unet[1:], strict=False)):
                shapes |= {f"unet.decoder.{i}.0.weight": (b, a + b, 3, 3), f"unet.decoder.{i}.2.weight": (b, b, 3, 3)}
        else:
            for name, inputs in (("light", light), ("guide", guide)) if guide else (("light", light),):
                shapes |= {f"{name}.sides.{i}.weight": (C, inputs, s, s) for i, s in enumerate(EXTRACTORS)}
                shapes[f"{name}.join.weight"] = (C, len(EXTRACTORS) * C, 1, 1)
            if guide:
                shapes["guide.last.weight"] = (C, C, 1, 1)
            for i in range(self.blocks):
                shapes |= {f"blocks.{i}.join.weight": (C, 2 * C, 1, 1)} if guide else {}
                shapes |= {f"blocks.{i}.{name}.weight": (C, C, 3, 3) for name in ("first", "second")}
            shapes |= {f"decoder.{i}.weight": (C, C, 3, 3) for i in range(2)}
        side = 3 if self.output == "residual" else 1
        shapes |= {f"heads.{s}.weight": (sum(self.channels(s)), C, side, side) for s in range(len(self.heads))}
        shapes = with_biases(shapes)
        for i in range(0 if self.unet else self.blocks):  # without biases
            shapes |= {f"blocks.{i}.{name}.weight": (C, C, 1, 1) for name in ("query", "key", "value")}
            offsets = C // self.attention_heads // 2, self.block + 2 * self.halo
            shapes |= {f"blocks.{i}.{name}": offsets for name in ("rows", "columns")}
        return shapes

    @property
    def multiplications(self) -> float:
        """Multiplications a pixel: of convolutions, and of attention where there is any."""
        total = 0.0
        for name, shape in self.shapes.items():
            if len(shape) == 4:
                scale = int(name.split(".")[1]) if name.startswith("heads") else 0
                if name.startswith("unet"):
                    scale = int(name.split(".")[2])
                total += math.prod(shape) / 4**scale
        attention = 2 * (self.block + 2 * self.halo) ** 2 * self.width * self.blocks
        return total if self.unet else total + attention

    @property
    def grid(self) -> int:
        """Pixels: a window of a frame that starts at multiples of it has the blocks and cells of the whole frame."""
        return math.lcm(2 ** (len(self.unet) - 1) if self.unet else self.block, 4)

    @property
    def reach(self) -> int:
        """As `network_reach`, a multiple of `grid`: for windows that start and end at multiples of it. An attention
        block sees its 3×3 convolutions' pixels, then to the end of their blocks and the halo."""
        length = self.light_reach if self.output == "kernel" else 1
        if self.unet:
            length += 3 * 2 ** len(self.unet) + 1
        else:
            length += 2
            for _ in range(self.blocks):
                length = -(-(length + 2) // self.block) * self.block + self.halo
            length += max(EXTRACTORS) // 2
        return -(-length // self.grid) * self.grid

    @property
    def network_reach(self) -> int | None:
        """As `NetworkConfig.network_reach`; None where blocks do not fit into cells, so that no window is exact."""
        return None if CELL % self.grid else rounded_up(self.reach)

    @property
    def light_reach(self) -> int:
        """As `NetworkConfig.light_reach`: kernels at three scales, and two enlargements; for residuals, which spread no
        light, 0."""
        return rounded_up(self.kernel // 2 * 7 + 6) if self.output == "kernel" else 0
