"""Do combiners improve denoised frames at every sample count, and never make them worse?

python bench/combine.py CLIPS ... [--combiners combiner drc=FILE dc=FILE]

CLIPS/spp01, CLIPS/spp04 ... hold the same frames at several sample counts (`combine_clips.py --held-out`), with
denoised frames beside them (`rtdenoise estimates CLIPS/spp* --methods oidn default svgf`). Corrected MSE
(`metrics.image.mse_corrected`) of the noisy frames y, of each denoiser's z, and of every combiner's frames, for both
signals. A *failure* is a combiner's error above 1.02 of z's. The slope is that of log MSE over log spp from 16 on:
noise alone has -1. `svgf` made no frame that the combiners were trained on. Errors of differences between consecutive
frames (`metrics.video.tmse_corrected`) tell flicker. `drc` is trained by `rtdenoise train --model drc`, `dc` by
`bench/deep_combiner.py`. Writes bench/results/combine.json and the
tables of docs/results/combine.md.
"""

from __future__ import annotations

import sys
from collections import defaultdict
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))  # this checkout, whatever rtdenoise is installed
from bench import DOCS, RESULTS, harness

# isort: split
import numpy as np
import torch
import tyro

from rtdenoise.baselines import DeepCombiner
from rtdenoise.color import display_exposure
from rtdenoise.data.clips import ClipDataset
from rtdenoise.errors import InputError
from rtdenoise.frame import Frame, History
from rtdenoise.metrics.image import mse_corrected
from rtdenoise.metrics.video import tmse_corrected
from rtdenoise.models import Combiner, Shrinkage, Window, load_combiner
from rtdenoise.models.shrinkage import correct
from rtdenoise.sanitise import sanitise

RESULT, PAGES = RESULTS / "combine.json", (DOCS / "results" / "combine.md",)
MAX_RATIO = 1.02  # of a combiner's error to that of z: more is a failure
STEEP = 16  # spp from which the slope is taken
PLAIN = ("shrinkage", "recurrent", "shrinkage-halves")  # combiners without weights
FIRST = 1  # frames before this one are not measured: temporal denoisers have no history there


def main(
    clips: tyro.conf.Positional[tuple[Path, ...]],
    methods: tuple[str, ...] = ("oidn", "default", "svgf"),
    combiners: tuple[str, ...] = ("combiner",),
    levels: tuple[int, ...] = (1, 2, 4, 8, 16, 32, 64, 128, 256),
) -> None:
    """Measure every clip.

    Args:
        clips: Folders, each with a folder of clips for each sample count.
        methods: Denoisers to correct.
        combiners: Networks that ship, or NAME=FILE for weights; the name `dc` is that of deep combiners.
        levels: Sample counts; those that a folder lacks are left out.
    """
    networks = dict(map(loaded, combiners))
    rows = [row for folder in clips for row in measure(folder, methods, networks, levels)]
    sets = {name: summary(some) for name, some in _by(rows, "set").items()}
    document = {"max_ratio": MAX_RATIO, "rows": rows, "summary": summary(rows), "sets": sets}
    harness.publish(RESULT, document, digits=4, pages=PAGES, tables=tables)


def loaded(combiner: str) -> tuple[str, Combiner | DeepCombiner]:
    """Name and network of one of --combiners."""
    name, _, file = combiner.partition("=")
    return name, DeepCombiner.load(file) if name == "dc" else load_combiner(file or name, precision="fp32")


