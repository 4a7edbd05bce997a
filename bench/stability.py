"""Promises for stiff and broken input, beside the measured values: the tables of docs/results/stability.md.

python bench/stability.py [--frames 10000]

The cases are those of the tests (tests/stability_cases.py, tests/stability_ops.py), for every shipped model in float32,
bfloat16, int8, float16 and in training, as far as it has them, and for every backend of the operations. Static input
runs for `--frames` frames in float32 and a tenth of that in the other modes. On the bundled sequence, whose noise is a
path tracer's: the light that the firefly limit removes, and how much the exposure flickers beyond the reference's.
"""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))  # this checkout, whatever rtdenoise is installed
from bench import DOCS, RESULTS, harness

# isort: split
import torch
from stability_cases import CASES, FIREFLY, Subject, modes_of
from stability_ops import BACKENDS, OP_CASES, backend

from rtdenoise.exposure import exposure, limit_fireflies
from rtdenoise.glsl import default_context
from rtdenoise.models import available

RESULT, PAGES = RESULTS / "stability.json", (DOCS / "results" / "stability.md",)


def main(frames: int = 10_000) -> None:
    rows = [
        {"case": case.name, "promise": case.promise, "unit": case.unit,
         "models": {name: {mode: _run(case, name, mode, frames) for mode in modes_of(name)} for name in available()}}
        for case in CASES
    ]  # fmt: skip
    ops = [
        {"case": case.name, "promise": case.promise, "bound": case.bound,
         "backends": {label: case.measure(backend(label)) for label in BACKENDS}}
        for case in OP_CASES
    ]  # fmt: skip
    devices = {"torch": harness.cpu(), "GLSL": default_context().info["GL_RENDERER"]}
    signals = {signal: sample(signal) for signal in ("indirect", "color")}
    content = {"frames": frames, "denoisers": rows, "operations": ops, "sample": signals}
    harness.publish(RESULT, content, devices=devices, pages=PAGES, tables=tables)
    broken = [row["case"] for row in ops for v in row["backends"].values() if v > row["bound"]]
    broken += [
        r["case"] for r in rows for m in r["models"].values() for v in m.values() if v["non_finite"] or not v["kept"]
    ]
    print(f"promises broken: {broken or 'none'}")


def _run(case, model: str, mode: str, frames: int) -> dict[str, float | int | bool]:
    subject = Subject.of(model, mode, frames if mode == "float32" else max(100, frames // 10))
    value = case.measure(subject)
    limit = case.limit(mode)
    return {"value": value, "bound": None if mode == "training" else limit, "kept": value <= limit,
            "non_finite": subject.non_finite}  # fmt: skip


def sample(signal: str) -> dict[str, float]:
    """Firefly limit and exposure on 1-spp noise. Flicker: mean |log| of the exposure's change from one frame to the
    next, relative to the change of the reference's exposure."""
    frames = harness.mural(signal, layers=("reference",))
    light = sum(f.radiance.sum().item() for f in frames)
    kept = sum(limit_fireflies(f.radiance).sum().item() for f in frames)
    ratio = torch.stack([exposure(f.radiance).log() - exposure(f.reference).log() for f in frames]).flatten()
    lit = frames[0].radiance.clone()
    lit[..., 50, 60] = FIREFLY
    moved = (exposure(lit) / exposure(frames[0].radiance)).log().abs().item()
    return {"light_cut": 1 - kept / light, "exposure_flicker": ratio.diff().abs().mean().item(),
            "exposure_moved_by_a_firefly": moved}  # fmt: skip


def tables(document: dict) -> dict[str, str]:
    """Sections `sample`, `denoiser` and `operations`."""
    models = [name for name in document["denoisers"][0]["models"] if name in available()]
    frames = document["frames"]
    length = f"Long sequences: {frames} frames in float32, {max(100, frames // 10)} in other precisions.\n\n"
    denoisers = length + "\n\n".join(f"Model `{name}`:\n\n{table(document, name)}" for name in models)
    lines = ["| bundled sample, 1 spp | light cut | exposure, from frame to frame | exposure, by one firefly of 1e7 |",
             "|---|---|---|---|"]  # fmt: skip
    for signal, row in document["sample"].items():
        cells = (row["light_cut"], row["exposure_flicker"], row["exposure_moved_by_a_firefly"])
        lines.append(f"| {signal} | {' | '.join(f'{cell:.2%}' for cell in cells)} |")
    return {"sample": "\n".join(lines), "denoiser": denoisers, "operations": operations_table(document)}


def table(document: dict, model: str) -> str:
    """The cases of one model as Markdown; a broken promise is bold."""
    shown = [mode for mode in document["denoisers"][0]["models"][model] if mode != "training"]
    lines = [f"| case | promised | at most | {' | '.join(shown)} | not finite |", "|---" * (4 + len(shown)) + "|"]
    for row in document["denoisers"]:
        runs = row["models"][model]
        cells = [_cell(runs[mode]["value"], runs[mode]["kept"]) for mode in shown]
        bounds = sorted({runs[mode]["bound"] for mode in shown})
        counts = sum(run["non_finite"] for run in runs.values())
        promised = f"{row['promise']} ({row['unit']})"
        lines.append(
            f"| {row['case']} | {promised} | {', '.join(f'{b:g}' for b in bounds)} | {' | '.join(cells)} | {counts} |"
        )
    return "\n".join(lines)


def operations_table(document: dict) -> str:
    """The cases of the operations as Markdown: greatest differences from the promised values."""
    lines = [f"| case | promised | at most | {' | '.join(BACKENDS)} |", "|---" * (3 + len(BACKENDS)) + "|"]
    for row in document["operations"]:
        cells = [_cell(row["backends"][label], row["backends"][label] <= row["bound"]) for label in BACKENDS]
        lines.append(f"| {row['case']} | {row['promise']} | {row['bound']:g} | {' | '.join(cells)} |")
    return "\n".join(lines)


def _cell(value: float, kept: bool) -> str:
    text = f"{value:.2g}"
    return text if kept else f"**{text}**"


if __name__ == "__main__":
    harness.run(main, __doc__)
