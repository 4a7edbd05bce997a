"""log(1 + x) and its inverse (`color.compress`, `color.expand`) of x ≥ 0: by their series where x is small, as 1 + x
would round it away, and a GPU's logarithm near 1 is rough."""

from __future__ import annotations

import triton
import triton.language as tl


@triton.jit
def compressed(x):
    series = 1 / 5 - x * (1 / 6 - x * (1 / 7 - x * (1 / 8)))
    series = x * (1 - x * (1 / 2 - x * (1 / 3 - x * (1 / 4 - x * series))))
    return tl.where(x < 0.125, series, tl.log(1 + x))


@triton.jit
def expanded(x):
    series = x * (1 + x / 2 * (1 + x / 3 * (1 + x / 4 * (1 + x / 5 * (1 + x / 6)))))
    return tl.where(x < 0.125, series, tl.exp(x) - 1)
