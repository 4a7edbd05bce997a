"""The one description of every network: torch, GLSL, `growing` and the plan read it. Needs no torch.

A configuration lists, for each scale, the heads by name: the parts of what the network predicts there. A new head is a
row in that list, the op that applies it, its shader, and the line of the model's `step` that calls it.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields, replace
from typing import ClassVar

from ..errors import InputError

CELL = 32  # pixels; reaches are rounded up to it, and windows of a frame start at multiples of it
MAX_WIDTH, MAX_KERNEL = 1024, 31  # larger networks are refused before memory is allocated for them


@dataclass(frozen=True)
class Head:
    """One part of what the network predicts at a scale: logits of a kernel, or weights."""

    name: str
    channels: int
    start: float | None = None
    """Initial logit of the middle channel; all its weights and other biases start at 0. None: random weights."""


class _Config:
    """What the configurations of all architectures share."""

    architecture: ClassVar[str]  # stored in weights files; the name of the module with the network
    carries: ClassVar[tuple[str, ...]]  # fields of `History` that the network fills in, beside the frame's geometry
    features: ClassVar[int]  # channels of the network's input
    max_levels: ClassVar[int]  # of the U-Net: the coarsest pixels are `CELL` wide at most

    widths: tuple[int, ...]

    def _check(self, *kernels: str) -> None:
        """Raise ValueError for fields that no network can have."""
        object.__setattr__(self, "widths", tuple(self.widths))
        integers = [*self.widths, *(getattr(self, name) for name in kernels)]
        if any(not isinstance(value, int) or isinstance(value, bool) for value in integers):
            raise ValueError(f"expected whole numbers for widths and kernels, got {integers}")
        if not 2 <= len(self.widths) <= self.max_levels or not all(1 <= width <= MAX_WIDTH for width in self.widths):
            raise ValueError(f"expected 2 to {self.max_levels} widths from 1 to {MAX_WIDTH}, got {self.widths}")
        for name in kernels:
            size = getattr(self, name)
            if size % 2 == 0 or not 1 <= size <= MAX_KERNEL:
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
    def network_reach(self) -> int:
        """Pixels, a multiple of `CELL`: what lies farther away cannot influence an output."""
        raise NotImplementedError

    @property
    def light_reach(self) -> int:
        """Pixels, a multiple of `CELL`: the kernels spread light no farther in one frame."""
        raise NotImplementedError

    def channels(self, scale: int) -> list[int]:
        """The channels of the heads of a scale, for `Tensor.split`."""
        return [head.channels for head in self.heads[scale]]

    def _unet_shapes(self, inputs: int) -> dict[str, tuple[int, ...]]:
        below = zip(self.widths[1:], self.widths, strict=False)
        blocks = {f"encoder.{i}": ab for i, ab in enumerate(zip((inputs, *self.widths), self.widths, strict=False))}
        blocks |= {f"decoder.{i}": (a + b, b) for i, (a, b) in enumerate(below)}
        shapes: dict[str, tuple[int, ...]] = {}
        for name, (a, b) in blocks.items():
            shapes |= {f"unet.{name}.0.weight": (b, a, 3, 3), f"unet.{name}.2.weight": (b, b, 3, 3)}
        return shapes


@dataclass(frozen=True)
class TemporalKPNConfig(_Config):
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
    """What history is fetched with: 'dual' or 'traditional' motion vectors (setting A of the paper)."""

    def __post_init__(self) -> None:
        self._check("kernel")
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
        """As `_Config.shapes`."""
        shapes = self._unet_shapes(self.features)
        for scale, width in enumerate(self.widths[: self.scales]):
            shapes[f"heads.{scale}.weight"] = (sum(self.channels(scale)), width, 1, 1)
        return _with_biases(shapes)

    @property
    def network_reach(self) -> int:
        """As `_Config.network_reach`. A level of the U-Net has two 3×3 convolutions on the way down and two on the way
        up; pooling and enlarging add a cell."""
        return _up(3 * 2 ** len(self.widths) + 1) + self.light_reach

    @property
    def light_reach(self) -> int:
        """As `_Config.light_reach`: the coarsest kernel, and two bilinear enlargements."""
        return _up(self.kernel // 2 * 2 ** (self.scales - 1) + 6)


@dataclass(frozen=True)
class AccumulatedKPNConfig(_Config):
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
    longest: float = 16.0
    """Frames after which the running mean forgets: its least weight of a new frame is 1 / longest."""
    motion: str = "dual"
    """What history is fetched with: 'dual' or 'traditional' motion vectors."""

    def __post_init__(self) -> None:
        self._check("kernel", "temporal_kernel", "edge_kernel", "pick_kernel")
        if not isinstance(self.scales, int) or not 2 <= self.scales <= len(self.widths):
            raise ValueError(f"expected 2 to {len(self.widths)} scales for widths {self.widths}, got {self.scales}")
        if not isinstance(self.detail, bool):
            raise ValueError(f"detail: expected true or false, got {self.detail!r}")
        if not isinstance(self.longest, int | float) or not 2 <= self.longest < 1e6:
            raise ValueError(f"expected a longest mean of 2 frames or more, got {self.longest}")

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
        """As `_Config.shapes`. The head at full size is a transposed convolution, four pixels for one of the stem."""
        shapes = self._unet_shapes(self.widths[0])
        for scale, width in enumerate(self.widths[: self.scales - 1], start=1):
            shapes[f"heads.{scale - 1}.weight"] = (sum(self.channels(scale)), width, 1, 1)
        shapes["stem.weight"] = (self.widths[0], self.features, 4, 4)
        full = sum(self.channels(0))
        return _with_biases(shapes) | {"full_head.weight": (self.widths[0], full, 2, 2), "full_head.bias": (full,)}

    @property
    def network_reach(self) -> int:
        """As `_Config.network_reach`. The U-Net works at half size."""
        return _up(6 * 2 ** len(self.widths)) + self.light_reach

    @property
    def light_reach(self) -> int:
        """As `_Config.light_reach`: the kernels of all scales one after the other, an enlargement at each, then the
        edge and the temporal kernel."""
        cells = 2**self.scales
        enlarged = self.pick_kernel // 2 * (cells - 2) if self.pick_kernel > 1 else cells // 2 - 1
        return _up(self.kernel // 2 * (cells - 1) + enlarged + self.edge_kernel // 2 + self.temporal_kernel // 2 + 1)


@dataclass(frozen=True)
class CombinerConfig(_Config):
    """A network that corrects denoised frames by the noisy frames they were made from (`combiner`)."""

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
    nothing: bool = True
    """A share for no correction competes with those of the frames; without it the weights of a pixel sum to 1."""
    demodulate: bool = True
    """Residuals are divided by the albedo."""
    statistics: bool = True
    """The input has means of residuals over neighbourhoods, in units of their standard errors."""

    def __post_init__(self) -> None:
        self._check("kernel", "pick_kernel")
        if not isinstance(self.frames, int) or not 1 <= self.frames <= 9 or not (self.causal or self.frames % 2):
            raise ValueError(f"expected 1 to 9 frames, an odd number unless causal, got {self.frames}")
        most = len(self.widths) - 1 + self.half_size
        if not isinstance(self.scales, int) or not 1 <= self.scales <= most:
            raise ValueError(f"expected 1 to {most} scales for widths {self.widths}, got {self.scales}")

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
    def features(self) -> int:
        """Input channels: of each frame y 3, z 3, residual 3, validity 1; albedo 3, normal 3, nearness 1 of the current
        one; statistics 13."""
        return 10 * self.frames + 7 + (13 if self.statistics else 0)

    @property
    def heads(self) -> tuple[tuple[Head, ...], ...]:
        """At every scale a kernel for each frame and the shares of the frames and, if there is one, of nothing; at all
        but the coarsest the pick kernel with its weight. The share of nothing starts at 0.6 for five frames."""
        kernels = [Head(f"taps{offset:+d}", self.kernel**2) for offset in self.offsets]
        shares = [Head("shares", self.frames), *([Head("nothing", 1, start=2.0)] if self.nothing else [])]
        pick = Head("pick", self.pick_kernel**2), Head("pick_share", 1, start=0.0)
        return *[(*kernels, *shares, *pick)] * (self.scales - 1), (*kernels, *shares)

    @property
    def shapes(self) -> dict[str, tuple[int, ...]]:
        """As `_Config.shapes`. Behind a U-Net at half size the heads at full size predict for four pixels at once."""
        shapes = self._unet_shapes(self.widths[0] if self.half_size else self.features)
        if self.half_size:
            shapes["stem.weight"] = (self.widths[0], self.features, 4, 4)
        for scale, heads in enumerate(self.heads):
            width, pixels = self.widths[self.level(scale)], 4 if self.half_size and scale == 0 else 1
            shapes |= {f"heads.{scale}.{h.name}.weight": (pixels * h.channels, width, 1, 1) for h in heads}
        return _with_biases(shapes)

    def level(self, scale: int) -> int:
        """The level of the U-Net that predicts the heads of a scale."""
        return max(0, scale - 1) if self.half_size else scale

    @property
    def network_reach(self) -> int:
        """As `_Config.network_reach`, but for motion between frames. The statistics look 7 pixels far."""
        return _up(3 * 2 ** (len(self.widths) + self.half_size) + 8) + self.light_reach

    @property
    def light_reach(self) -> int:
        """As `_Config.light_reach`: the kernel and the pick kernel of every scale, likewise without motion."""
        cells = 2**self.scales
        return _up((self.kernel // 2 + self.pick_kernel // 2 + 1) * (cells - 1))


Config = TemporalKPNConfig | AccumulatedKPNConfig | CombinerConfig
CONFIGS: dict[str, type[Config]] = {
    kind.architecture: kind for kind in (TemporalKPNConfig, AccumulatedKPNConfig, CombinerConfig)
}

PRESETS: dict[str, Config] = {
    "paper": TemporalKPNConfig(),
    "fast": AccumulatedKPNConfig(widths=(16, 24, 32, 48, 64), kernel=3, edge_kernel=3),
    "default": AccumulatedKPNConfig(widths=(32, 56, 72, 88, 104), edge_kernel=3),
    "quality": AccumulatedKPNConfig(widths=(64, 72, 72, 88, 104), edge_kernel=3),
}
"""Name of a denoiser -> its configuration, for training. The weights that ship hold theirs."""

COMBINERS: dict[str, CombinerConfig] = {
    "combiner": CombinerConfig(),
    "combiner-causal": CombinerConfig(frames=3, causal=True),
    "drc": CombinerConfig(
        widths=(48, 64, 96, 128), half_size=False, kernel=15, pick_kernel=5, nothing=False, demodulate=False,
        statistics=False,
    ),
}  # fmt: skip
"""Name of a combiner -> its configuration: ours, ours without frames to come, and the paper's."""


