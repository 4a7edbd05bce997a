"""Time of a frame: stages × backends × models × sizes, with OIDN in the same run.

python bench/latency_720p.py                          # 1280×720, on CUDA where it is; `default`, `hybrid` larger, too
python bench/latency_720p.py --sizes 720p 4k          # everything at both sizes
python bench/latency_720p.py --quick                  # 32×18, some seconds
"""

from __future__ import annotations

import ctypes
import gc
import sys
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))  # this checkout, whatever rtdenoise is installed
from bench import DOCS, RESULTS, harness

# isort: split
import torch

from bench.latency import methods
from bench.latency.methods import Method
from bench.latency.shaders import measurable
from bench.latency.stages import STAGES, peak_bytes, staged
from bench.latency.tables import TOTAL, plot, scaling, short_table, table
from rtdenoise import models, ops
from rtdenoise.baselines.oidn import installed
from rtdenoise.frame import Frame

RESULT, PAGES = RESULTS / "latency_720p.json", (DOCS / "results" / "performance.md",)
ON_CUDA, ON_AMX, ON_AVX2 = (RESULTS / f"latency_720p_{device}.json" for device in ("cuda", "amx", "avx2"))
OTHER_RESULTS = (ON_CUDA, ON_AMX, ON_AVX2)  # with tables on the same pages
SHORT = {ON_AMX: ("latency-amx", ("bf16", "int8")), ON_AVX2: ("latency-avx2", ("fp32", "int8"))}  # section, precisions
SIZES = {
    "quick": (32, 18), "360p": (640, 360), "720p": (1280, 720), "1080p": (1920, 1080), "1440p": (2560, 1440),
    "4k": (3840, 2160),
}  # fmt: skip
AT_ALL_SIZES = "default", "hybrid"  # models


@dataclass(frozen=True)
class Options:
    sizes: tuple[str, ...] = ("720p",)
    """Some of 360p, 720p, 1080p, 1440p, 4k."""
    scaling: tuple[str, ...] = ("360p", "1080p", "1440p", "4k")
    """Further sizes, at which only `default` and `hybrid` in half precision and in bytes, and OIDN high, are timed."""
    presets: tuple[str, ...] = ()
    """Some of the models (default: all). Weights do not matter to the time; models without any get random ones."""
    backends: tuple[str, ...] = tuple(methods.BACKENDS)
    """Some of the ways to run a model."""
    calls: int = 10
    """Timed calls of each method at 720p; fewer at larger sizes, no fewer than 3 unless asked."""
    threads: int = 0
    """Threads of the CPU; 0: torch's choice."""
    device: str = "auto"
    """'auto', 'cpu' or 'cuda'."""
    quick: bool = False
    """32×18, one call."""
    out: Path | None = None
    """JSON file; its table and plot go beside it, .md and .png (default: that of the device in bench/results; it also
    updates docs/results/performance.md and the plot there, unless --quick)."""


def main(o: Options) -> None:
    if o.threads:
        torch.set_num_threads(o.threads)
    torch.backends.cudnn.allow_tf32 = False  # rows of fp32 say fp32
    device = o.device if o.device != "auto" else "cuda" if torch.cuda.is_available() else "cpu"
    sizes, calls = (("quick",), 1) if o.quick else (o.sizes, o.calls)
    presets = o.presets or tuple(name for name, config in models.PRESETS.items() if not config.reads)
    with_shaders, gl = measurable(o.quick)
    with torch.inference_mode():
        peaks = measured_peaks(device, calls, o.quick)
        rows = [row for size in sizes for row in run(size, presets, device, calls, with_shaders, o.backends)]
        for size in () if o.quick else (size for size in o.scaling if size not in sizes):
            give_back()
            rows += run(size, AT_ALL_SIZES, device, calls, False, methods.SCALED, ("high",))
    cuda = torch.cuda.get_device_name() if torch.cuda.is_available() else "not measured: there is none"
    devices = {"torch": cuda if device == "cuda" else harness.cpu(), "cpu": harness.cpu(), "glsl": gl, "cuda": cuda}
    content = {"device": device, "measured_peaks": peaks, "rows": rows}
    out = o.out or (ON_CUDA if device == "cuda" else RESULT)
    published = out in (RESULT, ON_CUDA) and not o.quick
    where = {"pages": PAGES, "tables": tables} if published else {}
    document = harness.publish(out, content, devices=devices, **where)
    text = "\n\n".join(filter(None, [*(table(document, size) for size in sizes), scaling(document["rows"])]))
    picture = (DOCS / "images" / out.name if published else out).with_suffix(".png")
    if not published:
        out.with_suffix(".md").write_text(text + "\n")
    print(text)
    if find_spec("matplotlib"):
        plot(document, picture)
    else:
        print(f"{picture}: not drawn: pip install 'rtdenoise[bench]' brings matplotlib")