def measure(
    clips: Path, methods: tuple[str, ...], networks: dict[str, Combiner | DeepCombiner], levels: tuple[int, ...]
) -> list[dict]:
    """A row for each clip of a folder, signal, sample count and denoiser."""
    found = {spp: clips / f"spp{spp:02d}" for spp in levels}
    opened = {spp: ClipDataset(folder) for spp, folder in found.items() if folder.is_dir()}
    rows = []
    for index in range(len(next(iter(opened.values())))):
        for signal in ("color", "indirect"):
            for spp, clip in opened.items():
                halves = halves_of(clips, index, signal, spp)
                for method in methods:
                    both = clip.load(index, signal=signal, estimates=method)
                    frames, estimates = both[: len(both) // 2], [frame.radiance for frame in both[len(both) // 2 :]]
                    told = {"set": clips.name, "sequence": _name(clip, index), "signal": signal, "spp": spp}
                    rows.append(told | {"method": method} | errors(frames, estimates, halves, networks))
                    print(rows[-1], flush=True)
    return rows


@torch.inference_mode()
def errors(
    frames: list[Frame],
    estimates: list[torch.Tensor],
    halves: list[torch.Tensor] | None,  # means of one half of the noisy samples
    networks: dict[str, Combiner | DeepCombiner],
) -> dict[str, float | dict[str, float]]:
    """Mean corrected MSE of the frames: of `noisy`, of z (`estimate`) and of each combiner; under `temporal` those of
    differences between consecutive frames."""
    scale = display_exposure(torch.cat([frame.reference for frame in frames]))
    found, changes, before = defaultdict(list), defaultdict(list), {}
    recurrent = _recurrent(frames, estimates)
    for i in range(FIRST, len(frames)):
        frame = frames[i]
        images = {"noisy": frame.radiance, "estimate": estimates[i]}
        images["shrinkage"] = Shrinkage().combine(window_at(i, Shrinkage(), frames, estimates)).image
        images["recurrent"] = recurrent[i]
        if halves is not None:
            images["shrinkage-halves"] = Shrinkage().combine(window_at(i, Shrinkage(), frames, estimates, halves)).image
        for name, network in networks.items():
            images[name] = network.combine(window_at(i, network, frames, estimates)).image
            if halves is not None and isinstance(network, Combiner) and network.config.evidence:
                with_halves = window_at(i, network, frames, estimates, halves)
                images[f"{name}-halves"] = network.combine(with_halves).image
        for name, image in images.items():
            found[name].append(mse_corrected(image, frame.reference, scale, reference_half=frame.reference_half))
            if name in before:
                pair = [frames[i - 1], frame]
                changes[name].append(
                    tmse_corrected((before[name], image), [f.reference for f in pair], scale,
                                   reference_halves=[f.reference_half for f in pair])
                )  # fmt: skip
        before = images
    means = lambda some: {name: float(np.mean(values)) for name, values in some.items()}  # noqa: E731
    return means(found) | {"temporal": means(changes)}


def _recurrent(frames: list[Frame], estimates: list[torch.Tensor]) -> list[torch.Tensor]:
    """The frames as `denoise --correct` corrects them, without a look ahead."""
    images, history = [], None
    for frame, estimate in zip(frames, estimates, strict=True):
        frame = sanitise(frame)
        onward = History(estimate, frame.motion_next, frame.depth, frame.normal)
        image, history = correct(frame, estimate, history, onward)
        images.append(image)
    return images


def window_at(i: int, combiner: Combiner | DeepCombiner | Shrinkage, *parts: list) -> Window:
    """The window of a combiner around frame i."""
    places = [p if 0 <= (p := i + offset) < len(parts[0]) else None for offset in combiner.offsets]
    return Window(*(tuple(None if p is None else part[p] for p in places) for part in parts))


def summary(rows: list[dict]) -> dict[str, dict]:
    """Combiner -> over all cells: their count, the failures, the geometric mean of its error over z's, also by spp, by
    denoiser and of differences between frames (`temporal`), the worst cell, and the mean slopes, z's too."""
    found = {}
    for name in (*PLAIN, *_networks(rows)):
        cells = [row for row in rows if name in row and row["estimate"] > 0 and row[name] > 0]
        if not cells:  # no halves of samples
            continue
        ratio = lambda some, name=name: float(np.exp(np.mean([np.log(r[name] / r["estimate"]) for r in some])))  # noqa: E731
        changes = [row["temporal"] for row in cells if min(row["temporal"][x] for x in (name, "estimate")) > 0]
        worst = max(cells, key=lambda row: row[name] / row["estimate"])
        found[name] = {
            "cells": len(cells),
            "failures": sum(row[name] > MAX_RATIO * row["estimate"] for row in cells),
            "above_both": sum(row[name] > 1.05 * min(row["estimate"], row["noisy"]) for row in cells),
            "ratio": ratio(cells),
            "temporal": ratio(changes),
            "by_spp": {str(spp): ratio(some) for spp, some in _by(cells, "spp").items()},
            "by_method": {method: ratio(some) for method, some in _by(cells, "method").items()},
            "worst": {k: worst[k] for k in ("sequence", "signal", "spp", "method")} | {"ratio": ratio([worst])},
            "slope": _slope(cells, name),
            "slope_of_estimate": _slope(cells, "estimate"),
        }
    return found


def tables(document: dict) -> dict[str, str]:
    """Sections `combine`: a line for each combiner; `combine-sets`: the same by folder of clips; `combine-cells`: mean
    ratios by denoiser and spp."""
    levels = sorted({row["spp"] for row in document["rows"]})
    lines = [
        f"| combiner | {' | '.join(f'{spp} spp' for spp in levels)} | all | worst | failures | above both | slope of z "
        "| slope |",
        "|---" * (len(levels) + 7) + "|",
    ]
    for name, found in document["summary"].items():
        ratios = [f"{found['by_spp'][str(spp)]:.3f}" if str(spp) in found["by_spp"] else "" for spp in levels]
        lines.append(
            f"| `{name}` | {' | '.join(ratios)} | {found['ratio']:.3f} | {found['worst']['ratio']:.3f} | "
            f"{found['failures']} of {found['cells']} | {found['above_both']} | {found['slope_of_estimate']:.2f} | "
            f"{found['slope']:.2f} |"
        )
    sets = ["| clips | combiner | error over z's | worst | failures | above both |", "|---|---|---|---|---|---|"]
    for name, combiners in document["sets"].items():
        sets += [
            f"| {name} | `{combiner}` | {found['ratio']:.3f} | {found['worst']['ratio']:.3f} | {found['failures']} of "
            f"{found['cells']} | {found['above_both']} |"
            for combiner, found in combiners.items()
        ]
    cells = ["| z | signal | combiner | " + " | ".join(f"{spp} spp" for spp in levels) + " |"]
    cells.append("|---" * (len(levels) + 3) + "|")
    for (method, signal), some in _by(document["rows"], "method", "signal").items():
        for name in (*PLAIN, *_networks(document["rows"])):
            ratios = {
                spp: np.exp(np.mean([np.log(r[name] / r["estimate"]) for r in s if name in r]))
                for spp, s in _by(some, "spp").items()
                if name in s[0]
            }
            shown = [f"{ratios[spp]:.3f}" if spp in ratios else "" for spp in levels]
            cells.append(f"| {method} | {signal} | `{name}` | {' | '.join(shown)} |")
    return {"combine": "\n".join(lines), "combine-sets": "\n".join(sets), "combine-cells": "\n".join(cells)}


def halves_of(clips: Path, index: int, signal: str, spp: int) -> list[torch.Tensor] | None:
    """The means of one half of the samples of a clip's frames, where there is the clip of half the samples."""
    try:
        return [frame.radiance for frame in ClipDataset(clips / f"spp{spp // 2:02d}").load(index, signal=signal)]
    except InputError:
        return None


def _name(clips: ClipDataset, index: int) -> str:
    facts = clips.facts(index)
    return f"{facts.get('place', facts['kind'])} {index}"


def _networks(rows: list[dict]) -> list[str]:
    known = {"set", "sequence", "signal", "spp", "method", "noisy", "estimate", "temporal", *PLAIN}
    return list(dict.fromkeys(name for row in rows for name in row if name not in known))


def _by(rows: list[dict], *keys: str) -> dict:
    found = defaultdict(list)
    for row in rows:
        found[row[keys[0]] if len(keys) == 1 else tuple(row[key] for key in keys)].append(row)
    return found


def _slope(rows: list[dict], name: str) -> float:
    """Mean slope of log MSE over log spp, from `STEEP` on; NaN with fewer than two levels."""
    slopes = []
    for some in _by(rows, "set", "sequence", "signal", "method").values():
        points = [(row["spp"], row[name]) for row in some if row["spp"] >= STEEP and name in row]
        if len(points) > 1:
            spp, mse = np.log(np.array(points)).T
            slopes.append(np.polyfit(spp, mse, 1)[0])
    return float(np.mean(slopes)) if slopes else float("nan")


if __name__ == "__main__":
    harness.run(main, __doc__)
