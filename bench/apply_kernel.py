"""Per-pixel kernels: the torch twin against the compute shader.

python bench/apply_kernel.py            # 1280×720
python bench/apply_kernel.py --quick    # 320×180, some seconds
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from harness import ROOT, check, cpu, measure, origin, write  # first: it settles how torch waits

# isort: split
import numpy as np
import torch
import tyro

from rtdenoise import glsl, ops
from rtdenoise.glsl import GpuArray


@dataclass(frozen=True)
class Options:
    width: int = 1280
    height: int = 720
    kernel: int = 5
    channels: int = 3
    calls: int = 30
    quick: bool = False
    """320×180 and 10 calls."""
    out: Path | None = None
    """JSON file; by default bench/results/apply_kernel-<width>x<height>.json."""


def main(o: Options) -> None:
    W, H, calls = (320, 180, 10) if o.quick else (o.width, o.height, o.calls)
    random = np.random.default_rng(0)
    image = random.random((1, o.channels, H, W), np.float32)
    logits = 2 * random.standard_normal((1, o.kernel**2, H, W), np.float32)
    half = logits.astype(np.float16)

    ctx = glsl.default_context()
    image_torch, logits_torch = torch.from_numpy(image), torch.from_numpy(logits)
    image_gl, logits_gl, half_gl = (GpuArray.upload(ctx, a, a.dtype) for a in (image, logits, half))
    out = GpuArray.empty(ctx, image.shape)

    def shader(weights: GpuArray) -> np.ndarray:
        glsl.apply_kernel(image_gl, weights, out=out)
        ctx.finish()
        return out

    methods = {
        "torch": lambda: ops.apply_kernel(image_torch, logits_torch),
        "glsl": lambda: shader(logits_gl),
        "glsl, float16 logits": lambda: shader(half_gl),
        "glsl, to and from main memory": lambda: glsl.apply_kernel(image, logits),
    }

    reference = ops.apply_kernel(image_torch.double(), logits_torch.double()).numpy()
    reference_half = ops.apply_kernel(image_torch.double(), torch.from_numpy(half).double()).numpy()
    errors = {
        name: check(name, _numpy(method()), reference_half if "float16" in name else reference, "float32")
        for name, method in methods.items()
    }
    timings = measure(methods, calls)
    ratios = {name: round(timings["torch"].median_ms / t.median_ms, 2) for name, t in timings.items()}

    print(f"{o.kernel}×{o.kernel} kernels, {o.channels} channels, {W}×{H}")
    for name, t in timings.items():
        print(
            f"{name:30} {t.median_ms:8.1f} ms ± {t.iqr_ms:.1f}   {ratios[name]:5.2f} × torch   error {errors[name]:.1e}"
        )
    write(
        o.out or ROOT / "bench" / "results" / f"apply_kernel-{W}x{H}.json",
        **origin({"torch": cpu(), "glsl": ctx.info["GL_RENDERER"]}),
        size=[W, H], kernel=o.kernel, channels=o.channels, timings=timings, speed_against_torch=ratios, errors=errors,
    )  # fmt: skip


def _numpy(result: torch.Tensor | GpuArray | np.ndarray) -> np.ndarray:
    return result.read() if isinstance(result, GpuArray) else np.asarray(result)


if __name__ == "__main__":
    main(tyro.cli(Options, description=__doc__))
