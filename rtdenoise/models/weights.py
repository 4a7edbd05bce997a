"""Weights files: safetensors, with the model's configuration in their metadata. Never pickle, which can run code.

They are read as numpy arrays, without torch; `loading` and `glsl` make denoisers of them. A hybrid's file may leave
weights to models that ship, to one those of kernels, to one those of what writes pixels: `parts` in its metadata names
them. Weights may be whole numbers of eight bits; `NAME.unit` beside them says what 1 is worth for each output.
"""

from __future__ import annotations

import json
from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from importlib import resources
from pathlib import Path

import numpy as np
from safetensors import SafetensorError, safe_open

from ..errors import InputError, did_you_mean
from .combiner_config import CombinerConfig
from .presets import COMBINERS, PRESETS, STILLS, Config, from_stored

MAX_WEIGHT = 1e6  # trained weights stay below 100; far larger ones overflow in half precision or within a few layers
KERNELS, PIXELS = "kernels", "pixels"  # parts of a `hybrid`; `PIXELS` is the module of that name
UNIT = ".unit"  # ending of the name of what whole weights are worth
_SHIPPED = resources.files("rtdenoise") / "weights"


@dataclass(frozen=True)
class StoredModel:
    """The content of a weights file."""

    path: Path
    config: Config
    tensors: dict[str, np.ndarray]  # the state dict, float32, finite


def available() -> list[str]:
    """Names of the denoisers that ship."""
    return [name for name in _shipped() if name not in COMBINERS]


def available_combiners() -> list[str]:
    """Names of the combiners that ship (`models.combiner`)."""
    return [name for name in _shipped() if name in COMBINERS]


def _shipped() -> list[str]:
    names = [path.name for path in _SHIPPED.iterdir()] if _SHIPPED.is_dir() else []
    return sorted(name.removesuffix(".safetensors") for name in names if name.endswith(".safetensors"))


def find(model: str | Path, known: Collection[str] | None = None) -> Path:
    """The file of a model that ships, or else the file at this path. Raises InputError where there is neither, with the
    names that are `known`; None: those of denoisers."""
    name = str(model)
    path = Path(str(_SHIPPED / f"{name}.safetensors")) if name in _shipped() else Path(name)
    if not path.is_file() and name in PRESETS | STILLS | COMBINERS:
        raise InputError(f"no weights of {name!r} ship: train them (rtdenoise train --model {name}) and name their "
                         ".safetensors file")  # fmt: skip
    if not path.is_file():
        known = available() if known is None else known
        raise InputError(f"no model {name!r}{did_you_mean(name, known)}: expected one of {', '.join(known)} or the "
                         "path of a .safetensors file")  # fmt: skip
    return path


def bytes_of(path: Path) -> Path:
    """The file of the same network's weights in bytes (`in_bytes`), which may be missing."""
    return path.with_suffix(".int8")


def bytes_beside(files: Iterable[Path]) -> list[Path]:
    """The files of weights in bytes beside weights files, of those that have one."""
    return [path for path in map(bytes_of, files) if path.is_file()]


def files_of(path: Path) -> list[Path]:
    """The weights file, and those of other models whose weights it takes (`parts_of`)."""
    return [path, *parts_of(path).values()]


def parts_of(path: Path) -> dict[str, Path]:
    """The files of other models whose weights a file takes: `KERNELS` and `PIXELS` -> file. None of a file that cannot
    be read; `read_model` says why."""
    try:
        with _opened(path) as file:
            return _parts(path, file.metadata() or {})
    except InputError:
        return {}


def has_bytes(path: Path) -> bool:
    """Whether there are kernels in bytes for the weights file, beside it or beside the one that it takes them of."""
    kernels = parts_of(path).get(KERNELS)
    return bytes_of(path).is_file() or (kernels is not None and has_bytes(kernels))


def read_config(model: str | Path) -> Config:
    """The configuration of a model, from the head of its file alone. Raises InputError as `read_model`."""
    path = find(model)
    with _opened(path) as file:
        return _config(path, file.metadata() or {})


def read_model(model: str | Path, **overrides: object) -> StoredModel:
    """Read a model that ships, or the weights file at a path. `overrides` replace fields of its configuration.

    Raises InputError where there is no such file, its configuration is none of this version, an override is no field,
    or the tensors are not finite, do not fit the configuration, or are there twice.
    """
    path = find(model)
    with _opened(path) as file:
        config = _overridden(_config(path, file.metadata() or {}), str(model), overrides)
        parts = _parts(path, file.metadata() or {})
    own = _shapes(path)
    sources = [(path, own)]
    for part, other in parts.items():
        taken = {k: v for k, v in _shapes(other).items() if k.startswith(f"{PIXELS}.") == (part == PIXELS)}
        if twice := sorted(own.keys() & taken.keys()):
            raise InputError(f"{path}: holds {twice[0]}, which it takes of the model {other.stem}; leave either out")
        sources.append((other, taken))
    _expect(path, {key: shape for _, shapes in sources for key, shape in shapes.items()}, config, overrides)
    tensors = {key: tensor for source, keys in sources for key, tensor in _tensors(source, keys).items()}
    for name, tensor in tensors.items():
        if not (np.abs(tensor) <= MAX_WEIGHT).all():  # False for NaN too
            raise InputError(f"{path}: {name} holds values that are not finite or beyond ±{MAX_WEIGHT:g}; the file is "
                             "damaged: train or download it again")  # fmt: skip
    return StoredModel(path, config, tensors)


