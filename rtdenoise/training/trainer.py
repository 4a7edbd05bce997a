"""One training step, and the state that a checkpoint holds."""

from __future__ import annotations

import io
import math
from copy import deepcopy
from dataclasses import fields, replace
from pathlib import Path
from reprlib import repr as shown
from typing import Any

import torch

from ..errors import InputError, did_you_mean
from ..files import open_regular, write_atomically
from ..models import COMBINERS, PRESETS, STILLS, Combiner, Config, Denoiser, HybridConfig, create, grow, read
from ..models.inference import choose_device
from .config import TrainConfig, model_config
from .distributed import average_gradients, means
from .muon import Muon
from .tasks import task_of

MOST = 10**9  # of options that count something
MAX_LR = 100.0
CHOICES = {
    "signal": ("indirect", "color", "both"), "motion": ("dual", "traditional"), "optimiser": ("adam", "muon"),
    "device": ("cpu", "cuda"),
}  # fmt: skip


class Trainer:
    """Model, optimisers, averaged weights and the step counter: the state in a checkpoint."""

    def __init__(self, config: TrainConfig) -> None:
        torch.manual_seed(config.seed)
        self.config = config
        wanted = model_config(config)
        self.task = task_of(wanted)
        self.model = (create(wanted) if config.init is None else _initial(config, wanted)).to(config.device)
        self.model.to(memory_format=torch.channels_last)  # the layout that convolutions compute in
        self.average = deepcopy(self.model).eval().requires_grad_(False)
        self.optimisers = _optimisers(self.model, config)
        self.step = 0
        self.best = -math.inf  # dB, of the best validation so far
        self.skipped = 0  # steps lost to a loss or gradient that was not finite
        self.skipped_in_turn = 0  # such steps since the last good one

    def train_step(self, batch: Any) -> dict[str, float]:
        """One optimiser step on a batch of `Task.batch`; returns the numbers to log."""
        config = self.config
        rate = (
            config.lr
            * min(1.0, (self.step + 1) / config.warmup)
            * 0.5
            * (1 + math.cos(math.pi * self.step / config.steps))
        )
        for optimiser in self.optimisers:
            optimiser.param_groups[0]["lr"] = rate
        total, terms = self.task.loss(self.model, batch, config, self.step)
        self.model.zero_grad()
        total.backward()
        average_gradients(self.model.parameters())
        norm = torch.nn.utils.clip_grad_norm_(self.model.parameters(), 1.0).item()
        losses = means({"loss": total.item(), **terms})
        if math.isfinite(norm) and math.isfinite(losses["loss"]):
            self.skipped_in_turn = 0
            for optimiser in self.optimisers:
                optimiser.step()
        else:  # a broken clip must not break the weights
            self.skipped += 1
            self.skipped_in_turn += 1
        self.step += 1
        decay = min(0.999, self.step / (self.step + 10))
        for mean, parameter in zip(self.average.parameters(), self.model.parameters(), strict=True):
            mean.lerp_(parameter.detach(), 1 - decay)
        return {"step": self.step, **losses, "grad_norm": norm, "lr": rate, "skipped": self.skipped}

    def save(self, path: Path) -> None:
        """Write the checkpoint. Raises InputError where it cannot be written."""
        state = {
            "step": self.step,
            "best": self.best,
            "skipped": self.skipped,
            "model": self.model.state_dict(),
            "average": self.average.state_dict(),
            "optimisers": [optimiser.state_dict() for optimiser in self.optimisers],
        }
        content = io.BytesIO()
        torch.save(state, content)
        write_atomically(path, content.getbuffer(), sync=True)

    def load(self, path: Path) -> None:
        """Continue from a checkpoint: clips depend on the step alone, so the curve is that of an uninterrupted run.

        Raises InputError for a file that is damaged or of another network or optimiser. Nothing in it is executed.
        """
        open_regular(path).close()
        try:
            state = torch.load(path, map_location=self.config.device, weights_only=True)
            step, best, skipped = int(state["step"]), float(state["best"]), int(state["skipped"])
            self.model.load_state_dict(state["model"])
            self.average.load_state_dict(state["average"])
            for optimiser, held in zip(self.optimisers, state["optimisers"], strict=True):
                optimiser.load_state_dict(held)
            self._check_loaded(step, best, skipped)
        except InputError:
            raise
        except Exception as error:  # torch has no class of its own for this: pickles fail in a dozen ways
            if isinstance(error, MemoryError):
                raise
            problem = " ".join(str(error).split())[:200] or type(error).__name__
            raise InputError(f"{path}: not a checkpoint of this run ({problem}); remove it to begin anew, or copy one "
                             "there that is intact") from None  # fmt: skip
        self.step, self.best, self.skipped = step, best, skipped

    def _check_loaded(self, step: int, best: float, skipped: int) -> None:
        """Raise ValueError for values that no run saves."""
        if step < 0 or skipped < 0 or math.isnan(best):
            raise ValueError(f"step {step}, best {best}, skipped {skipped}")
        for name, tensor in (*self.model.named_parameters(), *self.average.named_parameters()):
            if not tensor.isfinite().all():
                raise ValueError(f"{name} is not finite")
        for optimiser in self.optimisers:
            for parameter, held in optimiser.state.items():
                for name, value in held.items():
                    if torch.is_tensor(value) and (
                        (value.ndim and value.shape != parameter.shape) or not value.isfinite().all()
                    ):
                        raise ValueError(f"the optimiser's {name} is not finite or not of its parameter's shape")


