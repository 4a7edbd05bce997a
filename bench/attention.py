"""Does guided self-attention beat concatenation, no features, a U-Net of equal arithmetic, and OIDN?

python bench/attention.py HELD RUNS [--data CLIPS ...]

HELD/spp01, HELD/spp04 ... hold the same frames at several sample counts (`combine_clips.py --held-out`), each frame
denoised alone. RUNS/KIND-SEED are folders of `rtdenoise train`: `guided`, `concatenated`, `none`, `unet` (the control),
`unetlong` (the control, three times the steps), `kernel` and `unetkernel` (9×9 kernels instead of a residual),
`nohalo`. `zeros` is `guided` with zeros around its last convolutions. PSNR and relMSE are corrected for the references'
own noise. Beside them: seams (error differences across borders of blocks over those elsewhere), border rows against
those of a mirrored picture, and CPU time. Writes bench/results/attention.json and tables of docs/results/attention.md.
"""

from __future__ import annotations

import json
import math
import sys
import time
from collections import defaultdict
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import partial
from multiprocessing import get_context
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))  # this checkout, whatever rtdenoise is installed
from bench import DOCS, RESULTS, harness

# isort: split
import numpy as np
import torch
import tyro
from torch import Tensor
from torch.nn import functional as F

from rtdenoise.baselines import Oidn
from rtdenoise.color import compress, display_exposure
from rtdenoise.data.clips import ClipDataset
from rtdenoise.exposure import exposure
from rtdenoise.frame import Frame, Known
from rtdenoise.metrics.image import decibels, mse_corrected, relmse, ssim
from rtdenoise.models import GuidedAttentionConfig, load
from rtdenoise.models.weights import read_model

RESULT, PAGES = RESULTS / "attention.json", (DOCS / "results" / "attention.md",)
LEVELS = (1, 4, 8, 16, 32)
BLOCK, MIRRORED, BORDER = 8, 32, 2  # pixels: a block, the mirrored margin, the rows at a border
MIRRORED_AT = 4  # samples a pixel of the frames that are mirrored
ZEROS = "zeros-0"  # `guided-0` with zeros around its last convolutions
FACTS = ("cpu_seconds_per_megapixel", "seam_ratio", "border_bias")
# RMSE of table 1 of Yu et al. 2021, half of relMSE, on 14 other scenes; times 1000 there.
PAPER = {4: 9.979e-3, 8: 4.855e-3, 16: 2.766e-3, 32: 1.839e-3}
WHAT = {
    "noisy": "noisy", "oidn": "OIDN", "guided": "**guided** by features", "concatenated": "features concatenated",
    "none": "no features", "nohalo": "guided, halo 0",
    "zeros": "guided, zeros around the last convolutions", "unet": "U-Net of equal arithmetic",
    "unetlong": "the same U-Net, three times the steps",
    "kernel": "guided, 9×9 kernels", "unetkernel": "U-Net, 9×9 kernels",
}  # fmt: skip


def main(
    held: tyro.conf.Positional[Path],
    runs: tyro.conf.Positional[Path],
    data: tuple[Path, ...] = (),
    levels: tuple[int, ...] = LEVELS,
    frames: int = 1,
    workers: int = 1,
) -> None:
    """Measure every network on every frame.

    Args:
        held: Folder with a folder of clips for each sample count.
        runs: Folder of runs, KIND-SEED each.
        data: The clips that the runs were trained on, to be counted.
        levels: Sample counts.
        frames: Frames of each clip, from its first one.
        workers: Processes, with one thread each.
    """
    files = {path.parent.name: path for path in sorted(runs.glob("*-*/weights.safetensors"))}
    clips = ClipDataset(held / f"spp{levels[0]:02d}")
    with ProcessPoolExecutor(workers, get_context("spawn")) as processes:
        places = [(index, spp) for index in range(len(clips)) for spp in levels]
        parts = list(processes.map(partial(measured, held, files, frames), *zip(*places, strict=True)))
    rows = [row for part, _ in parts for row in part]
    networks = {
        name: {
            "multiplications": config.multiplications,
            "parameters": sum(math.prod(shape) for shape in config.shapes.values()),
            **{key: float(np.mean([f[name][key] for _, f in parts if key in f[name]])) for key in FACTS},
        }
        for name, config in configs(files).items()
    }
    training = json.loads((files[min(files)].parent / "config.json").read_text())["options"]
    told = ("steps", "batch", "size", "frames", "lr", "signal")
    scenes = [clips.facts(index) for index in range(len(clips))]
    document = {
        "training": {key: training[key] for key in told} | _counted(data),
        "sequences": [f"{facts.get('place', facts['kind'])}, {facts['reference_spp']} spp" for facts in scenes],
        "networks": networks,
        "rows": rows,
        "differences": differences(rows),
    }
    harness.publish(RESULT, document, digits=4, pages=PAGES, tables=tables)


