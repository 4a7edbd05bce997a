"""What the whole-frame passes need to know of a model: its architecture and configuration, as its weights file has
them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

ARCHITECTURES = ("temporal_kpn", "accumulated_kpn")
# Input channels of `models.AccumulatedKPN` in the order of its features shader: in the end what may be zero everywhere.
ORDER = [0, 1, 2, 18, 6, 7, 8, 15, 9, 10, 11, 16, 12, 13, 14, 17, 3, 4, 5, 19, 20]


@dataclass(frozen=True)
class Design:
    """Of `models.TemporalKPN` or `models.AccumulatedKPN`, whose folder of shaders has the same name."""

    architecture: str
    widths: tuple[int, ...]  # of the U-Net
    scales: int  # that are filtered
    kernel: int
    temporal_kernel: int
    motion: str  # 'dual' or 'traditional'
    pool: str = "mean"  # D of eq. 4
    longest: float = math.nan  # frames after which the running mean forgets
    edge_kernel: int = 1  # 1: there is none

    @property
    def full_rows(self) -> list[int]:
        """Of what is predicted at full size: the spatial, the temporal and the edge kernel, α of time, and where there
        is a running mean reset and sharp."""
        edge = self.edge_kernel**2 if self.edge_kernel > 1 else 0
        return [self.kernel**2, self.temporal_kernel**2, edge, *([1, 1, 1] if self.accumulates else [1])]

    @property
    def accumulates(self) -> bool:
        """Whether a running mean of demodulated light is kept; the network then runs at half size."""
        return self.architecture == "accumulated_kpn"

    @property
    def features(self) -> int:
        """Channels of the network's input."""
        return 21 if self.accumulates else 13


def design(architecture: str, config: Mapping) -> Design:
    """Raises KeyError or ValueError where `config` is not that of a known architecture."""
    if architecture not in ARCHITECTURES:
        raise ValueError(f"expected an architecture of {', '.join(ARCHITECTURES)}, got {architecture!r}")
    widths, kernel, motion = tuple(config["widths"]), config["kernel"], config["motion"]
    if motion not in ("dual", "traditional"):
        raise ValueError(f"expected motion 'dual' or 'traditional', got {motion!r}")
    if architecture == "temporal_kpn":
        if config["pool"] not in ("mean", "max"):
            raise ValueError(f"expected pool 'mean' or 'max', got {config['pool']!r}")
        return Design(architecture, widths, 3, kernel, kernel, motion, config["pool"])
    scales, temporal_kernel, edge_kernel = config["scales"], config["temporal_kernel"], config.get("edge_kernel", 1)
    return Design(
        architecture, widths, scales, kernel, temporal_kernel, motion, longest=config["longest"],
        edge_kernel=edge_kernel,
    )  # fmt: skip


def expected_shapes(d: Design) -> dict[str, tuple[int, ...]]:
    """Name -> shape of every tensor of the model's state dict."""
    taps, full = d.kernel**2, sum(d.full_rows)
    inputs = d.widths[0] if d.accumulates else d.features
    shapes: dict[str, tuple[int, ...]] = {}
    pairs = {f"encoder.{i}": (a, b) for i, (a, b) in enumerate(zip((inputs, *d.widths), d.widths, strict=False))}
    pairs |= {f"decoder.{i}": (a + b, b) for i, (a, b) in enumerate(zip(d.widths[1:], d.widths, strict=False))}
    for name, (a, b) in pairs.items():
        shapes |= {f"unet.{name}.0.weight": (b, a, 3, 3), f"unet.{name}.2.weight": (b, b, 3, 3)}
    heads = [taps + 1] * (d.scales - 1) if d.accumulates else [full, taps + 1, taps + 1]
    shapes |= {f"heads.{i}.weight": (n, w, 1, 1) for i, (n, w) in enumerate(zip(heads, d.widths, strict=False))}
    if d.accumulates:
        shapes["stem.weight"] = (d.widths[0], d.features, 4, 4)
    shapes |= {name.replace("weight", "bias"): shape[:1] for name, shape in shapes.items()}
    if d.accumulates:
        shapes |= {"full_head.weight": (d.widths[0], full, 2, 2), "full_head.bias": (full,)}
    return shapes


def full_head(d: Design, tensors: Mapping[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Weights [cells, rows, inputs] and biases of what is predicted at full size: `Design.full_rows`."""
    if d.accumulates:  # a 2×2 transposed convolution with stride 2: [inputs, rows, 2, 2]
        cells = tensors["full_head.weight"].transpose(2, 3, 1, 0).reshape(4, -1, d.widths[0])
        return cells, tensors["full_head.bias"]
    return tensors["heads.0.weight"][None, :, :, 0, 0], tensors["heads.0.bias"]