@contextmanager
def _opened(path: Path) -> Iterator[safe_open]:
    """The file, open. Raises InputError where it cannot be read, in the block, too."""
    try:
        with safe_open(path, framework="numpy") as file:
            yield file
    except (SafetensorError, OSError, TypeError) as error:  # numpy has no bfloat16: TypeError
        raise InputError(f"{path}: not a readable safetensors file ({error})") from None


def _shapes(path: Path) -> dict[str, tuple]:
    """Name -> shape of each tensor but units. Raises InputError for a unit of no tensor, or of another length."""
    with _opened(path) as file:
        shapes = {key: tuple(file.get_slice(key).get_shape()) for key in file.keys()}  # noqa: SIM118 (not a dict)
    for key in [key for key in shapes if key.endswith(UNIT)]:
        found, owner = shapes.pop(key), shapes.get(key.removesuffix(UNIT), "missing")
        if found != owner[:1]:
            raise InputError(f"{path}: {key} is {found}, expected one for each output; its tensor is {owner}")
    return shapes


def _tensors(path: Path, keys: Collection[str]) -> dict[str, np.ndarray]:
    with _opened(path) as file:
        return {key: _numbers(file, key) for key in keys}


def _numbers(file: safe_open, key: str) -> np.ndarray:
    tensor = file.get_tensor(key)
    if tensor.dtype != np.int8:
        return tensor.astype(np.float32)
    return tensor * file.get_tensor(key + UNIT).astype(np.float32).reshape(-1, *(tensor.ndim - 1) * [1])


def _parts(path: Path, metadata: Mapping[str, str]) -> dict[str, Path]:
    try:
        names = json.loads(metadata.get("parts", "{}"))
        if not (names.keys() <= {KERNELS, PIXELS} and set(names.values()) <= {*_shipped()}):
            raise ValueError(f"expected names of models that ship for {KERNELS} or {PIXELS}, got {names}")
    except (ValueError, TypeError, AttributeError, RecursionError) as error:
        raise InputError(f"{path}: the models whose weights it takes are none of this version: {error}") from None
    return {part: find(name) for part, name in names.items()}


def read_denoiser(model: str | Path, **overrides: object) -> StoredModel:
    """`read_model`, for the weights of a denoiser. Raises InputError for a combiner too."""
    stored = read_model(model, **overrides)
    if isinstance(stored.config, CombinerConfig):
        raise InputError(f"{model}: is a combiner, which corrects frames that a denoiser made; expected a denoiser")
    return stored


def _expect(path: Path, found: Mapping[str, tuple], config: Config, overrides: Collection[str]) -> None:
    """Raise InputError unless the tensors have the names and shapes of the configuration."""
    shapes = config.shapes
    if wrong := sorted(k for k in shapes.keys() | found.keys() if shapes.get(k) != found.get(k)):
        changed = f" with {', '.join(overrides)} as asked for" if overrides else ""
        raise InputError(
            f"{path}: weights do not fit the configuration{changed}: {wrong[0]} is "
            f"{found.get(wrong[0], 'missing')}, expected {shapes.get(wrong[0], 'none')}"
        )


def _overridden(config: Config, model: str, overrides: Mapping[str, object]) -> Config:
    known = asdict(config)
    if unknown := [name for name in overrides if name not in known]:
        raise InputError(f"{', '.join(unknown)}: not an override of model {model!r}; its configuration has "
                         f"{', '.join(known)}")  # fmt: skip
    try:
        return replace(config, **overrides)
    except (TypeError, ValueError) as error:
        raise InputError(f"{', '.join(overrides)}: not an override of model {model!r}: {error}") from None


def described(config: Config, **parts: str) -> dict[str, str]:
    """Metadata of the weights file of a model: its configuration, and models that ship whose weights it takes, as
    `_config` and `_parts` read them."""
    taken = {"parts": json.dumps(parts)} if parts else {}
    return {"architecture": config.architecture, "config": json.dumps(asdict(config))} | taken


def _config(path: Path, metadata: Mapping[str, str]) -> Config:
    if "config" not in metadata:
        raise InputError(
            f"{path}: no model configuration in its metadata; expected a file written by `rtdenoise train`"
        )
    try:
        values = json.loads(metadata["config"])
        if not isinstance(values, dict):
            raise ValueError(f"expected an object, got {type(values).__name__}")
        return from_stored(metadata.get("architecture", "temporal_kpn"), values)
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: its configuration is not one of this version: {error}") from None
