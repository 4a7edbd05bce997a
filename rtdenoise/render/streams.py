"""Random streams: every use of random numbers in a frame has one of its own."""

from __future__ import annotations

import numpy as np

NOISY, FIRST_HALF, SECOND_HALF, PROBE, FEATURES = range(5)  # of a frame


def stream_seed(*key: int) -> int:
    """A 32-bit seed that is different for every key."""
    return int(np.random.SeedSequence(key).generate_state(1)[0])
