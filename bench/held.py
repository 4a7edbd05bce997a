"""Weights against OIDN on scenes held out of training: single frames and later ones, at several sample counts.

python bench/held.py HELD... --weights default many runs/mine/weights.safetensors

HELD/spp01, HELD/spp04 ... hold clips or stills at several sample counts (`combine_clips.py --held-out`,
`held_stills.py`), with references of independent samples in two halves. PSNR is corrected for the references' own
noise, and taken at the display exposure and three stops to either side of it: dark pictures show deep shadows, bright
ones what glows. This is the figure that steers training; `quality.py` has all metrics. Writes bench/results/held.json
and tables of docs/results/held.md.
"""

from __future__ import annotations

import sys
import time
from collections import defaultdict
from collections.abc import Iterable, Iterator
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))  # this checkout, whatever rtdenoise is installed
from bench import DOCS, RESULTS, harness

# isort: split
import numpy as np
import torch
import tyro

from rtdenoise.baselines import Oidn
from rtdenoise.color import display_exposure
from rtdenoise.data.clips import ClipDataset
from rtdenoise.evaluate.sequence import Step, outputs
from rtdenoise.metrics.image import decibels, mse_corrected
from rtdenoise.models import available, load
from rtdenoise.run.passes import InMemory, Passes

RESULT, PAGES = RESULTS / "held.json", (DOCS / "results" / "held.md",)
SIGNALS = ("indirect", "color")
LEVELS = (1, 4, 8, 16, 64)
KINDS = ("single", "later")
STOPS = (0, 3, -3)  # exposures of the measure
LATER = 3  # frames at the end of a clip that count as later ones
OFFLINE = "+offline"  # ending of weights in the offline mode
LEAST = 1e-7  # squared error that a logarithm is taken of


def main(
    held: tyro.conf.Positional[tuple[Path, ...]],
    weights: tuple[str, ...] = (
        "fast",
        "default",
        "many",
        "default+offline",
        "many+offline",
    ),
    levels: tuple[int, ...] = LEVELS,
    write: bool = True,
) -> None:
    """Measure.

    Args:
        held: Folders with a folder of clips for each sample count.
        weights: Names of shipped weights, NAME+offline for `denoise --offline`, or files.
        levels: Sample counts; those that a folder lacks are left out.
        write: Write the JSON and the tables; off: only print them.
    """
    places = [(folder, level) for folder in held for level in levels if (folder / f"spp{level:02d}").is_dir()]
    methods = {"oidn": (Oidn().step, 0)} | {name: opened(name) for name in weights}
    rows = [row for place in places for row in measured(*place, methods)]
    document = {"weights": list(weights), "levels": list(levels), "rows": rows}
    for section in tables(document).values():
        print(section, end="\n\n")
    if write:
        harness.publish(RESULT, document, digits=4, pages=PAGES, tables=tables)


@torch.inference_mode()
def measured(folder: Path, level: int, methods: dict[str, tuple[Step, int]]) -> Iterator[dict]:
    """A row for every clip, signal and method: corrected PSNR of single and of later frames, by exposure."""
    clips = ClipDataset(folder / f"spp{level:02d}")
    for index, signal in ((i, s) for i in range(len(clips)) for s in SIGNALS):
        frames = clips.load(index, signal=signal)
        scale = display_exposure(torch.cat([frame.reference for frame in frames]))
        for name, (step, delay) in methods.items():
            errors, started = defaultdict(list), time.process_time()
            images = [output.image for output in outputs(step, frames, delay)]
            seconds = (time.process_time() - started) / len(frames)
            for number, (frame, image) in enumerate(zip(frames, images, strict=True)):
                kind = "single" if number == 0 else "later" if number >= len(frames) - LATER else "between"
                for stops in STOPS:
                    exposed = mse_corrected(
                        image, frame.reference, scale * 2.0**stops, reference_half=frame.reference_half
                    )
                    errors[kind, stops].append(exposed)
            yield {
                "set": folder.name, "place": clips.facts(index)["place"], "clip": index, "signal": signal, "spp": level,
                "method": name, "seconds": seconds,
                "psnr": {f"{kind} {stops:+d}": decibels(max(LEAST, float(np.mean(found))))
                         for (kind, stops), found in errors.items() if kind in KINDS},
            }  # fmt: skip


