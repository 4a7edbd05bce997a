"""The batches of a run: a function of seed and step alone, so that a resumed run sees the same clips."""

from __future__ import annotations

import numpy as np

from ..data.clips import ClipDataset
from ..frame import Frame, stack
from .augment import augment, relight
from .config import TrainConfig

COLOR_SHARE = 1 / 3  # of the clips where both signals are trained


def batch(data: ClipDataset, config: TrainConfig, step: int, share: tuple[int, int] = (0, 1)) -> list[Frame]:
    """The frames of one step, `[batch / processes, C, size, size]` each, for process `share` = (rank, processes). Every
    clip is seen once an epoch.

    Raises InputError where a clip is smaller or shorter than asked for.
    """
    rank, processes = share
    size = config.batch // processes
    first = step * config.batch + rank * size
    clips = [_clip(data, config, position) for position in range(first, first + size)]
    return [stack(list(frames)) for frames in zip(*clips, strict=True)]


def _clip(data: ClipDataset, config: TrainConfig, position: int) -> list[Frame]:
    """The augmented clip at a position in the endless order of clips."""
    epoch, place = divmod(position, len(data))
    index = np.random.default_rng([config.seed, epoch]).permutation(len(data))[place]
    rng = np.random.default_rng([config.seed, epoch, place])
    signal = config.signal if config.signal != "both" else "color" if rng.random() < COLOR_SHARE else "indirect"
    frames = data.load(int(index), signal=signal, size=config.size, frames=config.frames, rng=rng)
    frames = augment(frames, rng)
    return relight(frames, rng) if rng.random() < config.relight else frames
