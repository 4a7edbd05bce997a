"""Choose the implementation of an op: the plain one, which is the specification, or a fused one.

Fused ops lie in files of the op's name: C for the CPU in `native/`, Triton for CUDA in `triton/`. The op's own file
declares what they take, and asks once its arguments are checked:

    FUSED = Fused("warp", native=Support(max_channels=8, gradients=("image",)), triton=Support(max_channels=8))

    @falls_back
    def warp(image, motion):
        if run := FUSED(image=image, motion=motion):
            return run(image, motion)
        ...

One switch: the environment variable `RTDENOISE_OPS` when the program starts, `use` while it runs.

    auto    fused where the declaration admits the arguments, plain elsewhere (the default)
    plain   always the specification
    fused   as auto, but an error that gives the reason where an op with a fused implementation would run plain; for
            tests and measurements
"""

from __future__ import annotations

import functools
import logging
import math
import os
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from importlib import import_module
from subprocess import SubprocessError

import torch
from torch import Tensor
from torch.autograd.forward_ad import unpack_dual

from ..errors import InputError, NotCompiled, NotFused

CHOICES = ("auto", "plain", "fused")
MAX_PIXELS = 2**31 - 1  # of a plane: fused ops number pixels by 32-bit integers
ON_STACK = 1 << 16  # pixels of a row: some C ops have values of one on their stack
MAX_ROWS = {"triton": 65535}  # B·C·H at most: programs along the second axis of a CUDA grid
HALVES = (torch.bfloat16, torch.float16)

DEFAULT = os.environ.get("RTDENOISE_OPS", "auto")
_choice = DEFAULT
_blocks: dict[object, str] = {}  # the choices of the blocks of `use` that run, in the order in which they began
_changing = threading.Lock()


@contextmanager
def use(choice: str) -> Iterator[None]:
    """`with ops.use("plain"): ...` chooses 'auto', 'plain' or 'fused' for everything inside, and for other threads
    meanwhile: autograd's run backward passes. Of blocks that run at once the one that began last counts.

    Raises InputError for another choice.
    """
    global _choice
    block = object()
    with _changing:
        _blocks[block] = _choice = _checked(choice)
    try:
        yield
    finally:
        with _changing:
            del _blocks[block]
            _choice = [DEFAULT, *_blocks.values()][-1]


def plain() -> bool:
    """Whether the specification has to run: 'plain' is chosen, or torch.compile traces."""
    return _checked(_choice) == "plain" or torch.compiler.is_compiling()


def transformed(*tensors: Tensor) -> bool:
    """Whether torch.func runs (vmap, grad, jvp ...), or a tensor has derivatives in forward mode: only torch's
    own operations know what to do then."""
    return torch._C._are_functorch_transforms_active() or any(unpack_dual(x).tangent is not None for x in tensors)


@dataclass(frozen=True)
class Support:
    """The arguments that a fused implementation takes. All are float32 images of the first one's batch, height and
    width but for those in `halves`, `bytes` and `other`."""

    max_channels: int | None = None  # of the first argument; several images count together
    max_width: int | None = None
    max_kernel: int | None = None  # K of the argument `logits`
    halves: tuple[str, ...] = ()  # arguments that may be bfloat16 or float16 too
    bytes: tuple[str, ...] = ()  # arguments that are uint8
    other: tuple[str, ...] = ()  # arguments of other sizes, which the op checks itself
    channels_last: bool = False  # the first argument, as the op checks itself: a program has all channels of a row
    gradients: tuple[str, ...] = ()  # arguments in which it is differentiable
    # of arguments that the op does not check itself, each tensor's of a sequence; 0: as many as the first argument
    channels: Mapping[str, tuple[int, ...]] = field(default_factory=dict)


class Fused:
    """The fused implementations of one op, and the arguments that each takes."""

    def __init__(self, op: str, **support: Support):
        """`op` is the name of function and file, or 'file.function'; `support` is by folder."""
        self.file, _, name = op.rpartition(".")
        self.file, self.name, self.support = self.file or name, name, support

    def __call__(self, **arguments: Tensor | Sequence[Tensor] | None) -> Callable | None:
        """The implementation for these arguments, or None where the plain one has to run. Sequences are joined along
        channels; None is ignored.

        Raises NotFused where 'fused' is chosen and the device's implementation does not take the arguments.
        """
        if plain() or transformed():
            return None
        first = next(iter(arguments.values()))
        device = (first if isinstance(first, Tensor) else first[0]).device
        folder, problem = _available(device.type)
        if folder is not None:
            if folder not in self.support:
                return None
            problem = _problem(self.support[folder], MAX_ROWS.get(folder), arguments)
        if problem is None:
            run = _function(folder, self.file, self.name)
            return run if _is_current(device) else functools.partial(_on, device, run)
        if _choice == "fused":
            raise NotFused(f"{self.name}: no fused path: {problem}; RTDENOISE_OPS=auto runs the plain op there")
        return None


