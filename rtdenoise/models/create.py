"""The models there are, and the names their configurations ship under."""

from __future__ import annotations

from . import accumulated_kpn, temporal_kpn
from .accumulated_kpn import AccumulatedKPN
from .temporal_kpn import TemporalKPN

Denoiser = TemporalKPN | AccumulatedKPN
Config = temporal_kpn.Config | accumulated_kpn.Config

ARCHITECTURES = {"temporal_kpn": temporal_kpn, "accumulated_kpn": accumulated_kpn}
"""Name in a weights file -> module with its Config."""

PRESETS: dict[str, Config] = {
    "paper": temporal_kpn.Config(),
    "fast": accumulated_kpn.Config(widths=(16, 24, 32, 48, 64), kernel=3, edge_kernel=3),
    "default": accumulated_kpn.Config(widths=(32, 56, 72, 88, 104), edge_kernel=3),
    "quality": accumulated_kpn.Config(widths=(64, 72, 72, 88, 104), edge_kernel=3),
}


def create(config: Config) -> Denoiser:
    """A denoiser with fresh weights."""
    return TemporalKPN(config) if isinstance(config, temporal_kpn.Config) else AccumulatedKPN(config)


def architecture(config: Config) -> str:
    """The key of `ARCHITECTURES` that a configuration belongs to."""
    return type(config).__module__.rpartition(".")[2]
