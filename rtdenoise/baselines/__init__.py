"""Denoisers to compare with, with the same `step()`."""

from .accumulate import Accumulate
from .deep_combiner import DeepCombiner
from .oidn import Oidn
from .svgf import Svgf
from .trmv import Trmv

__all__ = ["Accumulate", "DeepCombiner", "Oidn", "Svgf", "Trmv"]
