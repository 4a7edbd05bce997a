"""Denoisers: name -> configuration -> weights."""

from .load import available, find, load, save
from .temporal_kpn import PRESETS, Config, TemporalKPN

__all__ = ["PRESETS", "Config", "TemporalKPN", "available", "find", "load", "save"]
