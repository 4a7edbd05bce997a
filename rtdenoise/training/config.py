"""The options of a training run, as the command line shows and a run directory records them; the network they name."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from tyro.conf import UseAppendAction

from ..models.presets import COMBINERS, PRESETS, STILLS, Config, with_settings


@dataclass(frozen=True)
class TrainConfig:
    """Options of a run. A resumed run must have the same, except for paths, device and the times of checkpoints."""

    data: tuple[Path, ...]
    """Folders of training clips, written by `rtdenoise clips`."""
    out: Path
    """Run directory; a run in it is resumed."""
    stills: tuple[Path, ...] = ()
    """Folders of single frames, `rtdenoise clips --assets DIR --frames 1`: every second step takes these, `batch` times
    `frames` of them. With --data alone every step takes clips."""
    least_spp: int = 1
    """Clips and stills of fewer samples a pixel are left out."""
    most_spp: int | None = None
    """Clips and stills of more samples a pixel are left out."""
    val: Path | None = None
    """Folder of validation clips, of other scenes than the training ones."""
    init: Path | None = None
    """Weights to start from instead of random ones: a .safetensors file of the same network or a narrower one."""
    model: str = "default"
    """Network to train: 'paper', 'fast', 'default', 'hybrid', 'hybrid-fast', 'hybrid-large'; for single frames 'afgsa',
    'afgsa-small'; for Metropolis renders 'mltd', 'mltd-small'; or 'combiner', 'combiner-causal', 'drc'."""
    set: UseAppendAction[tuple[str, ...]] = ()
    """Fields of the network's configuration to change, as NAME=VALUE: widths=32,48,64,80,96 or longest=24."""
    signal: str = "indirect"
    """The signal to denoise: 'indirect', 'color', or 'both' (color in a third of the clips, validated on indirect
    light; of combiners all that `rtdenoise estimates` stored, validated on color)."""
    motion: str = "dual"
    """Motion vectors that fetch history: 'dual', or 'traditional' for setting A of the paper."""
    occlusion_loss: bool = True
    """Add L_occ in the second half of the run (setting C of the paper); off: setting B."""
    steps: int = 4000
    """Optimiser steps of the whole run."""
    batch: int = 4
    """Clips a step, of all processes together."""
    estimates: tuple[str, ...] = ("oidn", "default")
    """For combiners: methods whose frames to correct; `rtdenoise estimates` stores these beside the clips."""
    cuts: float = 0.0
    """Share of steps in which history is dropped at one frame, as at a cut."""
    relight: float = 0.0
    """Share of clips in which a patch of light or shadow that no feature shows moves or begins."""
    shade: float = 0.0
    """Share of single frames that a pattern of shadow falls on: stripes, a grid or spots that no feature shows."""
    loss_exposure: float = 1.0
    """The loss is taken on log(1 + loss_exposure · s · x), s the exposure of the reference."""
    huber: float = 0.0
    """The loss is quadratic up to this error and absolute beyond; 0: L1, as in the paper."""
    loss_power: float = 1.0
    """The loss of each clip is taken to this power: at 0.5 clips of many samples, whose errors are small, weigh nearly
    as much as those of few."""
    frames: int = 9
    """Consecutive frames a clip, through all of which the loss is back-propagated."""
    lead_in: int = 0
    """At most so many of the frames before these are denoised first, without a loss: the clip begins with their
    history. `rtdenoise clips --lead-in` renders clips that have many."""
    size: int = 128
    """Side of the random crop in pixels."""
    optimiser: str = "adam"
    """'adam', or 'muon' for the weights of convolutions, which learn faster with it at the same rates."""
    lr: float = 1e-3
    """Peak learning rate: linear warm-up, then a cosine to zero."""
    warmup: int = 200
    """Steps of the warm-up."""
    seed: int = 0
    """Seed of initial weights, order of clips, crops and augmentation."""
    device: str = "cpu"
    """'cpu' or 'cuda'."""
    amp: bool = True
    """Run the convolutions in bfloat16."""
    validate_every: int = 500
    """Steps between validations."""
    tensorboard: bool = False
    """Also write the log as TensorBoard events, into the run's folder tensorboard."""
    checkpoint_minutes: float = 3.0
    """Minutes between checkpoints; Ctrl-C and SIGTERM write one, too."""


def model_config(config: TrainConfig) -> Config:
    """The configuration of the network that a run trains. Raises InputError for unknown fields in `set`."""
    if config.model not in PRESETS:
        return with_settings((COMBINERS | STILLS)[config.model], config.set)
    return with_settings(replace(PRESETS[config.model], motion=config.motion), config.set)
