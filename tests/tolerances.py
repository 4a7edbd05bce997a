"""The one table of tolerances for parity between backends, dtypes and devices.

A result passes where |result - reference| ≤ absolute + relative · |reference|, value by value. Each row states the
source of the difference. A test that needs more has found a bug, or adds a row that explains itself.
"""

from typing import NamedTuple


class Tolerance(NamedTuple):
    relative: float
    absolute: float


TOLERANCES = {
    # Copies, maxima, and arithmetic that is the same operation by operation.
    "exact": Tolerance(0, 0),
    # The same float32 sums in another order, fused multiply-adds, an exp with errors of some units in the last place.
    "float32": Tolerance(1e-5, 1e-6),
    # A network over a window instead of the whole frame: its convolutions sum in another order, layer after layer.
    "float32 tiles": Tolerance(1e-4, 1e-5),
    # Sums of a thousand terms of either sign, of about 1.
    "sums": Tolerance(1e-5, 2e-4),
    # A quotient of such sums with a small divisor: bilinear weights that add up to 0.01, frames of which little counts.
    "float32 quotient": Tolerance(1e-4, 1e-5),
    # torch's lookup takes coordinates in [-1, 1]: they are rounded by some 1e-7 of the image's width.
    "grid_sample": Tolerance(1e-4, 1e-4),
    # A softmax over 200 positions: a score of 30 is rounded by 2e-6, its exp by as much of itself.
    "float32 attention": Tolerance(1e-4, 1e-5),
    # Gradients, which may be small differences of larger terms.
    "float32 gradients": Tolerance(1e-5, 1e-5),
    # Twenty convolutions whose logits go through exp, over twelve recurrent frames.
    "frame": Tolerance(1e-4, 1e-6),
    # The same with activations stored as float16: 2⁻¹¹ of rounding each, about 2⁻⁸ in a logit.
    "frame, float16 activations": Tolerance(3e-2, 3e-3),
    # Kernel logits below 8 stored as float16: at most 2⁻⁹ of rounding each, 2⁻⁸ in the ratio of two weights.
    "float16 logits": Tolerance(4e-3, 1e-6),
    # Results stored as bfloat16: float32 rounding may move a value to the next one that 8 bits can hold.
    "bfloat16 rounding": Tolerance(2**-7, 1e-6),
    # A whole step, radiance of about 1: the network's sums in another order, amplified by its depth and the softmax.
    "float32 network": Tolerance(1e-3, 1e-4),
    # The same with activations and weights rounded to 8 bits, 2⁻⁹ each: 2⁻⁶ in a logit of 8, and as much in a weight.
    "bfloat16 network": Tolerance(5e-2, 5e-2),
    # The same in whole numbers of eight bits: 2⁻⁸ of a channel's greatest value in every layer.
    "int8 network": Tolerance(0.1, 0.1),
    # The same of pixels from albedo and normal that networks in bytes filter before.
    "int8 networks in turn": Tolerance(0.15, 0.15),
}
