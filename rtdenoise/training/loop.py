"""Train a denoiser: `rtdenoise train --data DIR --out RUN`. Resumable at any step, deterministic with a seed.

A run directory explains itself: `config.json` (the options except `NOT_COMPARED`), `log.jsonl` (a line per
logged step and per validation), `checkpoint.pt` (everything needed to go on), `weights.safetensors` (the averaged
weights of the best validation, ready for `rtdenoise denoise --model`).
"""

from __future__ import annotations

import json
import math
import signal
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, nullcontext
from dataclasses import asdict, replace
from pathlib import Path

from .. import __version__
from ..data.clips import ClipDataset
from ..errors import InputError
from ..files import lock, read_json, remove_unfinished, write_atomically
from ..models import save
from .batches import TrainingSet
from .config import TrainConfig
from .distributed import any_of, processes, wait_for_all
from .log import Log
from .trainer import Trainer, check
from .validate import open_validation

OnStep = Callable[[int, int, float], None]  # step, steps in all, loss
WEIGHTS, CHECKPOINT = "weights.safetensors", "checkpoint.pt"
LOG_EVERY = 20  # steps
MAX_SKIPPED_IN_TURN = 20  # steps without a finite loss: a broken clip costs one, broken weights all
NOT_COMPARED = (  # may change on resuming
    "data", "stills", "val", "out", "device", "init", "tensorboard", "checkpoint_minutes",
)  # fmt: skip


def train(config: TrainConfig, on_step: OnStep = lambda step, steps, loss: None) -> Path:
    """Run or resume; returns the path of the weights: those of the best validation, or the last without `val`.

    `on_step` is called at the start, with a loss of NaN, and after each step. Under `torchrun` each process works on
    its share of every batch (`distributed`), and the first one alone calls `on_step`.

    Raises InputError for unusable data, changed options, or a folder that another run is using, and KeyboardInterrupt
    after Ctrl-C or SIGTERM, once the checkpoint is written. In a thread other than the main one it knows of neither.
    """
    check(config)
    with processes(config.device) as share:
        rank, count = share
        if config.batch % count:
            raise InputError(f"batch: expected a multiple of the {count} processes, got {config.batch}")
        data = TrainingSet.open(config)
        validation = open_validation(config, data)
        data.refuse_unfit(config)
        out = Path(config.out)
        trainer = Trainer(replace(config, init=None) if (out / CHECKPOINT).exists() else config)
        # What fails before leaves no folder.
        out.mkdir(parents=True, exist_ok=True)
        with lock(out) if rank == 0 else nullcontext():
            return _train(trainer, share, data, validation, on_step)


def _train(
    trainer: Trainer,
    share: tuple[int, int],
    data: TrainingSet,
    validation: ClipDataset | None,
    on_step: OnStep,
) -> Path:
    config, first = trainer.config, share[0] == 0
    out = Path(config.out)
    if first:
        remove_unfinished(out)
        _same_config(config, out / "config.json")
    if (out / CHECKPOINT).exists():
        trainer.load(out / CHECKPOINT)
        if trainer.step > config.steps:
            raise InputError(f"{out / CHECKPOINT}: is of step {trainer.step}, the run has {config.steps}; remove it to "
                             "begin anew")  # fmt: skip
        if validation is None and trainer.best > -math.inf and (out / WEIGHTS).exists():
            raise InputError(f"{out / WEIGHTS}: holds the weights of the best validation so far, which the last ones "
                             "would overwrite: name --val again, or move that file away")  # fmt: skip
    with _until_stopped() as stopping:
        if first:
            _lead(trainer, share, data, validation, stopping, on_step)
        else:
            for _ in _steps(trainer, share, data, stopping):
                pass
    wait_for_all()
    if stopping:
        raise KeyboardInterrupt
    return out / WEIGHTS


