"""Fused ops for the CPU: C, specialised by named constants and compiled on the user's machine.

An op has the same name here (NAME.py calls, NAME.c computes) as in `rtdenoise.ops`, whose function checks the arguments
and calls it through `ops.dispatch`. Shared by several: `compiler`, `logits` and the headers. Sums and weights are
float32 whatever the dtype of the logits; parity with the plain ops is `float32` of tests/tolerances.py.
"""

from __future__ import annotations

from .compiler import library


def prepare() -> None:
    """Compile the smallest file. Raises OSError where that is not possible here."""
    library("downsample", POOL=0)
