"""The batches of a run: a function of seed and step alone, so that a resumed run sees the same clips."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ..data.clip_file import read_facts
from ..data.clips import ClipDataset, estimated_signals
from ..data.layers import SIGNALS
from ..errors import InputError
from ..frame import Frame, stack
from ..models import COMBINERS, Window
from .augment import augment, relight, shade
from .config import TrainConfig, model_config

Batch = Callable[[ClipDataset, TrainConfig, int, tuple[int, int]], Any]
"""(clips, options, step, (rank, processes)) -> the batch of a step, a function of these alone."""
COLOR_SHARE = 1 / 3  # of the clips where both signals are trained
UNKNOWN_SHARE = 0.1  # of the windows whose samples a pixel are not known
MISSING_SHARE = 0.1  # of the windows that lack frames, as at the ends of shots


@dataclass(frozen=True)
class TrainingSet:
    """What a run trains on."""

    clips: ClipDataset
    stills: ClipDataset | None = None  # single frames, for every second step

    @classmethod
    def open(cls, config: TrainConfig) -> TrainingSet:
        """Raises InputError for folders without clips, or without any of `config.least_spp` to `config.most_spp`."""
        spp = config.least_spp, config.most_spp
        return cls(_opened(config.data, *spp), _opened(config.stills, *spp) if config.stills else None)

    def scenes(self) -> set[str]:
        """As `ClipDataset.scenes`."""
        return self.clips.scenes() | (self.stills.scenes() if self.stills else set())

    def refuse_unfit(self, config: TrainConfig) -> None:
        """Raise InputError for the first clip that cannot be in a batch: it is damaged, smaller or shorter than asked
        for, or lacks what the network reads."""
        combines = config.model in COMBINERS
        reads = () if combines else model_config(config).reads
        for data, frames in ((self.clips, config.frames), (self.stills, 1)):
            for index, path in enumerate(data.paths if data else ()):
                wanted = {signal for _, signal in _estimates(path, config)} if combines else _signals(config)
                for signal in sorted(wanted):
                    data.examine(index, signal=signal, size=config.size, frames=frames, layers=reads)

    def batch(self, take: Batch, config: TrainConfig, step: int, share: tuple[int, int] = (0, 1)) -> Any:
        """The batch of a step, by the `Task.batch` of its network."""
        return take(*self._turn(config, step), share)

    def paths(self, config: TrainConfig, step: int) -> list[Path]:
        """The clips of a step, of all processes."""
        data, config, turn = self._turn(config, step)
        return [data.paths[index] for index, _, _ in _places(data, config, turn, (0, 1))]

    def _turn(self, config: TrainConfig, step: int) -> tuple[ClipDataset, TrainConfig, int]:
        """The clips or stills that a step takes, its options, and how many steps took such before."""
        if self.stills is None:
            return self.clips, config, step
        turn, of_stills = divmod(step, 2)
        if not of_stills:
            return self.clips, config, turn
        return self.stills, replace(config, batch=config.batch * config.frames, frames=1, lead_in=0), turn


def _opened(folders: tuple[Path, ...], least_spp: int, most_spp: int | None) -> ClipDataset:
    """The clips whose samples a pixel lie in a range."""
    if not folders:
        raise InputError("data: name at least one folder of clips")
    data = ClipDataset(*folders)
    if least_spp > 1 or most_spp:
        most = most_spp or math.inf
        data.paths = [path for path in data.paths if least_spp <= read_facts(path).get("spp", 1) <= most]
    if not data.paths:
        asked = f"{least_spp} to {most_spp}" if most_spp else f"{least_spp} and more"
        raise InputError(f"{folders[0]}: no clip has {asked} samples a pixel; choose others by --least-spp, --most-spp")
    return data


def clips(data: ClipDataset, config: TrainConfig, step: int, share: tuple[int, int] = (0, 1)) -> list[Frame]:
    """The frames of one step, `[batch / processes, C, size, size]` each, for process `share` = (rank, processes); those
    before the last `config.frames` are a lead-in. Every clip is seen once an epoch.

    Raises InputError where a clip is smaller or shorter than asked for.
    """
    loaded = [_clip(data, config, *place) for place in _places(data, config, step, share)]
    shared = min(len(frames) for frames in loaded)  # clips have lead-ins of different lengths
    return [stack(list(frames)) for frames in zip(*(frames[-shared:] for frames in loaded), strict=True)]


def windows(data: ClipDataset, config: TrainConfig, step: int, share: tuple[int, int] = (0, 1)) -> Window:
    """The windows of one step: frames and the estimates that a denoiser of `config.estimates` made of them. Clips are
    those of `clips`. One batch in ten lacks the frames on one or both sides of the current one.

    Raises InputError as `clips`, and where a clip has no such estimates.
    """
    loaded = [_window(data, config, *place) for place in _places(data, config, step, share)]
    frames, estimates = (
        [stack(list(frame)) for frame in zip(*(pair[i] for pair in loaded), strict=True)] for i in (0, 1)
    )
    window = Window(tuple(frames), tuple(frame.radiance for frame in estimates))
    rng = np.random.default_rng([config.seed, step])
    if rng.random() < UNKNOWN_SHARE:
        window = replace(window, frames=tuple(replace(frame, samples=None) for frame in window.frames))
    return _shortened(window, model_config(config).current, rng) if rng.random() < MISSING_SHARE else window


def _places(data: ClipDataset, config: TrainConfig, step: int, share: tuple[int, int]) -> list[tuple[int, int, int]]:
    """(clip, epoch, place in the epoch) of each item of a batch, in the endless order of clips."""
    rank, processes = share
    size = config.batch // processes
    first = step * config.batch + rank * size
    places = [divmod(position, len(data)) for position in range(first, first + size)]
    return [(_order(len(data), config.seed, epoch)[place], epoch, place) for epoch, place in places]


def _order(count: int, seed: int, epoch: int) -> list[int]:
    return np.random.default_rng([seed, epoch]).permutation(count).tolist()


def _clip(data: ClipDataset, config: TrainConfig, index: int, epoch: int, place: int) -> list[Frame]:
    """An augmented clip. One with a lead-in does not run backwards: the frames before may have no references."""
    rng = np.random.default_rng([config.seed, epoch, place])
    signal = config.signal if config.signal != "both" else "color" if rng.random() < COLOR_SHARE else "indirect"
    reads = model_config(config).reads
    wanted = {"size": config.size, "frames": config.frames, "lead_in": config.lead_in}
    frames = data.load(index, signal=signal, rng=rng, layers=reads, **wanted)
    frames = augment(frames, rng, reversible=len(frames) == config.frames)
    if len(frames) == 1 and rng.random() < config.shade:
        return shade(frames, rng)
    return relight(frames, rng) if rng.random() < config.relight else frames


def _window(data: ClipDataset, config: TrainConfig, index: int, epoch: int, place: int) -> tuple[list[Frame], ...]:
    """An augmented window: its frames, and as many frames whose radiance is the denoised one."""
    rng = np.random.default_rng([config.seed, epoch, place])
    pairs = _estimates(data.paths[index], config)
    method, signal = pairs[rng.integers(len(pairs))]
    count = config.frames
    both = data.load(index, signal=signal, size=config.size, frames=count, rng=rng, estimates=method)
    seed = int(rng.integers(1 << 31))  # one draw of the augmentation for both
    return tuple(augment(part, np.random.default_rng(seed)) for part in (both[:count], both[count:]))


def _estimates(path: Path, config: TrainConfig) -> list[tuple[str, str]]:
    """(method, signal) of the denoised frames of a clip that a combiner learns from. Raises InputError for none."""
    pairs = [
        (method, signal)
        for method in config.estimates
        for signal in estimated_signals(path, method)
        if signal in _signals(config)
    ]
    if not pairs:
        raise InputError(f"{path}: no frames denoised by {' or '.join(config.estimates)} for the signal "
                         f"{config.signal}; make them: rtdenoise estimates {path.parent}")  # fmt: skip
    return pairs


def _signals(config: TrainConfig) -> tuple[str, ...]:
    return tuple(SIGNALS) if config.signal == "both" else (config.signal,)


def _shortened(window: Window, current: int, rng: np.random.Generator) -> Window:
    """The window without the frames before, after, or on both sides of the current one."""
    side = rng.integers(3)
    first = 0 if side == 1 else current
    last = len(window.frames) if side == 0 else current + 1
    kept = range(first, last)
    return Window(
        *(tuple(x if i in kept else None for i, x in enumerate(part)) for part in (window.frames, window.estimates))
    )