def _lead(
    trainer: Trainer,
    share: tuple[int, int],
    data: TrainingSet,
    validation: ClipDataset | None,
    stopping: list[int],
    on_step: OnStep,
) -> None:
    """The steps of the first process: it also logs, validates and saves."""
    config, out = trainer.config, Path(trainer.config.out)
    with Log(out, trainer.step, config.tensorboard) as log:
        on_step(trainer.step, config.steps, math.nan)
        saved = time.monotonic()
        for row in _steps(trainer, share, data, stopping):
            on_step(trainer.step, config.steps, row["loss"])
            last = trainer.step == config.steps
            if trainer.skipped_in_turn:
                row["clips"] = sorted({str(path) for path in data.paths(config, trainer.step - 1)})
            if trainer.step % LOG_EVERY == 0 or last or trainer.skipped_in_turn:
                log.write(row)
            if validation and (trainer.step % config.validate_every == 0 or last):
                found = trainer.task.validate(trainer.average, validation, config)
                log.write({"step": trainer.step, "validation": found})
                if found["denoised"] > trainer.best:
                    trainer.best = found["denoised"]
                    _save_weights(trainer, out / WEIGHTS)
            if time.monotonic() - saved > 60 * config.checkpoint_minutes:
                trainer.save(out / CHECKPOINT)
                saved = time.monotonic()
    trainer.save(out / CHECKPOINT)
    if validation is None or not (out / WEIGHTS).exists():
        _save_weights(trainer, out / WEIGHTS)
    if trainer.skipped:
        print(f"{out}: {trainer.skipped} steps skipped: loss or gradient was not finite; log.jsonl names their clips")


def _steps(
    trainer: Trainer, share: tuple[int, int], data: TrainingSet, stopping: list[int]
) -> Iterator[dict[str, float]]:
    """Take steps until the last one, or until a process is told to stop, and yield a log row for each. The next batch
    is read meanwhile."""
    config = trainer.config
    with ThreadPoolExecutor(1) as reader:
        waiting = reader.submit(data.batch, trainer.task.batch, config, trainer.step, share)
        while trainer.step < config.steps and not any_of(bool(stopping)):
            batch = waiting.result()
            waiting = reader.submit(data.batch, trainer.task.batch, config, trainer.step + 1, share)
            started = time.perf_counter()
            row = trainer.train_step(batch)
            if trainer.skipped_in_turn == MAX_SKIPPED_IN_TURN:
                raise InputError(
                    f"{config.out}: {MAX_SKIPPED_IN_TURN} steps in turn without a finite loss or gradient: the weights "
                    "are broken; begin another run with a lower --lr, from "
                    f"--init {Path(config.out) / WEIGHTS} if that is there"
                )
            yield row | {"seconds": time.perf_counter() - started}


@contextmanager
def _until_stopped() -> Iterator[list[int]]:
    """A list to which Ctrl-C and SIGTERM add, instead of ending the process in the middle of a step. In a thread, to
    which no signal comes, it stays empty."""
    stopping: list[int] = []
    if threading.current_thread() is not threading.main_thread():  # where Python takes no handlers
        yield stopping
        return
    numbers = signal.SIGINT, signal.SIGTERM
    previous = {n: signal.signal(n, lambda number, _: stopping.append(number)) for n in numbers}
    try:
        yield stopping
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)


def _save_weights(trainer: Trainer, path: Path) -> None:
    training = {**_compared(trainer.config), "reached_step": trainer.step}
    save(trainer.average, path, training=json.dumps(training), version=__version__)


def _compared(config: TrainConfig) -> dict:
    """The options that identify a run, as JSON holds them."""
    options = {key: value for key, value in asdict(config).items() if key not in NOT_COMPARED}
    return {key: [*value] if isinstance(value, tuple) else value for key, value in options.items()}


def _same_config(config: TrainConfig, path: Path) -> None:
    """Write the options of a new run; refuse to go on with other ones. Options that a run from before lacks were as
    they are now unless given."""
    options = _compared(config)
    if not path.exists():
        write_atomically(path, (json.dumps({"version": __version__, "options": options}, indent=1) + "\n").encode())
        return
    try:
        before = _compared(TrainConfig((), config.out)) | {"model": None} | read_json(path)["options"]
        changed = [key for key, now in options.items() if before[key] != now]
        if before["model"] is None:
            raise ValueError("no network")
    except (ValueError, KeyError, TypeError):  # ValueError: InputError too
        raise InputError(f"{path}: not the options of a run; use another --out") from None
    if changed:
        key = changed[0]
        raise InputError(f"{path.parent}: this run was started with {key} = {before[key]}, not {options[key]}; use "
                         "another --out")  # fmt: skip
