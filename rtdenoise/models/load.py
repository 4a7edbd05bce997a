"""Weights on disk: safetensors with the configuration inside. Never pickle, which can run code."""

from __future__ import annotations

import json
from dataclasses import asdict, replace
from importlib import resources
from pathlib import Path

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save as serialise

from ..atomic import write_atomically
from ..errors import InputError
from ..nets import prepare, resolve
from .presets import ARCHITECTURES, Denoiser, architecture, create

_SHIPPED = resources.files("rtdenoise") / "weights"


def available() -> list[str]:
    """Names of the models whose weights are shipped."""
    names = [path.name for path in _SHIPPED.iterdir()] if _SHIPPED.is_dir() else []
    return sorted(name.removesuffix(".safetensors") for name in names if name.endswith(".safetensors"))


def load(
    model: str | Path = "paper", device: str | torch.device = "cpu", precision: str = "auto", **overrides
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
    path = find(model)
    try:
        with safe_open(path, framework="pt") as file:
            metadata = file.metadata() or {}
            tensors = {key: file.get_tensor(key).float() for key in file.keys()}  # noqa: SIM118 (not a dict)
    except (SafetensorError, OSError) as error:
        raise InputError(f"{path}: not a readable safetensors file ({error})") from None
    if "config" not in metadata:
        raise InputError(
            f"{path}: no model configuration in its metadata; expected a file written by `rtdenoise train`"
        )
    try:
        kind = ARCHITECTURES[metadata.get("architecture", "temporal_kpn")]
        stored = kind.Config(**json.loads(metadata["config"]))
    except (TypeError, ValueError, KeyError) as error:
        raise InputError(f"{path}: its configuration is not one of this version: {error}") from None
    try:
        config = replace(stored, **overrides)
    except (TypeError, ValueError) as error:
        known = ", ".join(asdict(stored))
        raise InputError(f"{', '.join(overrides)}: not an override of model {str(model)!r}: {error}; its configuration "
                         f"has {known}") from None  # fmt: skip
    denoiser = create(config)
    expected = {key: tuple(tensor.shape) for key, tensor in denoiser.state_dict().items()}
    found = {key: tuple(tensor.shape) for key, tensor in tensors.items()}
    if expected != found:
        key = sorted(k for k in expected.keys() | found.keys() if expected.get(k) != found.get(k))[0]
        changed = f" with {', '.join(overrides)} as asked for" if overrides else ""
        raise InputError(
            f"{path}: weights do not fit the configuration{changed}: {key} is {found.get(key, 'missing')}, "
            f"expected {expected.get(key, 'none')}"
        )
    denoiser.load_state_dict(tensors)
    return denoiser.eval().requires_grad_(False)


def find(model: str | Path) -> Path:
    """The file of a shipped name (which goes first) or of a path. Raises InputError where there is neither."""
    name = str(model)
    path = Path(str(_SHIPPED / f"{name}.safetensors")) if name in available() else Path(name)
    if not path.is_file():
        raise InputError(
            f"no model {name!r}: expected one of {', '.join(available())} or the path of a .safetensors file"
        )
    return path


def save(denoiser: Denoiser, path: str | Path, **metadata: str) -> None:
    """Write weights and configuration: never half a file. Raises InputError where they cannot be written."""
    tensors = {k: v.detach().cpu().contiguous() for k, v in denoiser.state_dict().items()}
    described = {"architecture": architecture(denoiser.config), "config": json.dumps(asdict(denoiser.config))}
    write_atomically(Path(path), serialise(tensors, metadata=described | metadata))