def _is_current(device: torch.device) -> bool:
    return device.type != "cuda" or device.index == torch.cuda.current_device()


def _on(device: torch.device, run: Callable, *arguments, **options):
    """Triton launches kernels on the current GPU, wherever the tensors are."""
    with torch.cuda.device(device):
        return run(*arguments, **options)


def falls_back(op: Callable) -> Callable:
    """Decorate an op: where its fused implementation does not compile after all, as on a disk that has filled up since
    the start, one warning is logged and the plain op runs from then on."""

    @functools.wraps(op)
    def run(*arguments, **options):
        try:
            return op(*arguments, **options)
        except NotCompiled as error:
            if _choice == "fused":
                raise
            _lost["cpu"] = str(error)
            _warn("cpu", error)
            return op(*arguments, **options)

    return run


_lost: dict[str, str] = {}  # device -> why its fused ops are used no more


def compiled(device: str) -> bool:
    """Whether fused ops of a kind of device are there."""
    return _available(device)[0] is not None


def _available(device: str) -> tuple[str | None, str | None]:
    return (None, _lost[device]) if device in _lost else backend(device)


@functools.cache
def backend(device: str) -> tuple[str | None, str | None]:
    """The folder with the fused ops of a kind of device, or None and the reason, which is logged."""
    try:
        if device == "cpu":
            from . import native

            native.prepare()
            return "native", None
        if device == "cuda":
            from .triton import first_use

            first_use.prepare()
            return "triton", None
    except (ImportError, OSError, RuntimeError, SubprocessError) as error:
        _warn(device, error)
        return None, str(error)
    return None, f"there is none for {device}"


def _warn(device: str, error: Exception) -> None:
    logging.getLogger("rtdenoise").warning("rtdenoise: slower without fused ops on %s: %s", device, error)


@functools.cache
def _function(folder: str, file: str, name: str) -> Callable:
    return getattr(import_module(f".{folder}.{file}", __package__), name)


def _problem(support: Support, max_rows: int | None, arguments: dict) -> str | None:
    """The first argument that `support` excludes, in words, or None."""
    differentiating = torch.is_grad_enabled()
    first = next(iter(arguments.values()))
    images = (first,) if isinstance(first, Tensor) else first
    shape, place = images[0].shape, images[0].get_device()
    for name, value in arguments.items():
        tensors = (value,) if isinstance(value, Tensor) else value or ()
        for tensor in tensors:
            dtype, taken = tensor.dtype, torch.uint8 if name in support.bytes else torch.float32
            if dtype is not taken and not (name in support.halves and dtype in HALVES):
                return f"{name} is {dtype}, it takes {taken}".replace("torch.", "")
            if differentiating and tensor.requires_grad and name not in support.gradients:
                return f"it has no gradient in {name}"
            if transformed(tensor):
                return "it has no derivatives in forward mode"
            if tensor.get_device() != place:
                return f"{name} is on {tensor.device}, it takes tensors of {images[0].device}"
            if (tensor.shape[0], *tensor.shape[2:]) != (shape[0], *shape[2:]) and name not in support.other:
                return f"{name} is {tuple(tensor.shape)}, it takes images like {tuple(shape)}"
        if tensors and name in support.channels:
            wanted = [count or shape[1] for count in support.channels[name]]
            if (found := [tensor.shape[1] for tensor in tensors]) != wanted:
                return f"{name} has {found} channels, it takes {wanted}"
    rows = math.prod(shape[:-1]) // (shape[1] if support.channels_last else 1) if max_rows else 0
    if images[0].numel() == 0 or shape[-2] * shape[-1] > MAX_PIXELS or (max_rows and rows > max_rows):
        return f"it takes no images of {tuple(shape)}"
    if support.max_width and shape[3] > support.max_width:
        return f"it takes rows of at most {support.max_width} pixels, not {shape[3]}"
    channels = sum(image.shape[1] for image in images) if support.max_channels else 0
    if support.max_channels and channels > support.max_channels:
        return f"it takes at most {support.max_channels} channels, not {channels}"
    if support.max_kernel and arguments["logits"].shape[-3] > support.max_kernel**2:
        return f"it takes kernels of at most {support.max_kernel}², not {arguments['logits'].shape[-3]} taps"
    return None


def _checked(choice: str) -> str:
    if choice not in CHOICES:
        raise InputError(f"RTDENOISE_OPS or ops.use: expected one of {', '.join(CHOICES)}, got {choice!r}")
    return choice
