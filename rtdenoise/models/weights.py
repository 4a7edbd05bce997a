"""Weights files: safetensors, with the model's configuration in their metadata. Never pickle, which can run code.

They are read as numpy arrays, without torch; `models.load` and `glsl` make denoisers of them."""

from __future__ import annotations

import json
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from importlib import resources
from pathlib import Path

import numpy as np
from safetensors import SafetensorError, safe_open

from ..errors import InputError, did_you_mean

_SHIPPED = resources.files("rtdenoise") / "weights"


@dataclass(frozen=True)
class StoredModel:
    """What a weights file holds."""

    path: Path
    architecture: str  # the name of its module in `rtdenoise.models`
    config: dict  # of its `Config`
    tensors: dict[str, np.ndarray]  # its state dict, float32

    def expect(self, shapes: Mapping[str, tuple[int, ...]], overrides: Collection[str] = ()) -> None:
        """Raise InputError where the tensors have not exactly these names and shapes. `overrides` are the fields of the
        configuration that were asked for instead of the stored ones."""
        found = {key: tensor.shape for key, tensor in self.tensors.items()}
        if wrong := sorted(k for k in shapes.keys() | found.keys() if shapes.get(k) != found.get(k)):
            changed = f" with {', '.join(overrides)} as asked for" if overrides else ""
            raise InputError(
                f"{self.path}: weights do not fit the configuration{changed}: {wrong[0]} is "
                f"{found.get(wrong[0], 'missing')}, expected {shapes.get(wrong[0], 'none')}"
            )


def available() -> list[str]:
    """Names of the models whose weights are shipped."""
    names = [path.name for path in _SHIPPED.iterdir()] if _SHIPPED.is_dir() else []
    return sorted(name.removesuffix(".safetensors") for name in names if name.endswith(".safetensors"))


def find(model: str | Path) -> Path:
    """The file of a shipped name (which goes first) or of a path. Raises InputError where there is neither."""
    name = str(model)
    path = Path(str(_SHIPPED / f"{name}.safetensors")) if name in available() else Path(name)
    if not path.is_file():
        raise InputError(
            f"no model {name!r}{did_you_mean(name, available())}: expected one of {', '.join(available())} or the path "
            "of a .safetensors file"
        )
    return path


def read_model(model: str | Path) -> StoredModel:
    """The file of a shipped name or of a path. Raises InputError where there is none, or it holds no model."""
    path = find(model)
    try:
        with safe_open(path, framework="numpy") as file:
            metadata = file.metadata() or {}
            tensors = {key: file.get_tensor(key).astype(np.float32) for key in file.keys()}  # noqa: SIM118 (not a dict)
    except (SafetensorError, OSError, TypeError) as error:  # numpy has no bfloat16: TypeError
        raise InputError(f"{path}: not a readable safetensors file ({error})") from None
    if "config" not in metadata:
        raise InputError(
            f"{path}: no model configuration in its metadata; expected a file written by `rtdenoise train`"
        )
    try:
        config = json.loads(metadata["config"])
    except ValueError as error:
        raise InputError(f"{path}: its configuration is not one of this version: {error}") from None
    return StoredModel(path, metadata.get("architecture", "temporal_kpn"), config, tensors)
