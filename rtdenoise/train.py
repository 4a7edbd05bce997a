"""Train the denoiser: `rtdenoise train --data DIR --out RUN`. Resumable at any step, deterministic with a seed.

A run directory explains itself: `config.json` (all options but paths and device), `log.jsonl` (a line per logged step
and per validation), `checkpoint.pt` (everything needed to go on), `weights.safetensors` (the averaged weights, ready
for `rtdenoise denoise --model`).
"""

from __future__ import annotations

import json
import math
import signal
import time
from concurrent.futures import ThreadPoolExecutor
from copy import deepcopy
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
import torch
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from torch import Tensor

from . import __version__
from .augment import augment
from .color import display_exposure, exposure
from .data.dataset import ClipDataset
from .errors import InputError
from .frame import Frame, stack
from .losses import temporal_kpn_loss
from .metrics import psnr
from .models import PRESETS, TemporalKPN, save
from .motion import occlusion_weights, uncovered


@dataclass(frozen=True)
class TrainConfig:
    """Options of a run. Resuming checks that they have not changed, but for paths and device."""

    data: Path
    """Folder of training clips, written by `rtdenoise render --clips`."""
    out: Path
    """Run directory; a run that is there is resumed."""
    val: Path | None = None
    """Folder of validation clips, of other scenes than the training ones."""
    preset: str = "paper"
    """Model preset."""
    signal: str = "indirect"
    """What is denoised: 'indirect' or 'color'."""
    motion: str = "dual"
    """'dual', or 'traditional' for setting A of the paper."""
    occlusion_loss: bool = True
    """Add L_occ in the second half of the run (setting C of the paper); off: setting B."""
    steps: int = 4000
    """Optimiser steps in all."""
    batch: int = 4
    """Clips a step."""
    frames: int = 9
    """Consecutive frames a clip; the recurrence is back-propagated through all of them."""
    size: int = 128
    """Side of the random crop in pixels."""
    lr: float = 1e-3
    """Peak learning rate of Adam: linear warm-up over 200 steps, then a cosine to zero."""
    seed: int = 0
    """Decides initial weights, order of clips, crops and augmentation."""
    device: str = "cpu"
    """'cpu' or 'cuda'."""
    amp: bool = True
    """Run the convolutions in bfloat16."""
    validate_every: int = 500
    """Steps between validations."""
    checkpoint_minutes: float = 3.0
    """Minutes between checkpoints; one is also written on Ctrl-C and on SIGTERM."""


class Trainer:
    """Model, optimiser, averaged weights and the step counter: what a checkpoint holds."""

    def __init__(self, config: TrainConfig) -> None:
        torch.manual_seed(config.seed)
        self.config = config
        self.model = TemporalKPN(replace(PRESETS[config.preset], motion=config.motion)).to(config.device)
        self.model.unet.to(memory_format=torch.channels_last)
        self.average = deepcopy(self.model).eval().requires_grad_(False)
        self.optimiser = torch.optim.Adam(self.model.parameters(), lr=config.lr)
        self.step = 0
        self.skipped = 0  # steps that a loss or gradient that was not finite has cost

    def train_step(self, clip: list[Frame]) -> dict[str, float]:
        """One optimiser step on a batch of clips; returns the numbers to log."""
        config = self.config
        rate = config.lr * min(1.0, (self.step + 1) / 200) * 0.5 * (1 + math.cos(math.pi * self.step / config.steps))
        for group in self.optimiser.param_groups:
            group["lr"] = rate
        with_occlusion = config.occlusion_loss and self.step >= config.steps // 2
        history = previous = None
        masks: list[Tensor] = []
        terms = {"spatial": 0.0, "temporal": 0.0, "occlusion": 0.0}
        total = 0.0
        for frame in clip:
            masks = [uncovered(frame, history and history.motion_next), *masks][:3]
            with torch.autocast(config.device, torch.bfloat16, enabled=config.amp):
                image, history = self.model.step(frame, history)
            weights = occlusion_weights(masks) if with_occlusion else None
            loss = temporal_kpn_loss(image, frame.reference, previous, weights, exposure(frame.reference))
            total = total + loss.total / len(clip)
            for name in terms:
                terms[name] += getattr(loss, name).item() / len(clip)
            previous = (image, frame.reference)

        self.optimiser.zero_grad(set_to_none=True)
        total.backward()
        norm = torch.nn.utils.clip_grad_norm_(self.model.parameters(), 1.0).item()
        if math.isfinite(norm):
            self.optimiser.step()
        else:  # a poisoned clip must not poison the weights
            self.skipped += 1
        self.step += 1
        decay = min(0.999, self.step / (self.step + 10))
        for mean, parameter in zip(self.average.parameters(), self.model.parameters(), strict=True):
            mean.lerp_(parameter.detach(), 1 - decay)
        row = {"step": self.step, "loss": total.item(), **terms, "grad_norm": norm, "lr": rate}
        return row | {"skipped": self.skipped}

    def save(self, path: Path) -> None:
        """Write the checkpoint, atomically."""
        state = {
            "step": self.step,
            "skipped": self.skipped,
            "model": self.model.state_dict(),
            "average": self.average.state_dict(),
            "optimiser": self.optimiser.state_dict(),
        }
        torch.save(state, path.with_suffix(".tmp"))
        path.with_suffix(".tmp").replace(path)

    def load(self, path: Path) -> None:
        """Go on from a checkpoint: clips depend on the step alone, so the curve is the uninterrupted one."""
        state = torch.load(path, map_location=self.config.device, weights_only=True)
        self.step = state["step"]
        self.skipped = state.get("skipped", 0)
        self.model.load_state_dict(state["model"])
        self.average.load_state_dict(state["average"])
        self.optimiser.load_state_dict(state["optimiser"])


