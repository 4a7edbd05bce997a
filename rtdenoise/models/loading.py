"""Weights on disk -> denoiser, and back."""

from __future__ import annotations

import logging
from pathlib import Path

import torch
from safetensors.torch import save as serialise
from torch import nn

from ..errors import InputError
from ..files import in_order, write_atomically
from .accumulated_kpn import AccumulatedKPN
from .afgsa import GuidedAttention
from .bytes_layout import read as read_bytes
from .combiner import Combiner
from .denoiser import Denoiser
from .hybrid import Hybrid
from .in_bytes import PixelNetworkInBytes, UNetInBytes
from .inference import INT8, choose_device, prepare, resolve, takes_bytes
from .mltd import RecurrentTransformer
from .presets import SHRINKAGE, Config
from .shrinkage import Shrinkage
from .temporal_kpn import TemporalKPN
from .weights import PIXELS, StoredModel, available_combiners, described, find, has_bytes, read_denoiser, read_model

NETWORKS = {
    "temporal_kpn": TemporalKPN, "accumulated_kpn": AccumulatedKPN, "combiner": Combiner, "afgsa": GuidedAttention,
    "mltd": RecurrentTransformer, "hybrid": Hybrid,
}  # fmt: skip
"""`Config.architecture` -> the network."""


def create(config: Config) -> Denoiser | Combiner:
    """A network with random weights, in float32 whatever torch's default dtype is."""
    return NETWORKS[config.architecture](config).float()


def load(
    model: str | Path = "default", device: str | torch.device = "cpu", precision: str = "auto", **overrides
) -> Denoiser:
    """A denoiser with its weights, made ready to run (`inference.prepare`): a torch module whose
    `step(frame, history)` takes and returns tensors `[B, C, H, W]` on `device`.

    `model` is the name of a model that ships (`available()`) or the path of a .safetensors file that `rtdenoise train`
    wrote; without one it is `default`, kernels alone, where `rtdenoise.Denoiser` takes `hybrid`. `device` is torch's,
    or 'auto': CUDA where there is a GPU. `precision` is that of the network: 'fp32', 'bf16', 'int8', or 'auto'
    (`inference.resolve`, `takes_bytes`); the rest is float32. 'int8' is for an `AccumulatedKPN` or `Hybrid` on a CPU:
    its networks in bytes (`in_bytes`), and what is left of them in bfloat16 or float32. 'auto' leaves the pixels of a
    `Hybrid` for many samples out, and both those of a file with no bytes of them beside it; on CPUs the light of one
    that cleans albedo and normal stays in float32.
    `overrides` replace fields of the stored configuration that leave the weights' shapes alone, for example
    `motion="traditional"` for an ablation, or `footprint=True`: histories have `History.footprint` then.

    Raises InputError for an unknown model or precision, a device that is unknown or not there, a combiner, an
    unreadable file, an override that is no field, weights that are not finite or do not fit their configuration, and a
    model that has none in bytes.
    """
    (device, dtype), file = _placed(device, precision), read_denoiser(model, **overrides)
    with torch.device("cpu"):  # whatever torch's default device is
        network = _built(file)
        if isinstance(network, Hybrid):  # which need footprints themselves
            network.keeps_footprint = overrides.get("footprint", False)
        if precision == INT8 or (has_bytes(file.path) and takes_bytes(precision, device)):
            _into_bytes(network, file.path, must=precision == INT8)
    network = network.to(device)
    shows_rounding = isinstance(network, Hybrid) and network.config.many and network.config.clean
    return _prepared(network, dtype) if precision == "auto" and shows_rounding else prepare(network, dtype)


def _prepared(network: Hybrid, dtype: torch.dtype) -> Hybrid:
    """As `prepare`, but on CPUs the network that writes light stays in float32: where many samples leave little noise
    and albedo and normal are clean, the steps of bfloat16 are most of the error (docs/notes/many.md)."""
    if dtype == torch.float32 or next(network.parameters()).device.type != "cpu":
        return prepare(network, dtype)
    light, network.pixels = network.pixels, nn.Module()
    surfaces, light.surfaces = light.surfaces, nn.ModuleDict()
    prepare(network, dtype)
    network.pixels = prepare(light, torch.float32)
    light.surfaces = prepare(surfaces, dtype)
    return network


