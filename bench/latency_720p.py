"""How long a frame takes: stages x backends x presets x sizes, with OIDN in the same run.

python bench/latency_720p.py                          # 1280×720, on CUDA where it is, and how `default` scales
python bench/latency_720p.py --sizes 720p 4k          # everything at both sizes
python bench/latency_720p.py --quick                  # 64×36, some seconds
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from harness import ROOT, check, cpu, measure, origin, summary, write  # first: it settles how torch waits

# isort: split
import numpy as np
import torch
import tyro
from oidn import oidn_filter
from stages import STAGES, peak_bytes, prediction_flop, staged

from rtdenoise import models, ops
from rtdenoise.frame import Frame
from rtdenoise.models.inference import prepare
from rtdenoise.run.graphs import Capture, Graphed
from rtdenoise.run.memory import keep_freed
from shaders import PRECISIONS, Shaders, measurable

SIZES = {"quick": (64, 36), "360p": (640, 360), "720p": (1280, 720), "1080p": (1920, 1080), "1440p": (2560, 1440),
         "4k": (3840, 2160)}  # fmt: skip
BACKENDS = {  # which ops, the network's dtype, row of tolerances.py against `eager`
    "eager": ("plain", None, "exact"),  # as it is trained: plain ops, planes, nothing fused
    "fused fp32": ("fused", torch.float32, "float32 network"),
    "fused bf16": ("fused", torch.bfloat16, "bfloat16 network"),
}
SCALED = ("fused bf16",)  # of these backends it is asked how they scale
GRAPH = ", graph"  # of these too, on CUDA: the same step as a CUDA graph
QUALITIES = ("high", "balanced", "fast")
TOTAL = "total"


@dataclass(frozen=True)
class Options:
    sizes: tuple[str, ...] = ("720p",)
    """Some of 360p, 720p, 1080p, 1440p, 4k."""
    scaling: tuple[str, ...] = ("360p", "1080p", "1440p", "4k")
    """More sizes, at which `default` is timed in half precision only, against OIDN high."""
    presets: tuple[str, ...] = ()
    """Some of the models (default: all). Weights do not matter to the time; where none are shipped they are random."""
    calls: int = 10
    """Timed calls of each method at 720p; fewer at larger sizes, 3 at least."""
    threads: int = 0
    """Of the CPU; 0: as many as torch takes."""
    device: str = "auto"
    """'auto', 'cpu' or 'cuda'."""
    quick: bool = False
    """64×36, 3 calls."""
    out: Path = ROOT / "bench" / "results" / "latency_720p.json"
    """JSON file; the table and the plot go beside it, .md and .png."""


@dataclass
class Method:
    """One line of the table."""

    name: str
    step: Callable[[], object]  # one frame with history, on the device; returns when it is done
    model: torch.nn.Module | None = None
    ops: str = "auto"
    shaders: Shaders | None = None


def main(o: Options) -> None:
    if o.threads:
        torch.set_num_threads(o.threads)
    keep_freed()
    device = o.device if o.device != "auto" else "cuda" if torch.cuda.is_available() else "cpu"
    sizes, calls = (("quick",), 3) if o.quick else (o.sizes, o.calls)
    presets = o.presets or tuple(models.PRESETS)
    with_shaders, gl = measurable(o.quick)
    with torch.inference_mode():
        peak = {"copy_gb_per_s": copy_rate(device), **{f"{n}_gflop_per_s": product_rate(device, d) for n, d in
                (("fp32", torch.float32), ("bf16", torch.bfloat16))}}  # fmt: skip
        rows = [row for size in sizes for row in run(size, presets, device, calls, with_shaders)]
        for size in () if o.quick else (size for size in o.scaling if size not in sizes):
            rows += run(size, ("default",), device, calls, False, SCALED, ("high",))
    devices = {"torch": cpu() if device == "cpu" else torch.cuda.get_device_name(), "cpu": cpu(), "glsl": gl}
    devices["cuda"] = torch.cuda.get_device_name() if torch.cuda.is_available() else "not measured: there is none"
    document = {**origin(devices), "device": device, "measured_peaks": peak, "rows": rows}
    write(o.out, **document)
    tables = [*(table(document, size) for size in sizes), scaling(rows)]
    o.out.with_suffix(".md").write_text("\n\n".join(filter(None, tables)) + "\n")
    plot(document, o.out.with_suffix(".png"))
    print(o.out.with_suffix(".md").read_text())


def run(
    size: str,
    presets: tuple[str, ...],
    device: str,
    calls: int,
    with_shaders: bool,
    backends: tuple[str, ...] = tuple(BACKENDS),
    qualities: tuple[str, ...] = QUALITIES,
) -> list[dict]:
    """Every method at one size, in turn: the rows of the result."""
    W, H = SIZES[size]
    calls = max(3, round(calls * min(1, 1280 * 720 / (W * H))))
    frame = synthetic_frame(H, W).to(device)
    methods = [method for preset in presets for method in ours(preset, frame, device, backends)]
    if with_shaders:
        methods += [method for preset in presets for method in shaders(preset, frame)]
    methods += [oidn(frame, quality) for quality in qualities]

    def timed(method: Method) -> None:
        with ops.use(method.ops):
            method.step()
            synchronise(device)

    totals = measure({m.name: partial(timed, m) for m in methods}, calls, warmup=1)
    ledgers: dict[str, list] = {m.name: [] for m in methods if m.model}
    for _ in range(max(3, calls // 2)):
        for m in (m for m in methods if m.model):
            with ops.use(m.ops), staged(m.model, partial(synchronise, device)) as ledger:
                m.step()
            ledgers[m.name].append(ledger)

    rows = []
    for m in methods:
        row = {"size": size, "pixels": [W, H], "method": m.name, TOTAL: totals[m.name]}
        if m.model:
            runs = ledgers[m.name]
            row["stages"] = {stage: summary([r.seconds[stage] for r in runs]) for stage in STAGES}
            row["gb"] = {stage: runs[-1].bytes[stage] / 1e9 for stage in STAGES}
            row["prediction_gflop"] = flops(m.name.split()[0], frame) / 1e9
        if m.shaders:
            runs = [m.shaders.stages() for _ in range(max(3, calls // 2))]
            row["stages"] = {stage: summary([seconds[stage] for seconds in runs]) for stage in STAGES}
            row["peak_mb"] = round(m.shaders.megabytes, 1)
            rows.append(row)
            continue
        with ops.use(m.ops):
            row["peak_mb"] = round(peak_bytes(m.step, device) / 1e6, 1) if m.model else None
        rows.append(row)
    return rows


def ours(preset: str, frame: Frame, device: str, backends: tuple[str, ...]) -> list[Method]:
    """The preset on each of the backends, checked against the eager one first."""
    methods, reference = [], None
    for backend, (path, dtype, tolerance) in BACKENDS.items():
        if backend not in ("eager", *backends):
            continue
        model = fresh(preset).to(device)
        if dtype is not None:
            model = prepare(model, dtype)
        with ops.use(path):
            _, history = model.step(frame)
            image = model.step(frame, history)[0]
        reference = image.double().cpu().numpy() if reference is None else reference
        check(f"{preset} {backend}", image.cpu().numpy(), reference, tolerance)
        method = Method(f"{preset} {backend}", partial(model.step, frame, history), model, path)
        if backend in backends:
            methods.append(method)
        if backend in SCALED and device == "cuda":
            methods += recorded(method, reference, tolerance)
    return methods


def recorded(method: Method, reference: np.ndarray, tolerance: str) -> list[Method]:
    """A method's step as a CUDA graph, in which there are no stages to be timed; nothing where it cannot be recorded,
    which is logged."""
    graph = Graphed(method.model, Capture(next(method.model.parameters()).device))
    again = Method(f"{method.name}{GRAPH}", partial(graph.step, *method.step.args), ops=method.ops)
    with ops.use(method.ops):
        for _ in range(2):  # it is recorded the second time
            image = again.step()[0]
    check(again.name, image.cpu().numpy(), reference, tolerance)
    return [again] if graph.recordings else []


def shaders(preset: str, frame: Frame) -> list[Method]:
    """The preset as compute shaders, checked on a small frame: on a large one of noise some pixel always lies so near a
    threshold of reprojection that rounding decides on which side."""
    methods, small = [], synthetic_frame(36, 64)
    _, history = fresh(preset).step(small)
    expected = fresh(preset).step(small, history)[0].double().numpy()
    for name, (half, tolerance) in PRECISIONS.items():
        check(f"{preset} {name}", Shaders(fresh(preset), small, half).image(), expected, tolerance)
        pipeline = Shaders(fresh(preset), frame, half)
        methods.append(Method(f"{preset} {name}", pipeline.step, shaders=pipeline))
    return methods


def fresh(preset: str) -> torch.nn.Module:
    """A model as it is trained: shipped weights where there are some."""
    if preset in models.available():
        return models.read(preset)
    torch.manual_seed(0)
    return models.create(models.PRESETS[preset]).eval().requires_grad_(False)


def oidn(frame: Frame, quality: str) -> Method:
    """OIDN on the same device: its filter alone, set up once, without what it costs to turn planes into pixels."""
    execute = oidn_filter(frame, quality)
    if not execute().isfinite().all():
        sys.exit(f"oidn {quality} is wrong: its output is not finite. No times are reported.")
    return Method(f"oidn {quality}", execute)


def flops(preset: str, frame: Frame) -> int:
    """Of one step's network, counted on a small frame; it is proportional to the pixels."""
    small = frame.crop(0, 0, *(min(n, 32) for n in frame.size)).map(torch.Tensor.cpu)
    model = fresh(preset)
    count = prediction_flop(model, lambda: model.step(small))
    return round(count * math.prod(frame.size) / math.prod(small.size))


