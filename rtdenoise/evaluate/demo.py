"""`rtdenoise demo`: denoise the bundled sequence, measure it, and leave pictures to look at."""

from __future__ import annotations

from pathlib import Path

from rich import box
from rich.console import Console
from rich.table import Table

from ..color import display_exposure
from ..data.opening import open_sequence
from ..errors import InputError
from ..files import dumps, lock, remove_unfinished, replacing, write_atomically
from ..frame import Frame
from ..run.preview import animate, strip
from . import METRICS, REGIONS, Result, evaluate, uncovered
from .inputs import Source

SAMPLE = Path(__file__).parents[2] / "samples" / "mural"  # in a source tree
WINDOW = Path(__file__).parents[1] / "sample" / "mural-window"  # in an installed package: a part of the same frames
METHODS = ("noisy", "accumulate", "paper-traditional", "paper", "default", "hybrid")
HEADINGS = {"psnr": "PSNR", "ssim": "SSIM", "relmse": "relMSE"}


def demo(
    out: Path, source: Path | None = None, signal: str = "indirect", methods: tuple[str, ...] = METHODS
) -> list[Result]:
    """Run the demo on `source` (default: the bundled sequence, or the part of it that comes with the package) and write
    `strip.png`, an animation and `demo.json` into `out`; prints the table.

    `methods` must include "accumulate"; the pictures show it and the last one. Raises InputError where the source or
    its signal is missing, and where another run writes to `out`.
    """
    if source is None:
        source = SAMPLE if SAMPLE.is_dir() else WINDOW
        if source == WINDOW and signal != "indirect":
            raise InputError(
                f"--signal {signal}: the packaged sample has indirect light alone; name others with --source"
            )
    if not source.is_dir():
        raise InputError(f"{source}: no such folder; expected a sequence with references")
    frames = list(open_sequence(source, signal=signal, layers=("reference", "reference_half")))
    out.mkdir(parents=True, exist_ok=True)
    with lock(out):
        remove_unfinished(out)
        return _demo(out, source, signal, frames, methods)


def _demo(out: Path, source: Path, signal: str, frames: list[Frame], methods: tuple[str, ...]) -> list[Result]:
    """Measure, write and print."""
    results = evaluate(frames, methods)
    noisy = f"{Source.open(source, signal, 'auto', None).spp} spp"
    animation = _draw(out, frames, {result.method: result for result in results}, methods[-1], noisy)
    masks = uncovered(frames)[1:]
    share = sum(mask.float().mean().item() for mask in masks) / max(len(masks), 1)
    rows = [{"method": r.method, "errors": r.errors, "median_step_ms": round(1000 * r.seconds, 1)} for r in results]
    document = {"signal": signal, "uncovered_share": share, "results": rows}
    write_atomically(out / "demo.json", (dumps(document, indent=1) + "\n").encode())

    console = Console(markup=False, emoji=False)
    console.print(
        _table(results, f"{source.name}: {len(frames)} frames, {noisy}, {signal}; {share:.1%} of the pixels uncovered")
    )
    console.print(f"pictures: {out / 'strip.png'}, {animation}; numbers: {out / 'demo.json'}", soft_wrap=True)
    return results


def _draw(out: Path, frames: list[Frame], results: dict[str, Result], ours: str, noisy: str) -> Path:
    """Write strip.png and the animation; returns the latter. `noisy`: the label of the input."""
    scale = display_exposure(frames[0].reference)
    strips = [
        strip(
            {
                noisy: frame.radiance,
                "accumulate": results["accumulate"].images[i],
                "rtdenoise": results[ours].images[i],
                "reference": frame.reference,
            },
            scale,
        )
        for i, frame in enumerate(frames)
    ]
    with replacing(out / "strip.png", suffix=".png") as temporary:
        strips[-1].save(temporary)
    return animate(strips, out / "demo")


def _table(results: list[Result], title: str) -> Table:
    table = Table(title=title, box=box.SIMPLE)
    table.add_column("method", no_wrap=True)
    for region in REGIONS:
        for metric in METRICS:
            table.add_column(f"{HEADINGS[metric]}\n{region[:5]}", justify="right", no_wrap=True)
    table.add_column("ms", justify="right", no_wrap=True)
    for r in results:
        values = [(metric, r.errors[region][metric]) for region in REGIONS for metric in METRICS]
        shown = [f"{value:.2f}" if metric == "psnr" else f"{value:.3f}" for metric, value in values]
        table.add_row(r.method, *shown, f"{1000 * r.seconds:.0f}")
    return table
