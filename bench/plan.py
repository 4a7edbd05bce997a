"""Savings of the plan: each omission on frames that qualify for it and on frames that do not.

python bench/plan.py

The scenes are made from the bundled sequence: for torch repeated to twice its height (320×360), for the shaders a
quarter of it (160×90). One is a single picture; `still` does not move, `pan` moves as a whole, `objects` keeps its own
motion, each also without motion_next. In `night` and `sky`, twice as high again, the upper three quarters are black or
evenly lit. Each scene is timed with everything and with the plan, in CPU time, in rotation. Their outputs are compared
first, to the bit or within float32's tolerance; a difference ends the run.

Layers: time to read a multi-part file, one part per layer, with and without the layers that a network without history
does not need. Direct light without noise: the beauty denoised as a whole, against its indirect part alone. Two
omissions that the plan does not make: folding constant input channels (the most it could save), and coarse scales
without weight (their number).
"""

from __future__ import annotations

import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))  # this checkout, whatever rtdenoise is installed
from bench import DOCS, RESULTS, harness

# isort: split
import numpy as np
import OpenEXR
import torch
from torch import Tensor, nn

from rtdenoise.color import display_exposure
from rtdenoise.data.opening import open_sequence
from rtdenoise.frame import Frame
from rtdenoise.glsl import default_context
from rtdenoise.metrics import psnr
from rtdenoise.models import available, load
from rtdenoise.run.backends import open_backend
from rtdenoise.run.plan import make_plan

RESULT, PAGES = RESULTS / "plan.json", (DOCS / "results" / "stability.md",)
CALLS = {"torch": 5, "glsl": 5}
TORCH_ONLY = ("night", "sky")  # scenes for an omission that the shaders lack
SPEED = 3.25  # pixels per frame of `pan`


@torch.inference_mode()
def main() -> None:
    sample = harness.mural("color")[:3]
    shots = {
        "torch": scenes([_twice(frame) for frame in sample]),
        "glsl": scenes([frame.crop(0, 0, 90, 160) for frame in sample]),
    }
    models = {
        name: {
            scene: {b: measure(b, name, shots[b][scene]) for b in shots if b == "torch" or scene not in TORCH_ONLY}
            for scene in shots["torch"]
        }
        for name in available()
    }
    content = {
        "sizes": {backend: made["objects"][0].size for backend, made in shots.items()},
        "models": models,
        "layers": read_layers(shots["torch"]["objects"][0]),
        "direct": direct_light(),
        "not_left_out": {name: not_left_out(load(name, precision="fp32"), sample) for name in available()},
    }
    devices = {"torch": harness.cpu(), "glsl": default_context().info["GL_RENDERER"]}
    harness.publish(RESULT, content, devices=devices, pages=PAGES, tables=tables)


def scenes(frames: list[Frame]) -> dict[str, list[Frame]]:
    """Name -> frames; the last one is measured."""
    moving = {"still": _moved(frames, 0.0), "pan": _moved(frames, SPEED), "objects": frames}
    without = {f"{name}, no motion_next": [replace(f, motion_next=None) for f in shot] for name, shot in moving.items()}
    high = [_twice(frame) for frame in frames]
    return {"single picture": frames[:1], **moving, **without, "night": _upper(high, 0.0), "sky": _upper(high, 1.0)}


def measure(backend: str, model: str, frames: list[Frame]) -> dict[str, object]:
    """One step of the last frame, with the history of those before: everything against the plan."""
    everything, planned = (open_backend(backend, model, "cpu" if backend == "torch" else "auto", "fp32") for _ in "ab")
    left_out: dict[str, int] = {}
    arrays = [frame.map(lambda tensor: np.ascontiguousarray(tensor)) for frame in frames]
    planned.plan(frames[0].size, len(frames), arrays, left_out)
    *before, last = map(everything.prepare, arrays)
    history = None
    for frame in before:
        history = planned.step(frame, history)[1]
    left_out.update(dict.fromkeys(left_out, 0))
    expected, found = everything.step(last, history)[0], planned.step(last, history)[0]
    exact = np.array_equal(expected, found)
    error = harness.check("plan", found, expected, "exact" if exact else "float32 tiles")
    named = [omission for omission, count in left_out.items() if count]
    timings = harness.measure(
        {"everything": lambda: everything.step(last, history), "plan": lambda: planned.step(last, history)},
        calls=CALLS[backend], warmup=1, clock=time.process_time,
    )  # fmt: skip
    return {"left_out": named, "exact": exact, "greatest_error": error, **timings,
            "ratio": round(timings["plan"].median_ms / timings["everything"].median_ms, 3)}  # fmt: skip


def direct_light() -> dict[str, float]:
    """PSNR of the beauty where direct light has no noise: `whole`, denoised as one picture, and `indirect`, with its
    indirect light denoised and the rest passed through."""
    step = load("paper", precision="fp32").step
    beauty, indirect = (harness.mural(signal, layers=("reference",)) for signal in ("color", "indirect"))
    direct = [(b.reference - i.reference).clamp(min=0) for b, i in zip(beauty, indirect, strict=True)]
    whole = [replace(b, radiance=d + i.radiance) for b, d, i in zip(beauty, direct, indirect, strict=True)]
    images = {
        "whole": harness.denoise(step, whole),
        "indirect": [d + image for d, image in zip(direct, harness.denoise(step, indirect), strict=True)],
    }
    references = [frame.reference for frame in beauty]
    errors = {name: [psnr(image, reference, display_exposure(reference))
                     for image, reference in zip(found, references, strict=True)]
              for name, found in images.items()}  # fmt: skip
    return {name: round(float(np.mean(values)), 2) for name, values in errors.items()}


