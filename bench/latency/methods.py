"""The methods that `latency_720p.py` times, each checked against its reference before it is returned."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise

import numpy as np
import torch

from rtdenoise import models, ops
from rtdenoise.baselines.oidn import OidnFilter, filter_inputs
from rtdenoise.frame import Frame, History, Known
from rtdenoise.models.inference import INT8, prepare, resolve
from rtdenoise.models.past import coming, turning
from rtdenoise.models.settled import settled as finished
from rtdenoise.models.weights import find, has_bytes
from rtdenoise.run.graphs import Capture, Graphed
from rtdenoise.run.lookahead import SETTLES_FROM

from ..harness import check
from .shaders import PRECISIONS, Shaders
from .stages import prediction_flop

BACKENDS = {  # name -> choice of ops, precision of the network, row of tolerances.py for its comparison with `eager`
    "eager": ("plain", None, "exact"),  # as trained: plain ops, planes, nothing fused
    "fused fp32": ("fused", "fp32", "float32 network"),
    "fused bf16": ("fused", "bf16", "bfloat16 network"),
    "fused int8": ("fused", INT8, "int8 network"),  # on a CPU, of models that have weights in bytes
}
SCALED = ("fused bf16", "fused int8")  # backends that are timed at all sizes, and as a CUDA graph where there is CUDA
GRAPH = ", graph"
OIDN_QUALITIES = ("high", "balanced", "fast")
OIDN_MISSING = "not measured: pip install 'rtdenoise[bench]' brings OIDN"


@dataclass
class Method:
    """One row of the table."""

    name: str
    step: Callable[[], object]  # one frame with history, on the device; returns when it is done
    model: torch.nn.Module | None = None
    ops: str = "auto"
    shaders: Shaders | None = None


def torch_methods(preset: str, frame: Frame, device: str, backends: tuple[str, ...]) -> list[Method]:
    """The model on each of the backends, compared with the eager one on a small frame: in a large noisy one some pixel
    always lies so near a threshold of reprojection that rounding decides its side."""
    methods, expected, small = [], None, synthetic_frame(36, 64).to(device)
    for backend, (path, precision, tolerance) in BACKENDS.items():
        if backend not in ("eager", *backends) or (precision == INT8 and not (device == "cpu" and in_bytes(preset))):
            continue
        if precision == INT8:
            model = models.load(preset, precision=precision)
            tolerance = "int8 networks in turn" if getattr(model.config, "clean", False) else tolerance
        else:
            model = fresh(preset).to(device)
            model = model if precision is None else prepare(model, resolve(precision, device))
        with ops.use(path):
            image = model.step(small, settled(model, small))[0]
        expected = image.double().cpu().numpy() if expected is None else expected
        check(f"{preset} {backend}", image.cpu().numpy(), expected, tolerance)
        if backend not in backends:
            continue
        with ops.use(path):
            history = settled(model, frame)
        method = Method(f"{preset} {backend}", partial(model.step, frame, history), model, path)
        methods.append(method)
        if backend in SCALED and device == "cuda":
            with ops.use(path):
                whole = method.step()[0]
            methods += recorded(method, whole.double().cpu().numpy(), tolerance)
    return methods


def recorded(method: Method, expected: np.ndarray, tolerance: str) -> list[Method]:
    """The method's step as a CUDA graph, compared with what the step gives; its stages cannot be timed. Nothing where
    it cannot be recorded, which is logged."""
    graph = Graphed(method.model, Capture(next(method.model.parameters()).device))
    again = Method(f"{method.name}{GRAPH}", partial(graph.step, *method.step.args), ops=method.ops)
    with ops.use(method.ops):
        for _ in range(2):  # the second call records
            image = again.step()[0]
    check(again.name, image.cpu().numpy(), expected, tolerance)
    return [again] if graph.recordings else []


def shader_methods(preset: str, frame: Frame) -> list[Method]:
    """The model as compute shaders, compared on a small frame, too."""
    methods, small = [], synthetic_frame(36, 64)
    history = settled(fresh(preset), small)
    expected = fresh(preset).step(small, history)[0].double().numpy()
    for name, (half, tolerance) in PRECISIONS.items():
        check(f"{preset} {name}", Shaders(fresh(preset), small, half).image(), expected, tolerance)
        pipeline = Shaders(fresh(preset), frame, half)
        methods.append(Method(f"{preset} {name}", pipeline.step, shaders=pipeline))
    return methods


def oidn_methods(frame: Frame, qualities: tuple[str, ...]) -> list[Method]:
    """OIDN on the frame's device: its filter alone, set up once, without the conversion of planes to pixels."""
    methods = []
    for quality in qualities:
        oidn = OidnFilter(filter_inputs(frame), quality)
        oidn.execute()
        if not oidn.result.isfinite().all():
            sys.exit(f"oidn {quality} is wrong: its output is not finite. No times are reported.")
        methods.append(Method(f"oidn {quality}", oidn.execute))
    return methods


