"""What the plan saves: each omission on frames that qualify for it and on frames that do not.

    python bench/plan.py [--quick]        (320×360; --quick: 320×180)

The scenes are made from the bundled sample, twice as high by repetition: `still` does not move, `pan` moves as a whole,
`objects` is the sample's own motion, `night` has light in its lower rows only. For each, one step of the model with
everything and one with the plan, in CPU time, in turn; the outputs are compared first, to the bit or within float32's
tolerance, and a difference ends the run. Layers: the time to read a multi-part file, one part a layer, with and without
the layers that a single frame does not need. Also measured: what a convolution's share of constant channels could save
at most, and how many pixels have a coarse scale with no weight at all: why those two are not left out.
"""

from __future__ import annotations

import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import harness
import numpy as np
import OpenEXR
import torch
from torch import Tensor, nn

from rtdenoise.data.sequences import open_sequence
from rtdenoise.frame import Frame
from rtdenoise.models import available, load
from rtdenoise.plan import make_plan
from rtdenoise.planned import Planned

RESULT = harness.ROOT / "bench" / "results" / "plan.json"
SAMPLE = harness.ROOT / "samples" / "mural"
CALLS = 5


@torch.inference_mode()
def main(quick: bool) -> None:
    frames = [_repeat(frame, 1 if quick else 2) for _, frame in zip(range(3), open_sequence(SAMPLE), strict=False)]
    scenes = {"still": _moved(frames, 0.0), "pan": _moved(frames, 3.25), "objects": frames, "night": _night(frames)}
    models = {
        name: {scene: measure(load(name, precision="fp32"), shot) for scene, shot in scenes.items()}
        for name in available()
    }
    document = {
        **harness.origin({"torch": harness.cpu()}),
        "size": frames[0].size,
        "models": models,
        "layers": read_layers(frames[0]),
        "not_left_out": {name: not_left_out(load(name, precision="fp32"), frames) for name in available()},
    }
    harness.write(RESULT, **document)
    harness.insert_all(tables(document))


def measure(denoiser: nn.Module, frames: list[Frame]) -> dict[str, object]:
    """One step with history: everything against the plan."""
    _, history = denoiser.step(frames[1], denoiser.step(frames[0])[1])
    planned = Planned(denoiser, make_plan(frames[0].size, len(frames), denoiser.config.motion, frames))
    everything, less = denoiser.step(frames[2], history)[0], planned.step(frames[2], history)[0]
    left_out = [what for what, count in planned.left_out.items() if count]
    exact = torch.equal(everything, less)
    error = harness.check("plan", less.numpy(), everything.numpy(), "exact" if exact else "float32 tiles")
    timings = harness.measure(
        {"everything": lambda: denoiser.step(frames[2], history), "plan": lambda: planned.step(frames[2], history)},
        calls=CALLS, warmup=1, clock=time.process_time,
    )  # fmt: skip
    return {"left_out": left_out, "exact": exact, "greatest_error": error, **timings,
            "ratio": round(timings["plan"].median_ms / timings["everything"].median_ms, 3)}  # fmt: skip


def read_layers(frame: Frame) -> dict[str, object]:
    """A single frame in a multi-part file: all default layers, and without the motion that it does not need."""
    parts = [
        OpenEXR.Part({"compression": OpenEXR.ZIP_COMPRESSION}, channels, name)
        for name, channels in {
            "color": {c: _plane(frame.radiance, i) for i, c in enumerate("RGB")},
            "albedo": {f"albedo.{c}": _plane(frame.albedo, i) for i, c in enumerate("RGB")},
            "normal": {f"normal.{c}": _plane(frame.normal, i) for i, c in enumerate("XYZ")},
            "depth": {"depth.Z": _plane(frame.depth, 0)},
            "motion": {f"motion.{c}": _plane(frame.motion, i) for i, c in enumerate("XY")},
            "motion_next": {f"motion_next.{c}": _plane(frame.motion_next, i) for i, c in enumerate("XY")},
        }.items()
    ]
    with tempfile.TemporaryDirectory() as folder:
        OpenEXR.File(parts).write(str(Path(folder) / "frame.0000.exr"))
        sequence = open_sequence(folder, preset="native")
        less = sequence.only(make_plan(sequence.size, 1, "dual", [sequence[0]]).layers)
        for layer, tensor in less[0].layers():
            harness.check(layer, tensor.numpy(), getattr(sequence[0], layer).numpy(), "exact")
        timings = harness.measure(
            {"everything": lambda: sequence[0], "plan": lambda: less[0]}, calls=15, clock=time.process_time
        )
    return {**timings, "ratio": round(timings["plan"].median_ms / timings["everything"].median_ms, 3)}


