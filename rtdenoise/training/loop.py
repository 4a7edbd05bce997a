"""Train the denoiser: `rtdenoise train --data DIR --out RUN`. Resumable at any step, deterministic with a seed.

A run directory explains itself: `config.json` (all options but `ELSEWHERE`), `log.jsonl` (a line per logged step
and per validation), `checkpoint.pt` (everything needed to go on), `weights.safetensors` (the averaged weights of the
best validation, ready for `rtdenoise denoise --model`).
"""

from __future__ import annotations

import json
import math
import signal
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, nullcontext
from dataclasses import asdict, fields
from pathlib import Path

import numpy as np
import torch

from .. import __version__
from ..color import display_exposure
from ..data.clips import ClipDataset
from ..errors import InputError
from ..frame import Frame, stack
from ..metrics import psnr
from ..models import Denoiser, save
from ..motion import uncovered
from .augment import augment, relight
from .config import TrainConfig
from .distributed import any_of, processes, wait_for_all
from .log import Log
from .trainer import Trainer, check

OnStep = Callable[[int, int, float], None]  # step, steps in all, loss
WEIGHTS = "weights.safetensors"
HOPELESS = 20  # steps in turn without a finite loss: a poisoned clip costs one, broken weights all
# Options that may change when a run is resumed.
ELSEWHERE = ("data", "val", "out", "device", "init", "tensorboard", "checkpoint_minutes")


def train(config: TrainConfig, on_step: OnStep | None = None) -> Path:
    """Run or resume; returns the path of the weights: those of the best validation, or the last without `val`.
    `on_step` is told the step, the number of all steps and the loss: once at the start (NaN), then after each step.

    Under `torchrun` each process works on its share of every batch (`distributed`).

    Raises InputError for unusable data or changed options, and KeyboardInterrupt after the checkpoint is written where
    Ctrl-C or SIGTERM stopped it.
    """
    check(config)
    with processes(config.device) as share:
        return _train(config, share, on_step or (lambda step, steps, loss: None))


def _train(config: TrainConfig, share: tuple[int, int], on_step: OnStep) -> Path:
    rank, count = share
    if config.batch % count:
        raise InputError(f"batch: expected a multiple of the {count} processes, got {config.batch}")
    data = ClipDataset(*config.data)
    validation = ClipDataset(config.val) if config.val else None
    if validation and (shared := data.scenes() & validation.scenes()):
        raise InputError(f"{config.val}: shows scenes that are in the training clips too, such as {min(shared)}; "
                         "validation would say nothing about others")  # fmt: skip
    if validation and "references" in validation.facts(0):
        raise InputError(f"{config.val}: its references are denoised, and would reward whatever is as smooth; "
                         "validate on clips as they were rendered")  # fmt: skip
    _batch(data, config, 0, share)  # whatever does not fit is told before there is a run
    out = Path(config.out)
    out.mkdir(parents=True, exist_ok=True)
    trainer = Trainer(config)
    if rank == 0:
        _same_config(config, out / "config.json")
    if (out / "checkpoint.pt").exists():
        trainer.load(out / "checkpoint.pt")
    with _until_stopped() as stopping:
        _run(trainer, share, data, validation, stopping, on_step)
    if rank == 0:
        trainer.save(out / "checkpoint.pt")
        if validation is None or not (out / WEIGHTS).exists():
            _save_weights(trainer, out / WEIGHTS)
        if trainer.skipped:
            print(f"{out}: {trainer.skipped} steps skipped: loss or gradient was not finite; log.jsonl says which")
    wait_for_all()
    if stopping:
        raise KeyboardInterrupt
    return out / WEIGHTS


