"""The configuration of a combiner (`combiner`). Needs no torch."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from .config import Head, NetworkConfig, rounded_up, with_biases

MIDDLE = 3.0  # logit of the middle tap to begin with: half the weight of 5×5 taps


@dataclass(frozen=True)
class CombinerConfig(NetworkConfig):
    """A network that corrects denoised frames by their noisy originals (`combiner`)."""

    architecture: ClassVar[str] = "combiner"
    carries: ClassVar[tuple[str, ...]] = ()
    max_levels: ClassVar[int] = 5

    widths: tuple[int, ...] = (32, 48, 64, 80)
    """Channels of the U-Net, finest level first."""
    half_size: bool = True
    """The U-Net works at half the image size, behind a strided convolution; else at full size."""
    frames: int = 5
    """Frames in the window; an odd number unless `causal`."""
    causal: bool = False
    """The current frame is the window's last one, not its middle one."""
    scales: int = 3
    """Scales at which residuals are filtered: 1, 1/2, 1/4 ... of the image size."""
    kernel: int = 5
    """Side of the kernels over residuals, odd; one for each frame and scale."""
    pick_kernel: int = 3
    """Side of the kernels by which pixels pick from the next coarser scale, odd."""
    evidence: bool = True
    """Corrections are multiplied by a share in [0, 1] that begins with `shrinkage`'s, and kernels begin with the weight
    in their middle; without it the weights of a pixel sum to 1, and kernels begin at random."""
    squares: bool = True
    """The loss is a ratio of squared errors on log(1 + exposed light); else of SMAPE, as in the paper."""
    relative: bool = True
    """Residuals are relative to z (`window.divisor_of`)."""
    residual_input: bool = True
    """The input has the residuals y - z beside y and z."""
    statistics: bool = True
    """The input has means of residuals over neighbourhoods, in units of their standard errors, and the samples a
    pixel."""

    def __post_init__(self) -> None:
        self.check("kernel", "pick_kernel")
        if not isinstance(self.frames, int) or not 1 <= self.frames <= 9 or not (self.causal or self.frames % 2):
            raise ValueError(f"expected 1 to 9 frames, an odd number unless causal, got {self.frames}")
        most = len(self.widths) - 1 + self.half_size
        if not isinstance(self.scales, int) or not 1 <= self.scales <= most:
            raise ValueError(f"expected 1 to {most} scales for widths {self.widths}, got scales={self.scales}")

    @property
    def offsets(self) -> tuple[int, ...]:
        """Frame numbers of the window relative to the current frame."""
        first = 1 - self.frames if self.causal else -(self.frames // 2)
        return tuple(range(first, first + self.frames))

    @property
    def current(self) -> int:
        """Place of the current frame in the window."""
        return self.offsets.index(0)

    @property
    def of_each_frame(self) -> int:
        """Input channels of each frame: y 3, z 3, if asked for residual 3, validity 1."""
        return 10 if self.residual_input else 7

    @property
    def features(self) -> int:
        """Input channels: those of each frame; albedo 3, normal 3, nearness 1 of the current one; statistics 14."""
        return self.of_each_frame * self.frames + 7 + (14 if self.statistics else 0)

    @property
    def heads(self) -> tuple[tuple[Head, ...], ...]:
        """At every scale a kernel for each frame, the shares of the frames and the trust in the evidence; at all
        but the coarsest the pick kernel with its weight."""
        middle, even = (MIDDLE, 0.0) if self.evidence else (None, None)
        kernels = [Head(f"taps{offset:+d}", self.kernel**2, start=middle) for offset in self.offsets]
        trust = [Head("trust", 1, start=0.0)] if self.evidence else []
        shares = [Head("shares", self.frames, start=even), *trust]
        pick = Head("pick", self.pick_kernel**2), Head("pick_share", 1, start=0.0)
        return *[(*kernels, *shares, *pick)] * (self.scales - 1), (*kernels, *shares)

    @property
    def shapes(self) -> dict[str, tuple[int, ...]]:
        """As `NetworkConfig.shapes`. Behind a U-Net at half size the heads at full size predict for four pixels at
        once."""
        shapes = self.unet_shapes(self.widths[0] if self.half_size else self.features)
        if self.half_size:
            shapes["stem.weight"] = (self.widths[0], self.features, 4, 4)
        for scale, heads in enumerate(self.heads):
            width, pixels = self.widths[self.level(scale)], 4 if self.half_size and scale == 0 else 1
            shapes |= {f"heads.{scale}.{h.name}.weight": (pixels * h.channels, width, 1, 1) for h in heads}
        return with_biases(shapes)

    def level(self, scale: int) -> int:
        """The level of the U-Net that predicts the heads of a scale."""
        return max(0, scale - 1) if self.half_size else scale

    @property
    def network_reach(self) -> int:
        """As `NetworkConfig.network_reach`, without motion between frames. The statistics reach 10 pixels."""
        return rounded_up(3 * 2 ** (len(self.widths) + self.half_size) + 10) + self.light_reach

    @property
    def light_reach(self) -> int:
        """As `NetworkConfig.light_reach`: the kernel and the pick kernel of every scale, likewise without motion."""
        cells = 2**self.scales
        return rounded_up((self.kernel // 2 + self.pick_kernel // 2 + 1) * (cells - 1))
