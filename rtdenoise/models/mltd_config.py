"""The configuration of the recurrent transformer (`mltd`). Needs no torch."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from .config import MAX_WIDTH, Head, NetworkConfig, with_biases

FEED_FORWARD = 2.66  # hidden channels of a feed-forward layer for each of its inputs
CHOICES = {
    "recurrence": ("cross", "concat", "none"), "pool": ("mean", "nearest"), "invalid": ("excluded", "black"),
    "normalise": ("exposure", "clip"),
}  # fmt: skip


@dataclass(frozen=True)
class Stage:
    """Transformer blocks at one scale."""

    name: str
    scale: int  # at 1/2^scale of the image
    width: int
    heads: int
    blocks: int
    recurrent: bool  # whether its blocks see hidden features of the frame before


@dataclass(frozen=True)
class MLTDConfig(NetworkConfig):
    """A denoiser of Metropolis renders (`mltd`). The defaults are ours; `mltd.py` says how to get the paper's."""

    architecture: ClassVar[str] = "mltd"
    carries: ClassVar[tuple[str, ...]] = ("radiance", "hidden")
    network_reach: ClassVar[None] = None  # attention sums over the whole picture, so it never runs in windows
    scales: ClassVar[int] = 4

    width: int = 48
    """Channels at full size, even; twice as many at each coarser one of the four scales."""
    blocks: tuple[int, ...] = (2, 2, 3, 3, 3, 2, 2, 2)
    """Transformer blocks at 1, 1/2, 1/4, 1/8 on the way down and at 1/8, 1/4, 1/2, 1 on the way up."""
    components: int = 2
    """Parts into which the light is split, each filtered by its own kernels; 1: the beauty as it is."""
    kernel: int = 9
    """Side of the spatial kernels, odd."""
    temporal_kernel: int = 5
    """Side of the temporal kernels, odd."""
    recurrence: str = "cross"
    """Use of hidden features of the frame before: 'cross' (attention to them), 'concat' (a 1×1 convolution joins them
    to the input of a block) or 'none'."""
    pool: str = "mean"
    """D of eq. 6: 'mean', or 'nearest' with nearest U, as the authors have it."""
    invalid: str = "excluded"
    """Pixels without history: 'excluded' from the temporal kernels and shown to the network, or 'black' as the authors
    have it."""
    normalise: str = "exposure"
    """Scale of the network's input: 'exposure' of the frame, or 'clip': extremes over the shot so far."""
    position: bool = False
    """World positions are input too."""
    motion: str = "dual"
    """Motion vectors that fetch history: 'dual' or 'traditional'."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "blocks", tuple(self.blocks))
        if not isinstance(self.width, int) or self.width % 2 or not 2 <= 8 * self.width <= MAX_WIDTH:
            raise ValueError(f"width: expected an even number from 2 to {MAX_WIDTH // 8}, got {self.width!r}")
        if len(self.blocks) != 8 or not all(type(n) is int and 1 <= n <= 16 for n in self.blocks):
            raise ValueError(f"blocks: expected eight numbers from 1 to 16, got {self.blocks}")
        if type(self.components) is not int or not 1 <= self.components <= 8:
            raise ValueError(f"components: expected a number from 1 to 8, got {self.components!r}")
        for name, values in CHOICES.items():
            if getattr(self, name) not in values:
                raise ValueError(f"{name}: expected one of {', '.join(values)}, got {getattr(self, name)!r}")
        if not isinstance(self.position, bool):
            raise ValueError(f"position: expected true or false, got {self.position!r}")
        self.check_kernels("kernel", "temporal_kernel")

    @property
    def widths(self) -> tuple[int, ...]:
        """Channels at 1, 1/2, 1/4 and 1/8 of the image size."""
        return tuple(self.width * 2**scale for scale in range(self.scales))

    @property
    def reads(self) -> tuple[str, ...]:
        """As `NetworkConfig.reads`."""
        return ("components",) * (self.components > 1) + ("position",) * self.position

    @property
    def features(self) -> int:
        """Input channels: 3 for each component, nearness 1, albedo 3, normal 3, position 3, validity 1."""
        return 3 * self.components + 7 + 3 * self.position + (self.invalid == "excluded")

    @property
    def stages(self) -> tuple[Stage, ...]:
        """The stages in the order of the data: recurrent ones down to 1/8, plain ones up again. Heads are the paper's:
        1, 2, 4, 8 on the way down and 4, 2, 1, 1 on the way up."""
        recurrent = self.recurrence != "none"
        scales, heads = (0, 1, 2, 3, 3, 2, 1, 0), (1, 2, 4, 8, 4, 2, 1, 1)
        return tuple(
            Stage(f"stages.{i}", scale, self.widths[scale], head, blocks, recurrent and i < 4)
            for i, (scale, head, blocks) in enumerate(zip(scales, heads, self.blocks, strict=True))
        )

    @property
    def heads(self) -> tuple[tuple[Head, ...], ...]:
        """At every scale the temporal kernel, the spatial kernel and λ of each component; at all but the finest α of
        each. λ starts with half of the weight on history, α with 0.27 of it on the coarser scale."""
        one = Head("temporal", self.temporal_kernel**2), Head("spatial", self.kernel**2), Head("lambda", 1, start=0.0)
        each = tuple(Head(f"{h.name}{k}", h.channels, h.start) for k in range(self.components) for h in one)
        alpha = tuple(Head(f"alpha{k}", 1, start=-1.0) for k in range(self.components))
        return each, *[(*each, *alpha)] * (self.scales - 1)

    @property
    def light_reach(self) -> int:
        """Unlimited: never asked for, since the network has no windows."""
        raise NotImplementedError

    @property
    def shapes(self) -> dict[str, tuple[int, ...]]:
        """As `NetworkConfig.shapes`."""
        w = self.widths
        shapes = with_biases({"first.weight": (w[0], self.features, 3, 3)})
        for stage in self.stages:
            for i in range(stage.blocks):
                block = _block_shapes(stage, self.recurrence)
                shapes |= {f"{stage.name}.{i}.{name}": shape for name, shape in block.items()}
        for scale in range(self.scales - 1):
            shapes[f"down.{scale}.weight"] = (w[scale] // 2, w[scale], 3, 3)
            shapes[f"up.{scale}.weight"] = (4 * w[scale], w[scale + 1], 3, 3)
        for scale in range(self.scales):
            outputs = sum(self.channels(scale))
            joined = {"join": (w[scale], 2 * w[scale], 1, 1), "heads": (outputs, w[scale], 1, 1)}
            shapes |= with_biases({f"{name}.{scale}.weight": shape for name, shape in joined.items()})
        return shapes


def hidden_channels(width: int) -> int:
    """Channels of the gate of a feed-forward layer, which has twice as many inputs."""
    return int(FEED_FORWARD * width)


def _block_shapes(stage: Stage, recurrence: str) -> dict[str, tuple[int, ...]]:
    """Name -> shape of the tensors of a block."""
    C, hidden = stage.width, hidden_channels(stage.width)
    cross, concat = stage.recurrent and recurrence == "cross", stage.recurrent and recurrence == "concat"

    def projection(name: str, inputs: int, outputs: int) -> dict[str, tuple[int, ...]]:
        return {f"{name}.points.weight": (outputs, inputs, 1, 1), f"{name}.depthwise.weight": (outputs, 1, 3, 3)}

    shapes: dict[str, tuple[int, ...]] = {"attention.norm.scale": (C,), "feed_forward.norm.scale": (C,)}
    shapes |= projection("attention.qkv", C, 3 * C) | {"attention.temperature": (stage.heads,)}
    if cross:
        shapes |= projection("attention.cross_q", C, C) | projection("attention.cross_kv", C, 2 * C)
        shapes["attention.cross_temperature"] = (stage.heads,)
    if concat:
        shapes["attention.merge.weight"] = (C, 2 * C, 1, 1)
    shapes["attention.out.weight"] = (C, (1 + cross) * C, 1, 1)
    shapes |= projection("feed_forward.expand", C, 2 * hidden) | {"feed_forward.out.weight": (C, hidden, 1, 1)}
    return shapes