def opened(name: str) -> tuple[Step, int]:
    """The step of NAME or NAME+offline, and its delay."""
    model = name.removesuffix(OFFLINE)
    if model != name:
        return InMemory(Passes(model, "cpu", "fp32")).step, InMemory.delay
    return load(name, precision="fp32").step, 0


def tables(document: dict) -> dict[str, str]:
    """Sections `held` (leads over OIDN), `held-scenes` (at the fewest samples, scene by scene) and `held-exposures`."""
    sets = list(dict.fromkeys(row["set"] for row in document["rows"]))
    levels, lines = document["levels"], []
    weights = [name for name in document["weights"] if "/" in name or name.removesuffix(OFFLINE) in available()]
    for name in sets:
        columns = [(name, kind, spp) for kind in KINDS for spp in levels]
        columns = [c for c in columns if _leads(document, "oidn", *c, "indirect", 0)]
        lines += [f"`{name}`", "", *_head([*(f"{kind}, {spp} spp" for _, kind, spp in columns), "CPU time"])]
        for method in weights:
            slower = _seconds(document, method) / _seconds(document, "oidn")
            leads = (_lead(document, method, *c) for c in columns)
            lines.append(_line(_label(method), [*leads, f"{slower:.2f}×"]))
        lines.append("")
    exposures = _head(f"{kind}, ×{2.0**s:g}" for kind in KINDS for s in STOPS)
    places = list(dict.fromkeys((row["set"], row["place"]) for row in document["rows"]))
    scenes = _head(f"{place}<br>{name}" for name, place in places)
    for method in weights:
        label = _label(method)
        first = ((sets[0], kind, levels[0], stops) for kind in KINDS for stops in STOPS)
        exposures.append(_line(label, (_lead(document, method, *c) for c in first)))
        for kind in KINDS:
            found = (_lead(document, method, name, kind, levels[0], place=place) for name, place in places)
            scenes.append(_line(f"{label}, {kind}", found))
    return {name: "\n".join(text).strip() for name, text in
            {"held": lines, "held-exposures": exposures, "held-scenes": scenes}.items()}  # fmt: skip


def _label(method: str) -> str:
    return f"`{method}`" if "/" not in method else Path(method).parent.name


def _seconds(document: dict, method: str) -> float:
    return sum(row["seconds"] for row in document["rows"] if row["method"] == method)


def _head(cells: Iterable[str]) -> list[str]:
    cells = list(cells)
    return [_line("", cells), "|---" * (len(cells) + 1) + "|"]


def _line(label: str, cells: Iterable[str]) -> str:
    return f"| {label} | {' | '.join(cells)} |"


def _lead(document: dict, method: str, name: str, kind: str, spp: int, stops: int = 0, place: str | None = None) -> str:
    both = [_leads(document, method, name, kind, spp, signal, stops, place) for signal in SIGNALS]
    return ", ".join(f"{np.mean(found):+.2f}" for found in both if found)


def _leads(
    document: dict, method: str, name: str, kind: str, spp: int, signal: str, stops: int, place: str | None = None
) -> list[float]:
    """dB over OIDN of a method, clip by clip."""
    found: dict[str, dict[int, float]] = {method: {}, "oidn": {}}
    for row in document["rows"]:
        here = (row["set"], row["spp"], row["signal"]) == (name, spp, signal) and place in (None, row["place"])
        if here and row["method"] in found and (key := f"{kind} {stops:+d}") in row["psnr"]:
            found[row["method"]][row["clip"]] = row["psnr"][key]
    return [value - found["oidn"][clip] for clip, value in found[method].items()]


if __name__ == "__main__":
    harness.run(main, __doc__)
