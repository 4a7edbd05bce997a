"""Weights on disk -> denoiser, and back."""

from __future__ import annotations

import json
from dataclasses import asdict, replace
from pathlib import Path

import torch
from safetensors.torch import save as serialise

from ..errors import InputError
from ..files import write_atomically
from .create import ARCHITECTURES, Denoiser, architecture, create
from .inference import prepare, resolve
from .weights import available, find, read_model

__all__ = ["available", "find", "load", "read", "save"]


def load(
    model: str | Path = "default", device: str | torch.device = "cpu", precision: str = "auto", **overrides
) -> Denoiser:
    """A denoiser with its weights, made ready to run (`nets.prepare`).

    `model` is a shipped name (`available()`) or the path of a .safetensors file that `rtdenoise train` wrote.
    `precision` is that of the network, 'fp32', 'bf16' or 'auto' (`nets.resolve`); all else is float32 anyway.
    `overrides` replace fields of the stored configuration that do not change the network, e.g. `motion="traditional"`
    for ablations.

    Raises InputError for an unknown precision, and as `read`.
    """
    dtype = resolve(precision, device)
    return prepare(read(model, **overrides), dtype).to(device)


def read(model: str | Path, **overrides) -> Denoiser:
    """A denoiser with its weights as it was trained: float32, nothing fused. Arguments as those of `load`.

    Raises InputError for an unknown name, an unreadable file, an override that is none, and weights that do not fit
    their configuration.
    """
    file = read_model(model)
    try:
        stored = ARCHITECTURES[file.architecture].Config(**file.config)
    except (TypeError, ValueError, KeyError) as error:
        raise InputError(f"{file.path}: its configuration is not one of this version: {error}") from None
    try:
        config = replace(stored, **overrides)
    except (TypeError, ValueError) as error:
        known = ", ".join(asdict(stored))
        raise InputError(f"{', '.join(overrides)}: not an override of model {str(model)!r}: {error}; its configuration "
                         f"has {known}") from None  # fmt: skip
    denoiser = create(config)
    file.expect({key: tuple(tensor.shape) for key, tensor in denoiser.state_dict().items()}, overrides)
    denoiser.load_state_dict({key: torch.from_numpy(tensor) for key, tensor in file.tensors.items()})
    return denoiser.eval().requires_grad_(False)


def save(denoiser: Denoiser, path: str | Path, **metadata: str) -> None:
    """Write weights and configuration: never half a file. Raises InputError where they cannot be written."""
    tensors = {k: v.detach().cpu().contiguous() for k, v in denoiser.state_dict().items()}
    described = {"architecture": architecture(denoiser.config), "config": json.dumps(asdict(denoiser.config))}
    write_atomically(Path(path), serialise(tensors, metadata=described | metadata))
