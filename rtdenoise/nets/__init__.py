"""Network building blocks."""

from .inference import PRECISIONS, as_weights, prepare, resolve
from .unet import UNet

__all__ = ["PRECISIONS", "UNet", "as_weights", "prepare", "resolve"]