def settled(model: torch.nn.Module, frame: Frame) -> History:
    """A history with as many recent frames as it can have."""
    _, history = model.step(frame)
    return replace(history, recent=tuple(kept.clone() for kept in history.recent * model.config.recent))


def stepping(model: torch.nn.Module, frame: Frame, history: History, ahead: int = 0) -> Callable[[], object]:
    """A step of `denoise --lookahead`, the last of whose frames has just come: a run compares each pair of them, and
    packs the first one, once (`rtdenoise.run.once`), and settles the picture before where it looks far enough ahead."""
    settles = ahead >= SETTLES_FROM
    waiting = (ahead - settles) * (frame,)

    def found(first: Frame, second: Frame) -> tuple[torch.Tensor, torch.Tensor]:
        turn = turning(first, second)
        return turn, coming(model.config, first, turn)

    known = [found(*pair) for pair in pairwise(waiting[:-1])]

    def step() -> object:
        new = [found(*waiting[-2:])] if len(waiting) > 1 else []
        turns, packed = zip(*known, *new, strict=True) if new else ((), ())
        model.keeps_trust = settles
        told = Known(ahead=waiting, turning=turns, coming=packed, waits=ahead > 0)
        image, after = model.step(frame, history, told)
        return finished(after, after) if settles else image

    return step


def partly_in_bytes(name: str, precision: str) -> torch.nn.Module:
    """A model whose networks compute in bytes, and what is left of it in another precision than on this CPU."""
    model = models.load(name, precision=precision)
    for part, network in models.load(name, precision="int8").named_children():
        if part in ("unet", "pixels"):
            setattr(model, part, network)
    return model


def in_bytes(preset: str) -> bool:
    """Whether a model ships with weights in bytes."""
    return preset in models.available() and has_bytes(find(preset))


def fresh(preset: str) -> torch.nn.Module:
    """The model as it is trained, with shipped weights where there are some."""
    if preset in models.available():
        return models.read(preset)
    torch.manual_seed(0)
    return models.create(models.PRESETS[preset]).eval().requires_grad_(False)


def network_flop(preset: str, frame: Frame) -> int:
    """Floating-point operations of one step's network: counted on a small frame, proportional to the pixels."""
    small = frame.crop(0, 0, *(min(n, 32) for n in frame.size)).map(torch.Tensor.cpu)
    model = fresh(preset)
    count = prediction_flop(lambda: model.step(small))
    return round(count * math.prod(frame.size) / math.prod(small.size))


def synthetic_frame(H: int, W: int) -> Frame:
    """Noise under smooth motion of some pixels: the time depends on the motion, not on the picture."""
    g = torch.Generator().manual_seed(0)
    y, x = torch.meshgrid(torch.arange(H) / H, torch.arange(W) / W, indexing="ij")
    motion = 6 * torch.stack([torch.sin(6 * y + 2 * x), torch.cos(5 * x)])[None]
    colour, normal = torch.rand(1, 3, H, W, generator=g), torch.rand(1, 3, H, W, generator=g) * 2 - 1
    noisy = torch.empty(1, 3, H, W).exponential_(generator=g)
    return Frame(noisy, colour, normal, 1 + (x + y)[None, None], motion, -motion)
