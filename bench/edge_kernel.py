"""What edge and pick kernels and cubic lookup cost: a step of each model at 720p with and without them.

    python bench/edge_kernel.py

CPU time of one thread, which other processes do not lengthen; the variants in turn. Weights do not matter to the time:
they are random. Writes bench/results/edge_kernel.json.
"""

from __future__ import annotations

import time
from dataclasses import replace
from functools import partial

import harness
import torch

from rtdenoise import ops
from rtdenoise.frame import Frame
from rtdenoise.models import PRESETS, create
from rtdenoise.models.inference import prepare

H, W, CALLS = 720, 1280, 12


@torch.inference_mode()
def main() -> None:
    torch.set_num_threads(1)
    torch.manual_seed(0)
    light, albedo, normal = torch.rand(3, 1, 3, H, W)
    motion, motion_next = torch.rand(2, 1, 2, H, W)
    frame = Frame(light, albedo=albedo, normal=normal, depth=1 + albedo[:, :1], motion=motion, motion_next=motion_next)
    methods = {f"warp, cubic {cubic}": partial(ops.warp, light, motion, cubic=cubic) for cubic in (False, True)}
    for name in ("fast", "default", "quality"):
        for edge, pick in ((1, 1), (3, 1), (3, 3)):
            config = replace(PRESETS[name], edge_kernel=edge, pick_kernel=pick)
            model = prepare(create(config).eval().requires_grad_(False), torch.bfloat16)
            _, history = model.step(frame)
            methods[f"{name}, edge kernel {edge}, pick kernel {pick}"] = partial(model.step, frame, history)
    timings = harness.measure(methods, CALLS, clock=time.process_time)
    for name, timing in timings.items():
        print(f"{name}: {timing.median_ms} ± {timing.iqr_ms} ms")
    result = harness.ROOT / "bench" / "results" / "edge_kernel.json"
    harness.write(result, **harness.origin({"torch": harness.cpu()}), size=[W, H], cpu_time=timings)


if __name__ == "__main__":
    main()