def tables(document: dict) -> dict[str, str]:
    """Sections `latency` and `scaling`, or `latency-cuda` and `scaling-cuda`; of `SHORT` totals alone."""
    for result, (section, precisions) in SHORT.items():
        if result.name in document["command"]:
            return {section: short_table(document, "720p", precisions)}
    where = "-cuda" if document["device"] == "cuda" else ""
    return {f"latency{where}": table(document, "720p"), f"scaling{where}": scaling(document["rows"])}


def run(
    size: str,
    presets: tuple[str, ...],
    device: str,
    calls: int,
    with_shaders: bool,
    backends: tuple[str, ...] = tuple(methods.BACKENDS),
    qualities: tuple[str, ...] = methods.OIDN_QUALITIES,
) -> list[dict]:
    """All methods at one size, timed in rotation: the rows of the result."""
    W, H = SIZES[size]
    calls = max(min(calls, 3), round(calls * min(1, 1280 * 720 / (W * H))))
    frame = methods.synthetic_frame(H, W).to(device)
    timed = [m for preset in presets for m in methods.torch_methods(preset, frame, device, backends)]
    if installed():
        timed += methods.oidn_methods(frame, qualities)
    shaders = [m for preset in presets for m in methods.shader_methods(preset, frame)] if with_shaders else []
    totals = {}
    for turn in (timed, shaders):  # a GPU takes its time to go from OpenGL to CUDA
        totals |= harness.measure({m.name: partial(step, m, device) for m in turn}, calls, warmup=1)
    timed += shaders
    rows = [{"method": m.name, TOTAL: totals[m.name]} for m in timed]
    for row, method in zip(rows, timed, strict=True):
        if method.model:
            row |= stages(method, frame, device, halved(calls))
        elif method.shaders:
            runs = [method.shaders.stages() for _ in range(halved(calls))]
            row |= {"stages": by_stage(runs), "peak_mb": round(method.shaders.megabytes, 1)}
    if not installed():
        rows.append({"method": "oidn", "reason": methods.OIDN_MISSING})
    return [{"size": size, "pixels": [W, H], **row} for row in rows]


def halved(calls: int) -> int:
    return max(min(calls, 3), calls // 2)


def step(method: Method, device: str) -> None:
    with ops.use(method.ops):
        method.step()
        synchronise(device)


def stages(method: Method, frame: Frame, device: str, calls: int) -> dict[str, object]:
    """Time and bytes of a torch method by stage, the arithmetic of its network, and its peak memory."""
    ledgers = []
    with ops.use(method.ops):
        for _ in range(calls):
            with staged(method.model, partial(synchronise, device)) as ledger:
                method.step()
            ledgers.append(ledger)
        peak = peak_bytes(method.step, device)
    return {
        "stages": by_stage([ledger.seconds for ledger in ledgers]),
        "gb": {stage: ledgers[-1].bytes[stage] / 1e9 for stage in STAGES},
        "prediction_gflop": methods.network_flop(method.name.split()[0], frame) / 1e9,
        "peak_mb": round(peak / 1e6, 1),
    }


def by_stage(runs: list[dict[str, float]]) -> dict[str, harness.Timing]:
    return {stage: harness.summary([seconds[stage] for seconds in runs]) for stage in STAGES}


def give_back() -> None:
    """Return freed memory to the system where the C library is glibc: the histories of all methods at 4K take 18 GB."""
    gc.collect()
    with suppress(OSError, AttributeError, TypeError):
        ctypes.CDLL(None).malloc_trim(0)


def synchronise(device: str) -> None:
    if device == "cuda":
        torch.cuda.synchronize()


def measured_peaks(device: str, calls: int, quick: bool) -> dict[str, float]:
    """GB/s of a copy far larger than the caches of a core (read and written), and GFLOP/s of matrix products; `quick`
    takes small ones, which say little."""
    source = torch.rand(1 if quick else 32, 720, 1280, device=device)
    target = torch.empty_like(source)
    n = 128 if quick else 1024 if device == "cpu" else 8192
    work = {"copy_gb_per_s": (lambda: target.copy_(source), 2 * source.numel() * 4)}
    for name, dtype in (("fp32", torch.float32), ("bf16", torch.bfloat16)):
        a, b = (torch.rand(n, n, device=device, dtype=dtype) for _ in range(2))
        work[f"{name}_gflop_per_s"] = (partial(torch.mm, a, b), 2 * n**3)

    def done(call) -> None:
        call()
        synchronise(device)

    timing = lambda name: harness.measure({name: partial(done, work[name][0])}, min(calls, 10), warmup=1)[name]  # noqa: E731
    return {name: round(amount / timing(name).median_ms / 1e6, 1) for name, (_, amount) in work.items()}


if __name__ == "__main__":
    harness.run(main, __doc__)
