"""Denoisers: name -> configuration -> weights."""

from .load import available, load, save
from .temporal_kpn import PRESETS, Config, TemporalKPN

__all__ = ["PRESETS", "Config", "TemporalKPN", "available", "load", "save"]
