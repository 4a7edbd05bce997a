"""Ways to fuse the application of kernels on a CPU: what `rtdenoise.ops.native` was chosen from.

python bench/cpu_candidates.py     # 1280×720, 25 taps; needs `pip install numba` beside the package
"""

from __future__ import annotations

import os
import tempfile
import time

from harness import ROOT, check, cpu, measure, origin, write  # first: it settles how torch waits

# isort: split
import numba
import numpy as np
import torch

from rtdenoise import ops
from rtdenoise.run.memory import keep_freed

H, W, K = 720, 1280, 5


@numba.njit(parallel=True, fastmath=True)
def apply_numba(image, logits, out):
    """The loops of native/apply_kernel.c: taps inside, columns outside, one row a thread."""
    r = K // 2
    for y in numba.prange(H):
        for x in range(W):
            most, total = -np.inf, np.float32(0)
            red, green, blue = np.float32(0), np.float32(0), np.float32(0)
            rows, columns = range(max(0, r - y), min(K, H + r - y)), range(max(0, r - x), min(K, W + r - x))
            for dy in rows:
                for dx in columns:
                    most = max(most, logits[dy * K + dx, y, x])
            for dy in rows:
                for dx in columns:
                    w = np.exp(np.float32(logits[dy * K + dx, y, x] - most))
                    total += w
                    i, j = y + dy - r, x + dx - r
                    red, green, blue = red + w * image[0, i, j], green + w * image[1, i, j], blue + w * image[2, i, j]
            out[0, y, x], out[1, y, x], out[2, y, x] = red / total, green / total, blue / total
    return out


def main() -> None:
    keep_freed()
    os.environ["XDG_CACHE_HOME"] = tempfile.mkdtemp()  # first calls compile
    numba.set_num_threads(torch.get_num_threads())
    g = torch.Generator().manual_seed(0)
    image, logits = torch.rand(1, 3, H, W, generator=g), 2 * torch.randn(1, K * K, H, W, generator=g)
    out = torch.empty_like(image)
    with ops.use("plain"):
        reference = ops.apply_kernel(image.double(), logits.double()).numpy()
    compiled = torch.compile(ops.apply_kernel)
    arrays = image[0].numpy(), logits[0].numpy(), out[0].numpy()

    def use(choice: str):
        with ops.use(choice):
            return ops.apply_kernel(image, logits)

    methods = {
        "plain torch": lambda: use("plain"),
        "torch.compile": lambda: compiled(image, logits),
        "numba": lambda: torch.from_numpy(apply_numba(*arrays))[None],
        "C": lambda: use("fused"),
    }
    first, errors = {}, {}
    for name, method in methods.items():
        start = time.perf_counter()
        result = method()
        first[name] = round(time.perf_counter() - start, 1)
        errors[name] = check(name, result.numpy(), reference, "float32")
    source = torch.rand(logits.numel() + 2 * image.numel())[::2].contiguous()  # read and written: the bytes of the op
    target = torch.empty_like(source)
    timings = measure({"copy of as many bytes": lambda: target.copy_(source), **methods}, 15)
    floor = timings["copy of as many bytes"].median_ms
    times_copy = {name: round(t.median_ms / floor, 2) for name, t in timings.items()}
    print(
        *(f"{name:24} {t:6.2f} × copy, first call {first.get(name, 0)} s" for name, t in times_copy.items()), sep="\n"
    )
    write(
        ROOT / "bench" / "results" / "cpu_candidates.json",
        **origin({"torch": cpu()}), numba=numba.__version__, size=[W, H], kernel=K,
        timings=timings, times_copy=times_copy, first_call_s=first, errors=errors,
    )  # fmt: skip


if __name__ == "__main__":
    main()