def not_left_out(denoiser: nn.Module, frames: list[Frame]) -> dict[str, float]:
    """Share of the network's multiplications that one constant input channel causes, and the least weight of a coarse
    scale anywhere."""
    counts: list[int] = []
    alphas: list[float] = []
    hooks = [module.register_forward_hook(lambda m, i, o: counts.append(o[0].numel() * m.weight[0].numel()))
             for module in denoiser.modules() if isinstance(module, nn.Conv2d)]  # fmt: skip
    predict = denoiser.predict

    def watched(features: Tensor):
        heads = predict(features)
        alphas.append(min(alpha.min().item() for alpha in heads.alpha))
        return heads

    denoiser.predict = watched
    denoiser.step(frames[0])
    for hook in hooks:
        hook.remove()
    inputs = next(m for m in denoiser.modules() if isinstance(m, nn.Conv2d)).in_channels
    return {"multiplications_of_one_channel": counts[0] / inputs / sum(counts), "least_alpha": min(alphas)}


def tables(document: dict) -> dict[str, str]:
    """What docs/stability.md has of this, by section."""
    models = "\n\n".join(f"Model `{name}`:\n\n{table(document, name)}" for name in document["models"])
    reasons = document["not_left_out"].values()
    channel, alpha = (max(r["multiplications_of_one_channel"] for r in reasons), min(r["least_alpha"] for r in reasons))
    why = (
        f"One constant input channel is {channel:.1%} of the network's multiplications; the least α of a "
        f"coarse scale on the sample is {alpha:.1g}."
    )
    return {"plan": models, "not left out": why}


def table(document: dict, model: str) -> str:
    """The savings as Markdown."""
    lines = ["| scene | left out | output | CPU time, plan / everything |", "|---|---|---|---|"]
    for scene, row in document["models"][model].items():
        output = "same to the bit" if row["exact"] else f"within {row['greatest_error']:.1g}"
        lines.append(f"| {scene} | {', '.join(row['left_out']) or 'nothing'} | {output} | {row['ratio']:.2f} |")
    layers = document["layers"]["ratio"]
    lines.append(
        f"| one frame, multi-part file | reading motion, motion_next | same to the bit | {layers:.2f} (reading) |"
    )
    return "\n".join(lines)


def _plane(tensor: Tensor, channel: int) -> np.ndarray:
    return np.ascontiguousarray(tensor[0, channel].numpy())


def _repeat(frame: Frame, times: int) -> Frame:
    return frame.map(lambda tensor: tensor.repeat(1, 1, times, 1))


def _moved(frames: list[Frame], speed: float) -> list[Frame]:
    """Everything moves alike."""
    return [replace(f, motion=torch.full_like(f.motion, -speed), motion_next=torch.full_like(f.motion, speed))
            for f in frames]  # fmt: skip


def _night(frames: list[Frame]) -> list[Frame]:
    """Black but for the lower quarter."""
    H = frames[0].size[0]
    dark = torch.arange(H).reshape(1, 1, H, 1) < H * 3 // 4
    return [replace(f, radiance=torch.where(dark, 0.0, f.radiance)) for f in frames]


if __name__ == "__main__":
    main("--quick" in sys.argv)