def read_layers(frame: Frame) -> dict[str, object]:
    """Time to read a single frame of a multi-part file: with all default layers, and without motion."""
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
        less = sequence.only(make_plan(sequence.size, 1, None, [sequence[0]]).layers)
        for layer, tensor in less[0].layers():
            harness.check(layer, tensor.numpy(), getattr(sequence[0], layer).numpy(), "exact")
        timings = harness.measure(
            {"everything": lambda: sequence[0], "plan": lambda: less[0]}, calls=15, clock=time.process_time
        )
    return {**timings, "ratio": round(timings["plan"].median_ms / timings["everything"].median_ms, 3)}


def not_left_out(denoiser: nn.Module, frames: list[Frame]) -> dict[str, float]:
    """Share of the network's multiplications that one constant input channel causes; the least weight of a coarse scale
    anywhere, and the number of those weights that are zero."""
    counts: list[int] = []
    alphas: list[Tensor] = []
    hooks = [module.register_forward_hook(lambda m, i, o: counts.append(o[0].numel() * m.weight[0].numel()))
             for module in denoiser.modules() if isinstance(module, nn.Conv2d)]  # fmt: skip
    predict = denoiser.predict

    def watched(features: Tensor):
        heads = predict(features)
        alphas.extend(alpha.flatten() for alpha in heads.alpha)
        return heads

    denoiser.predict = watched
    denoiser.step(frames[0])
    for hook in hooks:
        hook.remove()
    alphas.clear()
    harness.denoise(denoiser.step, frames)
    inputs = next(m for m in denoiser.modules() if isinstance(m, nn.Conv2d)).in_channels
    weights = torch.cat(alphas)
    return {"multiplications_of_one_channel": counts[0] / inputs / sum(counts), "least_alpha": weights.min().item(),
            "alphas": weights.numel(), "zero_alphas": int((weights == 0).sum())}  # fmt: skip


def tables(document: dict) -> dict[str, str]:
    """Sections `plan` and `not left out`."""
    ships = {name: rows for name, rows in document["models"].items() if name in available()}
    models = "\n\n".join(f"Model `{name}`:\n\n{table(rows)}" for name, rows in ships.items())
    layers, direct = document["layers"]["ratio"], document["direct"]
    models += (
        f"\n\nReading one frame of a multi-part file without motion and motion_next takes {layers:.2f} of the time. "
        f"The sample with direct light that has no noise: {direct['indirect']} dB with its indirect light denoised and "
        f"the rest passed through, {direct['whole']} dB with the beauty denoised as a whole (`paper`)."
    )
    reasons = [document["not_left_out"][name] for name in ships]
    channel, alpha = (max(r["multiplications_of_one_channel"] for r in reasons), min(r["least_alpha"] for r in reasons))
    zeros, count = (sum(r[key] for r in reasons) for key in ("zero_alphas", "alphas"))
    why = (
        f"One constant input channel is {channel:.1%} of the network's multiplications at most; of {count} weights of "
        f"coarse scales on the sample {zeros} are zero, the least is {alpha:.1g}."
    )
    return {"plan": models, "not left out": why}


def table(rows: dict) -> str:
    """The savings of one model as Markdown."""
    lines = [
        "| scene | left out | output | torch, plan / everything | shaders, plan / everything |",
        "|---|---|---|---|---|",
    ]
    for scene, backends in rows.items():
        left_out = dict.fromkeys(omission for row in backends.values() for omission in row["left_out"])
        error = max(row["greatest_error"] for row in backends.values())
        output = "same to the bit" if all(row["exact"] for row in backends.values()) else f"within {error:.1g}"
        ratios = [f"{backends[b]['ratio']:.2f}" if b in backends else "–" for b in CALLS]
        lines.append(f"| {scene} | {', '.join(left_out) or 'nothing'} | {output} | {' | '.join(ratios)} |")
    return "\n".join(lines)


def _plane(tensor: Tensor, channel: int) -> np.ndarray:
    return np.ascontiguousarray(tensor[0, channel].numpy())


def _twice(frame: Frame) -> Frame:
    """The frame, and below it once more."""
    return frame.map(lambda tensor: tensor.repeat(1, 1, 2, 1))


def _moved(frames: list[Frame], speed: float) -> list[Frame]:
    """Everything moves alike."""
    return [replace(f, motion=torch.full_like(f.motion, -speed), motion_next=torch.full_like(f.motion, speed))
            for f in frames]  # fmt: skip


def _upper(frames: list[Frame], light: float) -> list[Frame]:
    """The upper three quarters evenly lit."""
    H = frames[0].size[0]
    above = torch.arange(H).reshape(1, 1, H, 1) < H * 3 // 4
    return [replace(f, radiance=torch.where(above, light, f.radiance)) for f in frames]


if __name__ == "__main__":
    harness.run(main, __doc__)
