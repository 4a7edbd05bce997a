"""Training in several processes under `torchrun`: rank, shared gradients, shared decisions.

Every process holds the same weights and optimiser and works on its share of each batch. Gradients are averaged: n
processes take the step that one would take on the whole batch. Without `torchrun` there is one process, and nothing is
sent.
"""

from __future__ import annotations

import importlib
import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager

import torch
from torch import distributed
from torch.nn import Parameter


@contextmanager
def processes(device: str) -> Iterator[tuple[int, int]]:
    """(rank, number of processes) within: nccl between CUDA devices, gloo otherwise."""
    count = int(os.environ.get("WORLD_SIZE", 1))
    if count == 1:
        yield 0, 1
        return
    if device == "cuda":
        torch.cuda.set_device(int(os.environ["LOCAL_RANK"]))
    # PyTorch loads this module with its optimisers, and defaults of its functions keep the group there is at that time:
    # the group's threads would outlive it, and end the process by SIGABRT where one is still at work.
    importlib.import_module("torch.distributed.nn.functional")
    distributed.init_process_group("nccl" if device == "cuda" else "gloo")
    try:
        yield distributed.get_rank(), count
    finally:
        distributed.destroy_process_group()


def average_gradients(parameters: Iterable[Parameter]) -> None:
    """Replace every gradient by its mean over the processes: one message for all of them."""
    if not distributed.is_initialized():
        return
    gradients = [p.grad for p in parameters if p.grad is not None]
    flat = torch.cat([g.flatten() for g in gradients])
    distributed.all_reduce(flat)
    for gradient, mean in zip(gradients, flat.split([g.numel() for g in gradients]), strict=True):
        gradient.copy_(mean.view_as(gradient) / distributed.get_world_size())


def means(values: dict[str, float]) -> dict[str, float]:
    """The mean of each number over the processes: one message for all of them."""
    if not distributed.is_initialized():
        return values
    device = "cuda" if distributed.get_backend() == "nccl" else "cpu"
    tensor = torch.tensor(list(values.values()), dtype=torch.float64, device=device)
    distributed.all_reduce(tensor)
    return dict(zip(values, (tensor / distributed.get_world_size()).tolist(), strict=True))


def wait_for_all() -> None:
    """Wait for all processes: one that ends early could end another that still writes."""
    if distributed.is_initialized():
        distributed.barrier()


def any_of(flag: bool) -> bool:
    """Whether the flag is set in any process, so that all of them stop or none."""
    return means({"flag": float(flag)})["flag"] > 0
