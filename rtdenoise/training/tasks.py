"""Batches, loss and validation of each architecture: its row of `TASKS`, or else `DENOISING`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from ..data.clips import ClipDataset
from ..exposure import exposure
from ..frame import Frame
from ..models import Combiner, Denoiser, Window
from ..models.presets import Config
from ..motion import occlusion_weights, uncovered
from .batches import Batch, clips, windows
from .config import TrainConfig
from .validate import validate, validate_windows

LEAST_LOSS = 1e-6
Terms = dict[str, float]  # of the loss, to log


@dataclass(frozen=True)
class Task:
    """How networks of an architecture are trained."""

    batch: Batch
    loss: Callable[[Any, Any, TrainConfig, int], tuple[Tensor, Terms]]
    """(network, batch, options, step) -> the loss, and its terms."""
    validate: Callable[[Any, ClipDataset, TrainConfig], dict[str, float]]
    """(network, clips, options) -> numbers to log; the weights with the greatest "denoised" are kept."""


def denoiser_loss(model: Denoiser, clip: list[Frame], config: TrainConfig, step: int) -> tuple[Tensor, Terms]:
    """Mean loss over a batch of clips, of each the mean over its last `config.frames` frames to the power that `config`
    asks for; history passes from frame to frame, those of the lead-in before them included."""
    with_occlusion = config.occlusion_loss and step >= config.steps // 2
    terms = {"spatial": 0.0, "temporal": 0.0, "occlusion": 0.0}
    total, history, previous = 0.0, None, None
    masks: list[Tensor] = []
    length = min(len(clip), config.frames)
    rng = np.random.default_rng([config.seed, step])
    cut = int(rng.integers(1, length)) if length > 1 and rng.random() < config.cuts else 0
    for i, frame in enumerate((frame.to(config.device) for frame in clip), start=length - len(clip)):
        if cut and i == cut:
            history, previous, masks = None, None, []
        masks = [uncovered(frame, history and history.motion_next), *masks][:3]
        with torch.set_grad_enabled(i >= 0), torch.autocast(config.device, torch.bfloat16, enabled=config.amp):
            image, history = model.step(frame, history)
        if i < 0:
            continue
        weights = occlusion_weights(masks) if with_occlusion else None
        scale = config.loss_exposure * exposure(frame.reference)
        loss = model.loss(image, frame, previous, weights, scale, config.huber)
        total = total + loss.total / length
        for name in terms:
            terms[name] += getattr(loss, name).mean().item() / length
        previous = (image, frame.reference)
    if config.loss_power != 1:
        total = (total + LEAST_LOSS) ** config.loss_power  # the root of 0 has no gradient
    return total.mean(), terms


def combiner_loss(model: Combiner, window: Window, config: TrainConfig, step: int) -> tuple[Tensor, Terms]:
    """Loss of the current frame of a batch of windows."""
    window, current = window.to(config.device), model.config.current
    with torch.autocast(config.device, torch.bfloat16, enabled=config.amp):
        combined = model.combine(window)
    return model.loss(combined, window.frames[current], window.estimates[current]), {}


TASKS = {"combiner": Task(windows, combiner_loss, validate_windows)}
DENOISING = Task(clips, denoiser_loss, validate)


def task_of(config: Config) -> Task:
    """How a network is trained: the row of its architecture, or else as a denoiser."""
    return TASKS.get(config.architecture, DENOISING)
