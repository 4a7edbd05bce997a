"""How close is close: the one table for parity between backends, dtypes and devices.

A result passes where |result - reference| ≤ absolute + relative · |reference|, value by value. Each row says what the
difference may come from; a test that needs more has found something, or adds a row that explains itself.
"""

from typing import NamedTuple


class Tolerance(NamedTuple):
    relative: float
    absolute: float


TOLERANCES = {
    # Copies, maxima, and arithmetic that is the same operation by operation.
    "exact": Tolerance(0, 0),
    # The same float32 sums in another order, fused multiply-adds, an exp that is right to some units in the last place.
    "float32": Tolerance(1e-5, 1e-6),
    # A network over a window instead of the whole frame: its convolutions sum in another order, layer after layer.
    "float32 tiles": Tolerance(1e-4, 1e-5),
    # A quotient of such sums whose divisor may be small: bilinear weights that add up to 0.01.
    "float32 quotient": Tolerance(1e-4, 1e-5),
    # torch's lookup takes coordinates in [-1, 1]: they are rounded by some 1e-7 of the image's width.
    "grid_sample": Tolerance(1e-4, 1e-4),
    # Differences of products with weights: a gradient may be a small rest of larger terms.
    "float32 gradients": Tolerance(1e-5, 1e-5),
    # A network of twenty convolutions, whose logits go through exp, and what twelve frames carry on of it.
    "frame": Tolerance(1e-4, 1e-6),
    # The same with activations stored as float16: each is rounded by 2⁻¹¹, a logit by some 2⁻⁸.
    "frame, float16 activations": Tolerance(3e-2, 3e-3),
    # Kernel logits stored as float16: |logit| < 8 is rounded by at most 2⁻⁹, one weight against another by at most 2⁻⁸.
    "float16 logits": Tolerance(4e-3, 1e-6),
    # Stored as bfloat16: what float32 rounding moves across a half comes out as the next of its 8 bits.
    "bfloat16 rounding": Tolerance(2**-7, 1e-6),
    # A whole step, radiance of about 1: the network's sums in another order, which its depth and the softmax carry on.
    "float32 network": Tolerance(1e-3, 1e-4),
    # ... and its values and weights rounded to 8 bits: 2⁻⁹ each. Logits of 8 are off by 2⁻⁶, weights by as much.
    "bfloat16 network": Tolerance(5e-2, 5e-2),
}