def configs(files: dict[str, Path]) -> dict[str, GuidedAttentionConfig]:
    """The configurations of the runs, and of `ZEROS`."""
    found = {name: read_model(path).config for name, path in files.items()}
    return found | {ZEROS: replace(found["guided-0"], mirrored=False)}


@torch.inference_mode()
def measured(held: Path, files: dict[str, Path], count: int, index: int, spp: int) -> tuple[list[dict], dict]:
    """The rows of one sequence at one sample count; and of each network its `FACTS` there."""
    torch.set_num_threads(1)
    networks = {name: load(path, precision="fp32") for name, path in files.items()}
    networks[ZEROS] = load(files["guided-0"], precision="fp32", mirrored=False)
    images, facts = defaultdict(list), {name: defaultdict(list) for name in networks}
    frames = ClipDataset(held / f"spp{spp:02d}").load(index)[:count]
    for frame in frames:
        images["noisy"].append(frame.radiance)
        images["oidn"].append(Oidn().step(frame)[0])
        for name, network in networks.items():
            started = time.process_time()
            images[name].append(network.step(frame)[0])
            seconds = time.process_time() - started
            facts[name]["cpu_seconds_per_megapixel"].append(seconds / (frame.size[0] * frame.size[1] / 1e6))
            facts[name]["seam_ratio"].append(seam(images[name][-1], frame.reference))
            if spp == MIRRORED_AT:
                facts[name]["border_bias"].append(border(network, frame))
    rows = [{"sequence": index, "spp": spp, "network": name} | errors(x, frames) for name, x in images.items()]
    return rows, {name: {key: np.mean(values) for key, values in found.items()} for name, found in facts.items()}


def errors(images: list[Tensor], frames: list[Frame]) -> dict[str, float]:
    """Errors of the frames of a sequence: corrected PSNR of their mean MSE, mean corrected relMSE and SSIM."""
    scale = display_exposure(torch.cat([frame.reference for frame in frames]))
    pairs = [(image, frame.reference, frame.reference_half) for image, frame in zip(images, frames, strict=True)]
    return {
        "psnr": decibels(max(1e-8, np.mean([mse_corrected(a, r, scale, reference_half=h) for a, r, h in pairs]))),
        "relmse": float(np.mean([relmse(a, r, scale, reference_half=h) for a, r, h in pairs])),
        "ssim": float(np.mean([ssim(a, r, scale) for a, r, _ in pairs])),
    }


def seam(image: Tensor, reference: Tensor) -> float:
    """Mean difference between the errors of neighbours in two blocks over that of neighbours in one; errors are taken
    on logarithms of exposed light."""
    scale = exposure(reference)
    error = compress(image * scale) - compress(reference * scale)
    across, within = [], []
    for step in (error.diff(dim=3), error.diff(dim=2).transpose(2, 3)):
        border = torch.arange(step.shape[3]) % BLOCK == BLOCK - 1
        across.append(step[..., border].abs().mean())
        within.append(step[..., ~border].abs().mean())
    return float(sum(across) / sum(within))


def border(network: torch.nn.Module, frame: Frame) -> float:
    """Light in the outermost pixels over that in the same pixels inside a mirrored picture, minus 1."""
    scale, distance = network.statistics(frame)
    known = Known(exposure=scale, distance=distance)
    wide = frame.map(lambda x: F.pad(x, (MIRRORED,) * 4, mode="reflect"))
    inside = network.step(wide, None, known)[0][..., MIRRORED:-MIRRORED, MIRRORED:-MIRRORED]
    image, _ = network.step(frame, None, known)
    mask = torch.ones_like(image[:, :1], dtype=torch.bool)
    mask[..., BORDER:-BORDER, BORDER:-BORDER] = False
    return float((compress(image * scale) * mask).sum() / (compress(inside * scale) * mask).sum() - 1)