def _run(
    trainer: Trainer,
    share: tuple[int, int],
    data: ClipDataset,
    validation: ClipDataset | None,
    stopping: list[int],
    on_step: OnStep,
) -> None:
    """Steps until the last one, or until a process was told to stop. The next batch is read meanwhile."""
    config, first, out = trainer.config, share[0] == 0, Path(trainer.config.out)
    log = Log(out, trainer.step, config.tensorboard) if first else nullcontext()
    with log, ThreadPoolExecutor(1) as reader:
        if first:
            on_step(trainer.step, config.steps, math.nan)
        batch = reader.submit(_batch, data, config, trainer.step, share)
        saved = time.monotonic()
        while trainer.step < config.steps and not any_of(bool(stopping)):
            clip = batch.result()
            batch = reader.submit(_batch, data, config, trainer.step + 1, share)
            started = time.perf_counter()
            row = trainer.train_step([frame.to(config.device) for frame in clip])
            row["seconds"] = time.perf_counter() - started
            if trainer.skipped_in_turn == HOPELESS:
                raise InputError(f"{out}: {HOPELESS} steps in turn without a finite loss or gradient: the weights are "
                                 f"broken; begin another run with a lower --lr, from --init {out / WEIGHTS} if that is "
                                 "there")  # fmt: skip
            if not first:
                continue
            on_step(trainer.step, config.steps, row["loss"])
            last = trainer.step == config.steps
            if trainer.step % 20 == 0 or last or not math.isfinite(row["grad_norm"]):
                log.write(row)
            if validation and (trainer.step % config.validate_every == 0 or last):
                found = validate(trainer.average, validation, config)
                log.write({"step": trainer.step, "validation": found})
                if found["denoised"] > trainer.best:
                    trainer.best = found["denoised"]
                    _save_weights(trainer, out / WEIGHTS)
            if time.monotonic() - saved > 60 * config.checkpoint_minutes:
                trainer.save(out / "checkpoint.pt")
                saved = time.monotonic()


@contextmanager
def _until_stopped() -> Iterator[list[int]]:
    """A list that Ctrl-C and SIGTERM add to, instead of ending the process in the middle of a step."""
    stopping: list[int] = []
    numbers = signal.SIGINT, signal.SIGTERM
    previous = {n: signal.signal(n, lambda number, _: stopping.append(number)) for n in numbers}
    try:
        yield stopping
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)


def _save_weights(trainer: Trainer, path: Path) -> None:
    training = {**_plain(trainer.config), "reached_step": trainer.step}
    save(trainer.average, path, training=json.dumps(training), version=__version__)


@torch.inference_mode()
def validate(model: Denoiser, clips: ClipDataset, config: TrainConfig) -> dict[str, float]:
    """Mean PSNR in dB on the display transform of noisy and denoised frames (all but the first), and inside uncovered
    regions."""
    rows: dict[str, list[float]] = {"noisy": [], "denoised": [], "denoised_uncovered": []}
    for index in range(len(clips)):
        frames = clips.load(index, signal="color" if config.signal == "color" else "indirect")
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


def _batch(data: ClipDataset, config: TrainConfig, step: int, share: tuple[int, int] = (0, 1)) -> list[Frame]:
    """This process's clips of one step, a function of (seed, step) alone: every clip is seen once an epoch."""
    rank, count = share
    size = config.batch // count
    first = step * config.batch + rank * size
    chosen = []
    for position in range(first, first + size):
        epoch, place = divmod(position, len(data))
        index = np.random.default_rng([config.seed, epoch]).permutation(len(data))[place]
        rng = np.random.default_rng([config.seed, epoch, place])
        signal = config.signal if config.signal != "both" else "color" if rng.random() < 1 / 3 else "indirect"
        frames = data.load(int(index), signal=signal, size=config.size, frames=config.frames, rng=rng)
        frames = augment(frames, rng)
        chosen.append(relight(frames, rng) if rng.random() < config.relight else frames)
    return [stack(list(frames)) for frames in zip(*chosen, strict=True)]


def _plain(config: TrainConfig) -> dict:
    """Options as JSON holds them, without those that say where and not what."""
    options = {key: value for key, value in asdict(config).items() if key not in ELSEWHERE}
    return options | {"set": list(config.set)}


def _same_config(config: TrainConfig, path: Path) -> None:
    """Write the options of a new run; refuse to go on with other ones. What an older run does not know of had what is
    the default now."""
    options, defaults = _plain(config), {field.name: field.default for field in fields(TrainConfig)} | {"set": []}
    if path.exists():
        before = json.loads(path.read_text())["options"]
        before = {"model" if key == "preset" else key: value for key, value in before.items()}  # older runs say preset
        for key in options:
            if (was := before.get(key, defaults[key])) != options[key]:
                raise InputError(
                    f"{path.parent}: this run was started with {key} = {was}, not {options[key]}; use another --out"
                )
    else:
        path.write_text(json.dumps({"version": __version__, "options": options}, indent=1) + "\n")