def train(config: TrainConfig) -> Path:
    """Run or resume; returns the path of the weights. Raises InputError for unusable data or changed options, and
    KeyboardInterrupt after the checkpoint is written where Ctrl-C or SIGTERM stopped it."""
    _check(config)
    data = ClipDataset(config.data)
    validation = ClipDataset(config.val) if config.val else None
    _batch(data, config, 0)  # whatever does not fit is told before there is a run
    out = Path(config.out)
    out.mkdir(parents=True, exist_ok=True)
    _same_config(config, out / "config.json")

    trainer = Trainer(config)
    if (out / "checkpoint.pt").exists():
        trainer.load(out / "checkpoint.pt")
        _forget_after(out / "log.jsonl", trainer.step)
    stopping: list[int] = []
    previous_handlers = {
        s: signal.signal(s, lambda number, _: stopping.append(number)) for s in (signal.SIGINT, signal.SIGTERM)
    }
    columns = TextColumn("training"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn()
    progress = Progress(*columns, TextColumn("{task.fields[loss]}"))
    try:
        with progress, (out / "log.jsonl").open("a") as log, ThreadPoolExecutor(1) as reader:
            task = progress.add_task("train", total=config.steps, completed=trainer.step, loss="")
            batch = reader.submit(_batch, data, config, trainer.step)
            saved = time.monotonic()
            while trainer.step < config.steps and not stopping:
                clip = batch.result()
                batch = reader.submit(_batch, data, config, trainer.step + 1)
                started = time.perf_counter()
                row = trainer.train_step([frame.to(config.device) for frame in clip])
                row["seconds"] = time.perf_counter() - started
                progress.update(task, completed=trainer.step, loss=f"loss {row['loss']:.4f}")
                if trainer.step % 20 == 0 or trainer.step == config.steps or not math.isfinite(row["grad_norm"]):
                    _write(log, row)
                if validation and (trainer.step % config.validate_every == 0 or trainer.step == config.steps):
                    _write(log, {"step": trainer.step, "validation": validate(trainer.average, validation, config)})
                if time.monotonic() - saved > 60 * config.checkpoint_minutes:
                    trainer.save(out / "checkpoint.pt")
                    saved = time.monotonic()
    finally:
        for number, handler in previous_handlers.items():
            signal.signal(number, handler)
    trainer.save(out / "checkpoint.pt")
    weights = out / "weights.safetensors"
    save(
        trainer.average,
        weights,
        training=json.dumps({**_plain(config), "reached_step": trainer.step}),
        version=__version__,
    )
    if trainer.skipped:
        print(f"{out}: {trainer.skipped} steps skipped, their loss or gradient was not finite; log.jsonl says which")
    if stopping:
        raise KeyboardInterrupt
    return weights


@torch.inference_mode()
def validate(model: TemporalKPN, clips: ClipDataset, config: TrainConfig) -> dict[str, float]:
    """Mean PSNR in dB on the display transform of noisy and denoised frames (all but the first), and inside uncovered
    regions."""
    rows: dict[str, list[float]] = {"noisy": [], "denoised": [], "denoised_uncovered": []}
    for index in range(len(clips)):
        frames = clips.load(index, signal=config.signal)
        history, scale = None, display_exposure(torch.cat([frame.reference for frame in frames]))
        for i, frame in enumerate(frame.to(config.device) for frame in frames):
            mask = uncovered(frame, history and history.motion_next)
            with torch.autocast(config.device, torch.bfloat16, enabled=config.amp):
                image, history = model.step(frame, history)
            if i == 0:
                continue
            rows["noisy"].append(psnr(frame.radiance, frame.reference, scale))
            rows["denoised"].append(psnr(image, frame.reference, scale))
            if mask.float().mean() > 0.005:  # a handful of pixels has no meaningful PSNR
                rows["denoised_uncovered"].append(psnr(image, frame.reference, scale, mask))
    return {name: float(np.mean(values)) if values else math.nan for name, values in rows.items()}


def _batch(data: ClipDataset, config: TrainConfig, step: int) -> list[Frame]:
    """The clips of one step, a function of (seed, step) alone: every clip is seen once an epoch."""
    chosen = []
    for position in range(step * config.batch, (step + 1) * config.batch):
        epoch, place = divmod(position, len(data))
        index = np.random.default_rng([config.seed, epoch]).permutation(len(data))[place]
        rng = np.random.default_rng([config.seed, epoch, place])
        frames = data.load(int(index), signal=config.signal, size=config.size, frames=config.frames, rng=rng)
        chosen.append(augment(frames, rng))
    return [stack(list(frames)) for frames in zip(*chosen, strict=True)]


def _check(config: TrainConfig) -> None:
    for name in ("steps", "batch", "frames", "size", "validate_every"):
        if getattr(config, name) < 1:
            raise InputError(f"{name}: expected 1 or more, got {getattr(config, name)}")
    if config.preset not in PRESETS:
        raise InputError(f"unknown preset {config.preset!r}; expected one of {', '.join(PRESETS)}")
    if config.motion not in ("dual", "traditional"):
        raise InputError(f"unknown motion {config.motion!r}; expected 'dual' or 'traditional'")
    if config.device not in ("cpu", "cuda"):
        raise InputError(f"unknown device {config.device!r}; expected 'cpu' or 'cuda'")
    if config.device == "cuda" and not torch.cuda.is_available():
        raise InputError("device cuda: no CUDA device was found; use --device cpu")


def _plain(config: TrainConfig) -> dict:
    """Options as JSON holds them, without the paths, which say where and not what."""
    return {key: value for key, value in asdict(config).items() if key not in ("data", "val", "out", "device")}


def _same_config(config: TrainConfig, path: Path) -> None:
    """Write the options of a new run; refuse to go on with other ones."""
    options = _plain(config)
    if path.exists():
        before = json.loads(path.read_text())["options"]
        for key in options:
            if before.get(key) != options[key]:
                raise InputError(
                    f"{path.parent}: this run was started with {key} = {before.get(key)}, not {options[key]}; "
                    "use another --out"
                )
    else:
        path.write_text(json.dumps({"version": __version__, "options": options}, indent=1) + "\n")


def _forget_after(path: Path, step: int) -> None:
    """Drop from the log what a killed run did after its last checkpoint: it will be done again."""
    if path.exists():
        lines = path.read_text().splitlines(keepends=True)
        kept = [line for line in lines if line.endswith("\n") and json.loads(line)["step"] <= step]
        path.write_text("".join(kept))


def _write(log, row: dict) -> None:
    """A line of the log; JSON has no NaN, so what is not finite becomes null."""
    row = {key: None if isinstance(value, float) and not math.isfinite(value) else value for key, value in row.items()}
    log.write(json.dumps(row) + "\n")
    log.flush()
