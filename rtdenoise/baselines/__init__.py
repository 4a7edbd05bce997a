"""What the denoiser is measured against, with the same `step()`."""

from .accumulate import Accumulate
from .oidn import Oidn

__all__ = ["Accumulate", "Oidn"]
