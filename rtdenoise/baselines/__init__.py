"""What the denoiser is measured against, with the same `step()`."""

from .accumulate import Accumulate

__all__ = ["Accumulate"]