def from_stored(architecture: str, values: Mapping[str, object]) -> Config:
    """The configuration in a weights file. Raises ValueError where it is none of this version."""
    if architecture not in CONFIGS:
        raise ValueError(f"expected an architecture of {', '.join(CONFIGS)}, got {architecture!r}")
    if unknown := values.keys() - {field.name for field in fields(CONFIGS[architecture])}:
        raise ValueError(f"unknown field {min(unknown)!r}")
    try:
        return CONFIGS[architecture](**values)
    except TypeError as error:
        raise ValueError(str(error)) from None


def with_settings(config: Config, settings: Iterable[str]) -> Config:
    """`config` with fields replaced as `NAME=VALUE` says, e.g. `widths=32,48,64` or `motion=traditional`.

    Raises InputError for a setting of another form, an unknown field, or a value that the field cannot have.
    """
    known = {field.name: getattr(config, field.name) for field in fields(config)}
    changes: dict[str, object] = {}
    for setting in settings:
        name, equals, value = setting.partition("=")
        if not equals or name not in known:
            raise InputError(f"--set {setting}: expected NAME=VALUE with a NAME of {', '.join(known)}")
        try:
            changes[name] = _parsed(value, known[name])
        except (ValueError, KeyError):
            raise InputError(f"--set {setting}: expected a value like {_shown(known[name])}") from None
    try:
        return replace(config, **changes)
    except ValueError as error:
        raise InputError(f"--set {' '.join(settings)}: {error}") from None


def _parsed(text: str, like: object) -> object:
    if isinstance(like, bool):
        return {"true": True, "false": False}[text.lower()]
    if isinstance(like, tuple):
        return tuple(int(part) for part in text.split(","))
    return type(like)(text)


def _shown(value: object) -> str:
    return ",".join(map(str, value)) if isinstance(value, tuple) else str(value).lower()


def _with_biases(shapes: dict[str, tuple[int, ...]]) -> dict[str, tuple[int, ...]]:
    return shapes | {name.replace("weight", "bias"): shape[:1] for name, shape in shapes.items()}


def _up(length: int) -> int:
    return -(-length // CELL) * CELL
