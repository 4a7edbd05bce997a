"""Network building blocks."""

from .inference import PRECISIONS, as_weights, prepare, resolve
from .unet import ConvRelu, UNet

__all__ = ["PRECISIONS", "ConvRelu", "UNet", "as_weights", "prepare", "resolve"]
