"""Kept frames of which a recorded step (`run.graphs`) knows the address only when it is replayed."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor


class NotHere(RuntimeError):
    """Something would read the values of a tensor that lies elsewhere."""


class Elsewhere(Tensor):
    """Stands for a contiguous tensor elsewhere: it has shape, dtype and `address`, and raises NotHere for all else."""

    address: Tensor  # [1] int64, on the device of the other tensor: where that lies when kernels run

    @staticmethod
    def __new__(cls, like: Tensor, address: Tensor) -> Elsewhere:
        self = torch.empty(like.shape, dtype=like.dtype, device="meta").as_subclass(cls)
        self.address = address
        return self

    @classmethod
    def __torch_function__(cls, function, types, args=(), kwargs=None):
        if function in (Tensor.shape.__get__, Tensor.dtype.__get__):
            return super().__torch_function__(function, types, args, kwargs)
        raise NotHere(f"{function} would read a tensor that lies elsewhere")


def table(count: int, device: torch.device) -> Tensor:
    """Room for addresses, one a row of 16 bytes, as Triton compiles a kernel for each way in which pointers are
    aligned."""
    return torch.zeros(count, 2, dtype=torch.int64, device=device)


def fill(addresses: Tensor, tensors: Sequence[Tensor]) -> None:
    """Write where contiguous tensors lie into a `table`. On CUDA nothing waits: pinned memory that is being copied is
    not given out again before the copy is done."""
    rows = [[tensor.data_ptr(), 0] for tensor in tensors]
    here = torch.tensor(rows, dtype=torch.int64, device="cpu", pin_memory=addresses.is_cuda)
    addresses.copy_(here, non_blocking=True)
