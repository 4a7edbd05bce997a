"""The one description of every network: torch, GLSL, `growing` and the plan read it. Needs no torch.

A configuration lists the heads of each scale, the network's predictions there, by name. A new head is a row in that
list; its op and the op's shader; a line each in the model's `Heads`, `predict` and `step`; its pass in `glsl.kernels`,
with a shader in `shaders/frame/`; and its value in `growing.WITHOUT`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from .refinement_config import REFINED_HEADS, REFINED_REACH, refined_shapes

CELL = 32  # pixels; reaches are rounded up to it, and windows of a frame start at multiples of it
MAX_WIDTH, MAX_KERNEL = 1024, 31  # larger networks are refused before memory is allocated for them


@dataclass(frozen=True)
class Head:
    """One prediction of the network at a scale: logits of a kernel, or blend weights."""

    name: str
    channels: int
    start: float | None = None
    """Initial logit of the middle channel; all its weights and other biases start at 0. None: random weights."""


class NetworkConfig:
    """The base of the configurations of all architectures."""

    architecture: ClassVar[str]  # stored in weights files; the name of the module with the network
    carries: ClassVar[tuple[str, ...]]  # fields of `History` that the network computes
    features: ClassVar[int]  # channels of the network's input
    reads: ClassVar[tuple[str, ...]] = ()  # layers of `Frame` that it needs beside those that every denoiser reads
    recent: ClassVar[int] = 0  # last frames whose noisy light its history keeps
    footprint: ClassVar[bool] = False  # whether that history has `History.footprint`
    max_levels: ClassVar[int]  # of the U-Net: the coarsest pixels are `CELL` wide at most

    widths: tuple[int, ...]

    def check(self, *kernels: str) -> None:
        """Raise ValueError for fields that no network can have."""
        object.__setattr__(self, "widths", tuple(self.widths))
        self.check_kernels(*kernels)
        self.check_widths("widths")

    def check_widths(self, name: str) -> None:
        """The part of `check` that concerns one list of channels."""
        widths = getattr(self, name)
        if any(type(width) is not int for width in widths):
            raise ValueError(f"{name}: expected whole numbers, got {widths}")
        if not 2 <= len(widths) <= self.max_levels or not all(1 <= width <= MAX_WIDTH for width in widths):
            raise ValueError(f"{name}: expected 2 to {self.max_levels} widths from 1 to {MAX_WIDTH}, got {widths}")

    def check_kernels(self, *kernels: str) -> None:
        """The part of `check` that serves networks of any form."""
        for name in kernels:
            size = getattr(self, name)
            if type(size) is not int or size % 2 == 0 or not 1 <= size <= MAX_KERNEL:
                raise ValueError(f"{name}: expected an odd size up to {MAX_KERNEL}, got {size}")
        if getattr(self, "motion", "dual") not in ("dual", "traditional"):
            raise ValueError(f"expected motion 'dual' or 'traditional', got {self.motion!r}")

    @property
    def heads(self) -> tuple[tuple[Head, ...], ...]:
        """The heads of every filtered scale, finest first, in the order of their channels in the weights."""
        raise NotImplementedError

    @property
    def shapes(self) -> dict[str, tuple[int, ...]]:
        """Name -> shape of every tensor in the state dict."""
        raise NotImplementedError

    @property
    def network_reach(self) -> int | None:
        """Pixels, a multiple of `CELL`: input farther away cannot influence an output. None: all of it can."""
        raise NotImplementedError

    @property
    def light_reach(self) -> int:
        """Pixels, a multiple of `CELL`: the greatest distance over which kernels spread light in one frame."""
        raise NotImplementedError

    def channels(self, scale: int) -> list[int]:
        """The channels of the heads of a scale, for `Tensor.split`."""
        return [head.channels for head in self.heads[scale]]

    def unet_shapes(self, inputs: int) -> dict[str, tuple[int, ...]]:
        below = zip(self.widths[1:], self.widths, strict=False)
        blocks = {f"encoder.{i}": ab for i, ab in enumerate(zip((inputs, *self.widths), self.widths, strict=False))}
        blocks |= {f"decoder.{i}": (a + b, b) for i, (a, b) in enumerate(below)}
        shapes: dict[str, tuple[int, ...]] = {}
        for name, (a, b) in blocks.items():
            shapes |= {f"unet.{name}.0.weight": (b, a, 3, 3), f"unet.{name}.2.weight": (b, b, 3, 3)}
        return shapes


def with_biases(shapes: dict[str, tuple[int, ...]]) -> dict[str, tuple[int, ...]]:
    """The shapes of weights with those of their biases."""
    return shapes | {name.replace("weight", "bias"): shape[:1] for name, shape in shapes.items()}


def rounded_up(length: int) -> int:
    """`length` in pixels, rounded up to a multiple of `CELL`."""
    return -(-length // CELL) * CELL


@dataclass(frozen=True)
class TemporalKPNConfig(NetworkConfig):
    """The paper's network (`temporal_kpn`)."""

    architecture: ClassVar[str] = "temporal_kpn"
    carries: ClassVar[tuple[str, ...]] = ("radiance",)
    max_levels: ClassVar[int] = 6
    features: ClassVar[int] = 13  # noisy radiance 3, albedo 3, normal 3, nearness 1, reprojected previous output 3
    scales: ClassVar[int] = 3  # 1, 1/2 and 1/4 of the image: "the last three layers" (§4.3)

    widths: tuple[int, ...] = (24, 32, 48, 64, 96)
    """Channels of the U-Net at 1, 1/2, 1/4 ... of the image size."""
    kernel: int = 5
    """Side of the spatial and temporal kernels, odd."""
    pool: str = "mean"
    """D of eq. 4: 'mean', or 'max' as the paper prints it."""
    motion: str = "dual"
    """Motion vectors that fetch history: 'dual', or 'traditional' (setting A of the paper)."""

    def __post_init__(self) -> None:
        self.check("kernel")
        if len(self.widths) <= self.scales:
            raise ValueError(f"expected at least {self.scales + 1} widths, got {self.widths}")
        if self.pool not in ("mean", "max"):
            raise ValueError(f"expected pool 'mean' or 'max', got {self.pool!r}")

    @property
    def heads(self) -> tuple[tuple[Head, ...], ...]:
        """At full size the spatial and the temporal kernel and α_t; at coarser scales the spatial kernel and α."""
        taps = self.kernel**2
        full = Head("spatial", taps), Head("temporal", taps), Head("alpha_temporal", 1)
        return full, *[(Head("spatial", taps), Head("alpha", 1))] * (self.scales - 1)

    @property
    def shapes(self) -> dict[str, tuple[int, ...]]:
        """As `NetworkConfig.shapes`."""
        shapes = self.unet_shapes(self.features)
        for scale, width in enumerate(self.widths[: self.scales]):
            shapes[f"heads.{scale}.weight"] = (sum(self.channels(scale)), width, 1, 1)
        return with_biases(shapes)

    @property
    def network_reach(self) -> int:
        """As `NetworkConfig.network_reach`. A level of the U-Net has two 3×3 convolutions on the way down and two on
        the way up; pooling and enlarging add a cell."""
        return rounded_up(3 * 2 ** len(self.widths) + 1) + self.light_reach

    @property
    def light_reach(self) -> int:
        """As `NetworkConfig.light_reach`: the coarsest kernel, and two bilinear enlargements."""
        return rounded_up(self.kernel // 2 * 2 ** (self.scales - 1) + 6)


@dataclass(frozen=True)
class AccumulatedKPNConfig(NetworkConfig):
    """The network that ships (`accumulated_kpn`)."""

    architecture: ClassVar[str] = "accumulated_kpn"
    carries: ClassVar[tuple[str, ...]] = ("radiance", "length", "mean", "mean_albedo")
    # Noisy light 3, its running mean 3, previous output 3, albedo 3, its running mean 3, normal 3, nearness 1,
    # history length 1, uncovered 1.
    features: ClassVar[int] = 21
    max_levels: ClassVar[int] = 5

    widths: tuple[int, ...] = (24, 40, 56, 72, 96)
    """Channels of the U-Net at 1/2, 1/4, 1/8 ... of the image size."""
    scales: int = 5
    """Scales that are filtered: 1, 1/2, 1/4 ... of the image size."""
    kernel: int = 5
    """Side of the spatial kernels, odd."""
    temporal_kernel: int = 3
    """Side of the temporal kernel, odd."""
    edge_kernel: int = 1
    """Side of the kernel that smooths edges, odd; 1: the network has none."""
    pick_kernel: int = 1
    """Side of the kernels by which pixels pick from the next coarser scale, odd; 1: the network has none."""
    detail: bool = False
    """Whether the network predicts how much of the finest detail of each scale is kept (`ops.soften`)."""
    guided: bool = False
    """Whether a block of guided self-attention refines the features at a quarter of the image size."""
    longest: float = 16.0
    """Frames after which the running mean forgets: a new frame weighs 1 / longest at least."""
    recent: int = 0
    """Frames whose noisy light is kept and looked up anew in each frame (`ops.recall`); 0: a running mean of light."""
    footprint: bool = False
    """Whether recent frames keep albedo, too, and the history has `footprint`, for those who filter it."""
    motion: str = "dual"
    """Motion vectors that fetch history: 'dual' or 'traditional'."""

    def __post_init__(self) -> None:
        self.check("kernel", "temporal_kernel", "edge_kernel", "pick_kernel")
        if not isinstance(self.scales, int) or not 2 <= self.scales <= len(self.widths):
            most = len(self.widths)
            raise ValueError(f"expected 2 to {most} scales for widths {self.widths}, got scales={self.scales}")
        for name in ("detail", "guided", "footprint"):
            if not isinstance(getattr(self, name), bool):
                raise ValueError(f"{name}: expected true or false, got {getattr(self, name)!r}")
        if self.guided and (self.scales < 3 or self.widths[1] % (2 * REFINED_HEADS)):
            raise ValueError(
                f"guided: expected 3 scales or more and a second width that is a multiple of {2 * REFINED_HEADS}, got "
                f"{self.scales} scales and widths {self.widths}"
            )
        if not isinstance(self.longest, int | float) or not 2 <= self.longest < 1e6:
            raise ValueError(f"longest: expected 2 frames or more, and below 1e6, got {self.longest}")
        if not isinstance(self.recent, int) or isinstance(self.recent, bool) or not 0 <= self.recent < self.longest:
            raise ValueError(f"recent: expected a whole number of frames below {self.longest:g}, got {self.recent!r}")

    @property
    def heads(self) -> tuple[tuple[Head, ...], ...]:
        """At full size the spatial, temporal, edge and pick kernels, the detail, and the shares: α_t, reset and sharp.
        At coarser scales the spatial kernel, α and, but for the coarsest, the detail and the pick kernel. An edge
        kernel starts with 0.71 of its weight on the pixel itself, a pick kernel with 0.48 on the pixel's own cell; 0.12
        of the light is picked, 0.98 of the detail is kept."""
        spatial, temporal = Head("spatial", self.kernel**2), Head("temporal", self.temporal_kernel**2)
        edge = [Head("edge", self.edge_kernel**2, start=3.0)] if self.edge_kernel > 1 else []
        pick = [Head("pick", self.pick_kernel**2, start=2.0), Head("pick_share", 1, start=-2.0)]
        pick = pick if self.pick_kernel > 1 else []
        detail = [Head("detail", 1, start=4.0)] if self.detail else []
        coarse = spatial, Head("alpha", 1)
        full = spatial, temporal, *edge, *pick, *detail, Head("shares", 3)
        return full, *[(*coarse, *pick, *detail)] * (self.scales - 2), coarse

    @property
    def shapes(self) -> dict[str, tuple[int, ...]]:
        """As `NetworkConfig.shapes`. The head at full size is a transposed convolution: four pixels per stem pixel."""
        shapes = self.unet_shapes(self.widths[0])
        for scale, width in enumerate(self.widths[: self.scales - 1], start=1):
            shapes[f"heads.{scale - 1}.weight"] = (sum(self.channels(scale)), width, 1, 1)
        shapes["stem.weight"] = (self.widths[0], self.features, 4, 4)
        full = sum(self.channels(0))
        shapes = with_biases(shapes) | (refined_shapes("refine.", self.widths[1]) if self.guided else {})
        return shapes | {"full_head.weight": (self.widths[0], full, 2, 2), "full_head.bias": (full,)}

    @property
    def network_reach(self) -> int:
        """As `NetworkConfig.network_reach`. The U-Net works at half size; attention reaches over a block and a halo."""
        attention = REFINED_REACH if self.guided else 0
        return rounded_up(6 * 2 ** len(self.widths) + attention) + self.light_reach

    @property
    def light_reach(self) -> int:
        """As `NetworkConfig.light_reach`: the kernels of all scales one after the other, an enlargement at each, then
        the edge and the temporal kernel."""
        cells = 2**self.scales
        enlarged = self.pick_kernel // 2 * (cells - 2) if self.pick_kernel > 1 else cells // 2 - 1
        return rounded_up(
            self.kernel // 2 * (cells - 1) + enlarged + self.edge_kernel // 2 + self.temporal_kernel // 2 + 1
        )