def synthetic_frame(H: int, W: int) -> Frame:
    """Noise under smooth motion of some pixels: what a frame holds does not matter to the time, where it looks does."""
    g = torch.Generator().manual_seed(0)
    y, x = torch.meshgrid(torch.arange(H) / H, torch.arange(W) / W, indexing="ij")
    motion = 6 * torch.stack([torch.sin(6 * y + 2 * x), torch.cos(5 * x)])[None]
    colour, normal = torch.rand(1, 3, H, W, generator=g), torch.rand(1, 3, H, W, generator=g) * 2 - 1
    noisy = torch.empty(1, 3, H, W).exponential_(generator=g)
    return Frame(noisy, colour, normal, 1 + (x + y)[None, None], motion, -motion)


def synchronise(device: str) -> None:
    if device == "cuda":
        torch.cuda.synchronize()


def copy_rate(device: str) -> float:
    """GB/s read and written by a copy far larger than the caches of a core."""
    source = torch.rand(32, 720, 1280, device=device)
    target = torch.empty_like(source)

    def copy() -> None:
        target.copy_(source)
        synchronise(device)

    return round(2 * source.numel() * 4 / measure({"copy": copy}, 10)["copy"].median_ms / 1e6, 1)


def product_rate(device: str, dtype: torch.dtype) -> float:
    """GFLOP/s of a matrix product."""
    n = 1024 if device == "cpu" else 8192
    a, b = (torch.rand(n, n, device=device, dtype=dtype) for _ in range(2))

    def product() -> None:
        torch.mm(a, b)
        synchronise(device)

    return round(2 * n**3 / measure({"product": product}, 10)["product"].median_ms / 1e6, 1)