def _placed(device: str | torch.device, precision: str) -> tuple[str | torch.device, torch.dtype]:
    """A device that is there, and the dtype of the network on it. Raises InputError where there is none."""
    if device == "auto":
        device = choose_device(device)
    try:
        kind = torch.device(device).type
    except (RuntimeError, TypeError):
        raise InputError(f"unknown device {device!r}; expected 'auto', 'cpu', 'cuda' or another of torch's") from None
    if kind == "cpu" or precision != INT8:  # which `resolve` refuses on others, there or not
        _expect_there(device, kind)
    return device, resolve(precision, device)


def _expect_there(device: str | torch.device, kind: str) -> None:
    if kind == "cuda":
        choose_device(kind)
    try:
        torch.empty(0, device=device)
    except (RuntimeError, AssertionError):
        raise InputError(f"device {device}: PyTorch finds none here; take 'auto'") from None


def _into_bytes(network: Denoiser, path: Path, must: bool) -> None:
    """Put networks in bytes in the place of a denoiser's own. Where what they need is not there or not usable, raise
    InputError if they `must`, and else leave it."""
    try:
        stored = read_bytes(path, network.config)
    except InputError as error:
        if must:
            raise
        logging.getLogger("rtdenoise").warning("rtdenoise: slower, as not in bytes: %s", error)
        return
    network.unet = UNetInBytes(network.unet, stored, network.config)
    has_pixels = f"{PIXELS}.encoder.0" in stored
    if has_pixels and (must or not network.config.many):  # steps of light show where noise is little
        network.pixels = PixelNetworkInBytes(network.pixels, stored, network.config)


def precision_of(network: Denoiser) -> str:
    """The one of `inference.PRECISIONS` that most of a network computes in."""
    if any(isinstance(module, UNetInBytes | PixelNetworkInBytes) for module in network.modules()):
        return INT8
    return "bf16" if any(weights.dtype == torch.bfloat16 for weights in network.parameters()) else "fp32"


def load_combiner(
    model: str | Path = SHRINKAGE, device: str | torch.device = "cpu", precision: str = "auto", **overrides
) -> Combiner | Shrinkage:
    """A combiner, ready to run: 'shrinkage', which has no weights, or a network; arguments and errors as those of
    `load`."""
    device, dtype = _placed(device, precision)
    if model == SHRINKAGE:
        return Shrinkage()
    find(model, (SHRINKAGE, *available_combiners()))
    network = read(model, **overrides)
    if precision == INT8:
        raise InputError(f"precision int8: {model} has no weights in bytes; take auto")
    if not isinstance(network, Combiner):
        raise InputError(f"{model}: is a denoiser; expected a combiner, which corrects frames that a denoiser made")
    return prepare(network.to(device), dtype)


def read(model: str | Path, **overrides) -> Denoiser | Combiner:
    """A network with its weights as they were trained: float32, nothing fused. Arguments as those of `load`.

    Raises InputError for an unknown name, an unreadable file, an override that is no field, and weights that are not
    finite or do not fit their configuration.
    """
    return _built(read_model(model, **overrides))


def _built(file: StoredModel) -> Denoiser | Combiner:
    denoiser = create(file.config)
    denoiser.load_state_dict({key: torch.from_numpy(tensor) for key, tensor in file.tensors.items()})
    return denoiser.eval().requires_grad_(False)


def save(denoiser: Denoiser | Combiner, path: str | Path, **metadata: str) -> None:
    """Write weights and configuration, whole or not at all. Raises InputError where they cannot be written, and for a
    network that `load` made ready in bfloat16 or bytes: its weights are rounded, or gone."""
    tensors = {k: v.detach().cpu().contiguous() for k, v in denoiser.state_dict().items()}
    if tensors.keys() != denoiser.config.shapes.keys() or any(v.dtype == torch.bfloat16 for v in tensors.values()):
        raise InputError(f"{path}: expected a network with all of its weights, in float32; take it from models.read, "
                         "or from models.load with precision='fp32'")  # fmt: skip
    write_atomically(Path(path), in_order(serialise(tensors, metadata=described(denoiser.config) | metadata)))
