"""Denoisers: name -> configuration -> weights."""

from .accumulated_kpn import AccumulatedKPN
from .grow import grow
from .load import available, find, load, read, save
from .presets import PRESETS, Config, Denoiser, create
from .temporal_kpn import TemporalKPN

__all__ = [
    "PRESETS", "AccumulatedKPN", "Config", "Denoiser", "TemporalKPN", "available", "create", "find", "grow", "load",
    "read", "save",
]  # fmt: skip