def table(document: dict, size: str) -> str:
    """One size as Markdown. On a shared CPU only the ratios mean anything."""
    rows = [row for row in document["rows"] if row["size"] == size]
    base = min(_median(row[TOTAL]) for row in rows if row["method"] == "oidn high")
    peaks = document["measured_peaks"]
    W, H = rows[0]["pixels"]
    lines = [
        f"| {W}×{H}, {document['device']}, ms | {' | '.join(STAGES)} | total | against OIDN high | kernels, of copy | "
        "network, of product | peak MB |",
        "|---|" + "---|" * (len(STAGES) + 5),
    ]
    for row in rows:
        total = _median(row[TOTAL])
        cells = ["–"] * len(STAGES) + [
            f"{total:.1f} ± {_iqr(row[TOTAL]):.1f}",
            f"{base / total:.2f}× as fast",
            "–",
            "–",
            "–",
        ]
        if "stages" in row:
            times = {stage: _median(row["stages"][stage]) for stage in STAGES}
            cells[: len(STAGES)] = [f"{t:.1f}" for t in times.values()]
            cells[-1] = f"{row['peak_mb']:.0f}"
        if "gb" in row:
            network, kernels = list(STAGES)[:2]
            product = peaks["bf16_gflop_per_s" if "bf16" in row["method"] else "fp32_gflop_per_s"]
            cells[-3] = f"{100 * row['gb'][kernels] / times[kernels] * 1000 / peaks['copy_gb_per_s']:.0f} %"
            cells[-2] = f"{100 * row['prediction_gflop'] / times[network] * 1000 / product:.0f} %"
        lines.append(f"| {row['method']} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def scaling(rows: list[dict]) -> str:
    """What a megapixel costs at each size, of the methods that were timed at several; in time and, of ours, memory."""
    found: dict[str, dict[str, str]] = {}
    for row in sorted(rows, key=lambda row: math.prod(row["pixels"])):
        megapixels = math.prod(row["pixels"]) / 1e6
        memory = f", {row['peak_mb'] / megapixels:.0f} MB" if row.get("peak_mb") else ""
        found.setdefault(row["method"], {})[row["size"]] = f"{_median(row[TOTAL]) / megapixels:.1f} ms{memory}"
    found = {method: cells for method, cells in found.items() if len(cells) > 1}
    sizes = list(dict.fromkeys(size for cells in found.values() for size in cells))
    lines = [f"| a megapixel | {' | '.join(sizes)} |", "|---|" + "---|" * len(sizes)]
    lines += [f"| {method} | {' | '.join(cells.get(size, '–') for size in sizes)} |" for method, cells in found.items()]
    return "\n".join(lines) if found else ""


def plot(document: dict, path: Path) -> None:
    """Milliseconds a megapixel over the size of the picture: flat is what scales."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8, 5), layout="constrained")
    axes = figure.add_subplot(
        xlabel="megapixels", ylabel="ms a megapixel", yscale="log", title=document["devices"]["torch"]
    )
    for name in dict.fromkeys(row["method"] for row in document["rows"]):
        points = [(math.prod(r["pixels"]) / 1e6, _median(r[TOTAL])) for r in document["rows"] if r["method"] == name]
        style = {"linestyle": "--"} if name.startswith("oidn") else {}
        axes.plot([m for m, _ in points], [ms / m for m, ms in points], marker="o", label=name, **style)
    axes.legend(fontsize="small")
    figure.savefig(path, dpi=110)


def _median(timing) -> float:
    return timing["median_ms"] if isinstance(timing, dict) else timing.median_ms


def _iqr(timing) -> float:
    return timing["iqr_ms"] if isinstance(timing, dict) else timing.iqr_ms


if __name__ == "__main__":
    main(tyro.cli(Options, description=__doc__))
