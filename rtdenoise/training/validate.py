"""Validation: the error of a model on clips of scenes that it was not trained on."""

from __future__ import annotations

import math
from itertools import product

import numpy as np
import torch

from ..color import display_exposure
from ..data.clips import ClipDataset
from ..errors import InputError
from ..evaluate.sequence import outputs, uncovered
from ..frame import Frame, History
from ..metrics import psnr
from ..models import COMBINERS, Combiner, Denoiser, Window
from .batches import TrainingSet
from .config import TrainConfig, model_config

MIN_UNCOVERED = 0.005  # share of a frame; the PSNR of fewer pixels is meaningless


def open_validation(config: TrainConfig, data: TrainingSet) -> ClipDataset | None:
    """The clips of `config.val`. Raises InputError where they show scenes of `data`, have denoised references, or
    cannot be validated on (`_load`)."""
    if config.val is None:
        return None
    clips = ClipDataset(config.val)
    if shared := data.scenes() & clips.scenes():
        raise InputError(f"{config.val}: shows scenes that are in the training clips too, such as {min(shared)}; "
                         "validate on other scenes")  # fmt: skip
    if "references" in clips.facts(0):
        raise InputError(f"{config.val}: its references are denoised, and would reward whatever is as smooth; "
                         "validate on clips as they were rendered")  # fmt: skip
    for index, method in product(range(len(clips)), config.estimates if config.model in COMBINERS else ("",)):
        _load(clips, config, index, method)
    return clips


def _load(clips: ClipDataset, config: TrainConfig, index: int, method: str = "") -> list[Frame]:
    """The frames of a clip, and those that `method` denoised; of both signals a combiner takes color, other networks
    indirect. Raises InputError for a clip that lacks what the network reads, or is not finite."""
    signal = config.signal if config.signal != "both" else "color" if method else "indirect"
    reads = () if method else model_config(config).reads
    frames = clips.load(index, signal=signal, layers=reads, estimates=method)
    for frame in frames:
        for name, layer in frame.layers():
            if not layer.isfinite().all():
                raise InputError(f"{clips.paths[index]}: damaged: {name} is not finite; delete it and make it again")
    return frames


@torch.inference_mode()
def validate(model: Denoiser, clips: ClipDataset, config: TrainConfig) -> dict[str, float]:
    """Mean display PSNR in dB of noisy frames, of denoised frames, and of denoised uncovered regions (NaN without
    any). A clip's first frame counts only where it is the only one."""
    rows: dict[str, list[float]] = {"noisy": [], "denoised": [], "denoised_uncovered": []}

    def step(frame: Frame, history: History | None) -> tuple[torch.Tensor, History]:
        with torch.autocast(config.device, torch.bfloat16, enabled=config.amp):
            return model.step(frame, history)

    for index in range(len(clips)):
        frames = [frame.to(config.device) for frame in _load(clips, config, index)]
        scale, masks = display_exposure(torch.cat([frame.reference for frame in frames])), uncovered(frames)
        pairs = list(zip(outputs(step, frames), masks, strict=True))
        for output, mask in pairs[1:] or pairs:
            frame, image = output.frame, output.image
            rows["noisy"].append(psnr(frame.radiance, frame.reference, scale))
            rows["denoised"].append(psnr(image, frame.reference, scale))
            if mask.float().mean() > MIN_UNCOVERED:
                rows["denoised_uncovered"].append(psnr(image, frame.reference, scale, mask))
    return {name: float(np.mean(values)) if values else math.nan for name, values in rows.items()}


@torch.inference_mode()
def validate_windows(model: Combiner, clips: ClipDataset, config: TrainConfig) -> dict[str, float]:
    """Mean display PSNR in dB over the clips' middle frames and the methods of `config.estimates`: of the frames that
    these denoised (`estimate`) and of the combined ones (`denoised`)."""
    offsets = model.config.offsets
    rows: dict[str, list[float]] = {"estimate": [], "denoised": []}
    for index, method in ((i, m) for i in range(len(clips)) for m in config.estimates):
        both = _load(clips, config, index, method)
        middle, count = len(both) // 4, len(both) // 2
        places = [middle + offset if 0 <= middle + offset < count else None for offset in offsets]
        frames = tuple(None if p is None else both[p] for p in places)
        window = Window(frames, tuple(None if p is None else both[count + p].radiance for p in places))
        with torch.autocast(config.device, torch.bfloat16, enabled=config.amp):
            image = model.combine(window.to(config.device)).image.cpu()
        reference, z = both[middle].reference, both[count + middle].radiance
        scale = display_exposure(reference)
        rows["estimate"].append(psnr(z, reference, scale))
        rows["denoised"].append(psnr(image, reference, scale))
    return {name: float(np.mean(values)) if values else math.nan for name, values in rows.items()}
