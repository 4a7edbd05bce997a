"""What the whole-frame passes need to know of a model: its architecture and configuration, as its weights file has
them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields

import numpy as np

from ..models.config import Config, TemporalKPNConfig

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
    pick_kernel: int = 1  # likewise

    @property
    def full_rows(self) -> list[int]:
        """Of what is predicted at full size: the spatial, the temporal and the edge kernel, the pick kernel with its
        share, α of time, and where there is a running mean reset and sharp."""
        edge = self.edge_kernel**2 if self.edge_kernel > 1 else 0
        shares = [1, 1, 1] if self.accumulates else [1]
        return [self.kernel**2, self.temporal_kernel**2, edge, self.pick_rows, *shares]

    @property
    def pick_rows(self) -> int:
        """Of the pick kernel of a scale and its share."""
        return self.pick_kernel**2 + 1 if self.pick_kernel > 1 else 0

    @property
    def coarse_rows(self) -> list[int]:
        """Of what is predicted at each coarser scale: its spatial kernel, α and pick kernel; the coarsest has none."""
        taps = self.kernel**2 + 1
        return [taps + self.pick_rows] * (self.scales - 2) + [taps]

    @property
    def accumulates(self) -> bool:
        """Whether a running mean of demodulated light is kept; the network then runs at half size."""
        return self.architecture == "accumulated_kpn"

    @property
    def features(self) -> int:
        """Channels of the network's input."""
        return 21 if self.accumulates else 13


def design(config: Config) -> Design:
    """The design of a configuration."""
    values = {field.name: getattr(config, field.name) for field in fields(config)}
    if isinstance(config, TemporalKPNConfig):
        values |= {"scales": config.scales, "temporal_kernel": config.kernel}
    return Design(config.architecture, **values)


def full_head(d: Design, tensors: Mapping[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Weights [cells, rows, inputs] and biases of what is predicted at full size: `Design.full_rows`."""
    if d.accumulates:  # a 2×2 transposed convolution with stride 2: [inputs, rows, 2, 2]
        cells = tensors["full_head.weight"].transpose(2, 3, 1, 0).reshape(4, -1, d.widths[0])
        return cells, tensors["full_head.bias"]
    return tensors["heads.0.weight"][None, :, :, 0, 0], tensors["heads.0.bias"]
