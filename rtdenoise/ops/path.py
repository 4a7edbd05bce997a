"""Which implementation of the ops runs: the plain one, which is the specification, or a fused one beside it.

One switch: the environment variable `RTDENOISE_OPS` when the program starts, `use` while it runs.

    auto    fused where there is one for these tensors and what it needs is there; plain elsewhere (the default)
    plain   always the specification
    fused   an error that says why, where an op that the device has fused would run plain; for tests and measurements
"""

from __future__ import annotations

import functools
import logging
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import ModuleType

import torch
from torch import Tensor

CHOICES = ("auto", "plain", "fused")
_choice = os.environ.get("RTDENOISE_OPS", "auto")


@contextmanager
def use(choice: str) -> Iterator[None]:
    """`with ops.use("plain"): ...` chooses 'auto', 'plain' or 'fused' for everything inside."""
    global _choice
    before, _choice = _choice, _checked(choice)
    try:
        yield
    finally:
        _choice = before


def fused(op: str, *tensors: Tensor) -> Callable[..., Tensor] | None:
    """The fused implementation of `op` for these arguments, or None where the plain one has to run: there may be none
    at all for a kind of device.

    Raises RuntimeError where 'fused' is forced and cannot be had.
    """
    if _checked(_choice) == "plain" or torch.compiler.is_compiling():
        return None
    module, reason = implementation(tensors[0].device.type)
    if module is not None and not hasattr(module, op):
        return None
    if module is not None:
        reason = module.unsupported(op, *tensors)
    if reason is None:
        return getattr(module, op)
    if _choice == "fused":
        raise RuntimeError(f"{op}: no fused path: {reason}")
    return None


@functools.cache
def implementation(device: str) -> tuple[ModuleType | None, str | None]:
    """The module with the fused ops of a kind of device, or None and why there is none. That is logged."""
    try:
        if device == "cpu":
            from . import native as module

            module.prepare()
        elif device == "cuda":
            from . import triton as module
        else:
            return None, f"there is none for {device}"
    except (ImportError, OSError, RuntimeError) as error:
        logging.getLogger("rtdenoise").warning("rtdenoise: slower without fused ops on %s: %s", device, error)
        return None, str(error)
    return module, None


def _checked(choice: str) -> str:
    if choice not in CHOICES:
        raise ValueError(f"RTDENOISE_OPS or ops.use: expected one of {', '.join(CHOICES)}, got {choice!r}")
    return choice