def differences(rows: list[dict]) -> dict[str, dict[str, float]]:
    """`guided-SEED` minus each network of the same seed, and OIDN: mean dB, and the share of cells that it wins."""
    cells = {(row["network"], row["sequence"], row["spp"]): row["psnr"] for row in rows}
    found = {}
    for guided in sorted({row["network"] for row in rows if row["network"].startswith("guided-")}):
        seed = guided.rpartition("-")[2]
        for other in sorted({row["network"] for row in rows} - {guided}):
            if other == "oidn" or other.endswith(f"-{seed}"):
                gains = [cells[guided, *key] - value for (name, *key), value in cells.items() if name == other]
                found[f"{guided} over {other}"] = {
                    "db": float(np.mean(gains)), "won": float(np.mean(np.array(gains) > 0)), "cells": len(gains)
                }  # fmt: skip
    return found


def tables(document: dict) -> dict[str, str]:
    """Sections `attention` (PSNR), `attention-relmse`, `attention-pairs` and `attention-training`."""
    rows, networks, training = document["rows"], document["networks"], document["training"]
    levels, found = sorted({row["spp"] for row in rows}), sorted({row["network"] for row in rows})
    named = [(name, kind) for kind in WHAT for name in found if kind in (name, name.rpartition("-")[0])]
    heads = " | ".join(f"{spp} spp" for spp in levels)

    def means(name: str, key: str) -> list[float]:
        return [np.mean([r[key] for r in rows if (r["network"], r["spp"]) == (name, spp)]) for spp in levels]

    psnr = [f"| network, seed | kMAC a pixel | CPU s a megapixel | {heads} | seams | borders |",
            "|---" * (len(levels) + 5) + "|"]  # fmt: skip
    relative = [f"| network, seed | {heads} |", "|---" * (len(levels) + 1) + "|"]
    for name, kind in named:
        label = WHAT[kind] if name == kind else f"{WHAT[kind]}, {name.rpartition('-')[2]}"
        cost = ends = " | "
        if facts := networks.get(name):
            cost = f"{facts['multiplications'] / 1e3:.0f} | {facts['cpu_seconds_per_megapixel']:.1f}"
            ends = f"{facts['seam_ratio']:.3f} | {100 * facts['border_bias']:+.2f} %"
        psnr.append(f"| {label} | {cost} | {' | '.join(f'{x:.2f}' for x in means(name, 'psnr'))} | {ends} |")
        relative.append(f"| {label} | {' | '.join(f'{x:.3f} ({500 * x:.1f})' for x in means(name, 'relmse'))} |")
    paper = [f"{2 * PAPER[spp]:.3f} ({1e3 * PAPER[spp]:.1f})" if spp in PAPER else "" for spp in levels]
    relative.append(f"| *the paper's `afgsa`, on its own 14 scenes* | {' | '.join(paper)} |")
    pairs = ["| | dB | cells won |", "|---|---|---|"]
    pairs += [f"| {k} | {v['db']:+.2f} | {round(v['won'] * v['cells'])} of {v['cells']} |"
              for k, v in document["differences"].items()]  # fmt: skip
    told = (
        f"Trained for {training['steps']} steps of {training['batch']} crops of {training['size']}² pixels on "
        f"{training['clips']} clips of {training['scenes']} scenes (`{document['command']}`, "
        f"[JSON](../../bench/results/attention.json))."
    )
    return {"attention": "\n".join(psnr), "attention-relmse": "\n".join(relative), "attention-pairs": "\n".join(pairs),
            "attention-training": told}  # fmt: skip


def _counted(folders: tuple[Path, ...]) -> dict[str, int]:
    clips = ClipDataset(*folders) if folders else None
    return {"clips": len(clips) if clips else 0, "scenes": len(clips.scenes()) if clips else 0}


if __name__ == "__main__":
    harness.run(main, __doc__)
