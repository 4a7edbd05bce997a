"""Denoised frames beside training clips: the estimates that a combiner learns to correct."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import torch

from ..data.clip_file import LEAD_IN
from ..data.clips import ClipDataset, estimate_path, estimated_signals, write_estimates
from ..data.layers import SIGNALS
from ..files import fingerprint, remove_unfinished
from .registry import choose
from .sequence import outputs

OnClip = Callable[[int, int], None]  # estimates written or kept, estimates in all


def write_all(
    folders: Sequence[Path],
    methods: Sequence[str],  # for `registry.choose`
    signals: Sequence[str] = tuple(SIGNALS),
    on_clip: OnClip = lambda done, total: None,
) -> int:
    """Denoise every clip of the folders with every method, from its first frame on. Existing estimates are
    kept, unless the clip or the method's weights have changed. Returns how many were written.

    Each method sees the clip's own noisy frames, because y - z depends on z having been made from y. Raises InputError
    for a folder without clips and for an unknown or missing method.
    """
    clips = ClipDataset(*folders)
    chosen = choose(methods)
    for folder in {estimate_path(path, method.name).parent for path in clips.paths for method in chosen}:
        remove_unfinished(folder)
    weights = {method.name: method.fingerprints() for method in chosen}
    done, written, total = 0, 0, len(clips) * len(chosen)
    for index, clip in enumerate(clips.paths):
        frames = fingerprint(clip)
        for method in chosen:
            on_clip(done, total)
            origin = "-".join([frames, *weights[method.name]])
            held = estimated_signals(clip, method.name, origin)
            if missing := [signal for signal in signals if signal not in held]:
                made = {signal: _denoised(clips, index, signal, method) for signal in missing}
                write_estimates(clip, method.name, made, origin)
                written += 1
            done += 1
    on_clip(total, total)
    return written


@torch.inference_mode()
def _denoised(clips: ClipDataset, index: int, signal: str, method):
    """The frames of a clip, those of its lead-in too, as a method denoises them, `[T, 3, H, W]`."""
    frames = clips.load(index, signal=signal, lead_in=clips.facts(index).get(LEAD_IN, 0))
    images = [output.image for output in outputs(method.step(), frames, method.delay)]
    return torch.cat(images).numpy()