def _optimisers(model: Denoiser | Combiner, config: TrainConfig) -> list[torch.optim.Optimizer]:
    """Adam for all parameters, or Muon for matrices and Adam for vectors."""
    parameters = list(model.parameters())
    if config.optimiser == "adam":
        return [torch.optim.Adam(parameters, lr=config.lr)]
    matrices, vectors = [p for p in parameters if p.ndim > 1], [p for p in parameters if p.ndim == 1]
    return [Muon(matrices, lr=config.lr), torch.optim.Adam(vectors, lr=config.lr)]


def _initial(config: TrainConfig, wanted: Config) -> Denoiser | Combiner:
    """The network of the file `init`, grown to `wanted`. Raises InputError where it cannot grow to it."""
    model = read(config.init)
    if config.model in PRESETS and "motion" in {field.name for field in fields(model.config)}:
        model.config = replace(model.config, motion=config.motion)
    if model.config != wanted:
        try:
            model = grow(model, wanted)
        except ValueError as error:
            raise InputError(f"{config.init}: its network does not grow into {config.model}: {error}") from None
    return model.train().requires_grad_(True)


def check(config: TrainConfig) -> None:
    """Raise InputError for impossible options."""
    for name in ("steps", "batch", "frames", "size", "validate_every", "warmup", "least_spp"):
        if getattr(config, name) < 1:
            raise InputError(f"{name}: expected 1 or more, got {getattr(config, name)}")
        if getattr(config, name) > MOST:
            raise InputError(f"{name}: expected {MOST} at most, got {shown(getattr(config, name))}")
    if not 0 <= config.lead_in <= MOST:
        raise InputError(f"lead_in: expected 0 to {MOST}, got {shown(config.lead_in)}")
    if config.most_spp is not None and config.most_spp < config.least_spp:
        raise InputError(f"most_spp: expected {config.least_spp} (least_spp) or more, got {shown(config.most_spp)}")
    if not 0 <= config.seed < 2**63:
        raise InputError(f"seed: expected 0 to 2^63 - 1, got {shown(config.seed)}")
    if not 0 < config.lr <= MAX_LR:
        raise InputError(f"lr: expected more than 0 and {MAX_LR:g} at most, got {config.lr}")
    if not 0 < config.loss_exposure < math.inf:
        raise InputError(f"loss_exposure: expected more than 0, got {config.loss_exposure}")
    if not 0 <= config.huber < math.inf:
        raise InputError(f"huber: expected 0 or more, got {config.huber}")
    if not 0 <= config.checkpoint_minutes < math.inf:
        raise InputError(f"checkpoint_minutes: expected 0 or more, got {config.checkpoint_minutes}")
    if not 0 < config.loss_power <= 1:
        raise InputError(f"loss_power: expected more than 0 and 1 at most, got {config.loss_power}")
    for name in ("cuts", "relight", "shade"):
        if not 0 <= getattr(config, name) <= 1:
            raise InputError(f"{name}: expected a share from 0 to 1, got {getattr(config, name)}")
    if config.model not in (known := PRESETS | STILLS | COMBINERS):
        near = did_you_mean(config.model, known)
        raise InputError(f"unknown model {config.model!r}{near}; expected one of {', '.join(known)}")
    for name, (*others, last) in CHOICES.items():
        if getattr(config, name) not in (*others, last):
            known = f"{', '.join(map(repr, others))} or {last!r}"
            raise InputError(f"unknown {name} {getattr(config, name)!r}; expected {known}")
    choose_device(config.device)
    wanted = model_config(config)
    if isinstance(wanted, HybridConfig) and config.init is None:
        raise InputError(f"init: {config.model} leaves its kernels as they are; expected weights to start from, "
                         f"such as --init {config.model}")  # fmt: skip
    if "components" in wanted.reads and config.signal != "color":
        raise InputError(f"signal: {config.model} splits the beauty; expected 'color', got {config.signal!r}")
    for name in ("stills", "lead_in"):
        if getattr(config, name) and config.model in COMBINERS:
            raise InputError(f"{name}: {config.model} takes windows of frames; give clips alone")
    if config.model in COMBINERS and not config.estimates:
        raise InputError(f"estimates: name at least one method whose frames {config.model} corrects")
    if config.model in COMBINERS and config.frames != wanted.frames:
        raise InputError(f"frames: the window of {config.model} has {wanted.frames} frames, got {config.frames}")
