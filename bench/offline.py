"""Is the offline mode worth its time? And with which weights does it combine its candidates?

python bench/offline.py SEQ ...          # sequences with references that no network was trained on
python bench/offline.py --fit SEQ ...    # the weights, by least squares on other sequences

Measures OIDN, `default` and `offline` on every sequence and both signals, over the frame and in uncovered regions, and
the time of each; writes bench/results/offline.json, the tables of docs/results/offline.md, and
docs/images/offline/SEQ.webp, a strip of beauty. The aims: corrected PSNR
over OIDN's by 2.5 dB on average and 1.5 dB on each, by 1 dB in uncovered regions of each, corrected tPSNR by 2.5 dB.

`--fit` prints weights for `rtdenoise/run/combination.py`: those with the least squared error on the display transform,
with the sum 1 and the same weight for both directions in time.
"""

from __future__ import annotations

import math
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))  # this checkout, whatever rtdenoise is installed
from bench import DOCS, RESULTS, ROOT, harness
from bench.harness import strips

# isort: split
import numpy as np
import torch
import tyro

from rtdenoise.color import display, display_exposure
from rtdenoise.data.opening import open_sequence
from rtdenoise.evaluate.options import EvaluateOptions
from rtdenoise.evaluate.run import run
from rtdenoise.frame import Frame, reverse
from rtdenoise.run import combination
from rtdenoise.run.passes import Passes
from rtdenoise.sanitise import sanitise
from rtdenoise.splat import completed

RESULT, PAGES = RESULTS / "offline.json", (DOCS / "results" / "offline.md",)
OUT, PICTURES = ROOT / "out" / "offline", DOCS / "images" / "offline"
SIGNALS = ("indirect", "color")
OFFLINE, ALONE = "offline", "offline-without-oidn"
METHODS = ("oidn", "default", ALONE, OFFLINE)
SHOWN = {"OIDN": "oidn", "default": "default", "offline": "offline"}
METRICS = ("psnr", "psnr_corrected", "mse_corrected", "flip", "tpsnr", "tpsnr_corrected")
REGIONS = ("frame", "uncovered")
AIMS = {
    ("frame", "psnr_corrected"): (2.5, 1.5),
    ("uncovered", "psnr_corrected"): (None, 1.0),
    ("frame", "tpsnr_corrected"): (2.5, None),
    ("frame", "tpsnr"): (2.5, None),
}
"""(region, metric) -> gain over OIDN in dB: on average, on each sequence and signal."""
FITTED = 16  # frames of a sequence, at most
MIN_UNCOVERED = 500  # pixels in all frames together: fewer say nothing about uncovered regions


def main(sequences: tyro.conf.Positional[tuple[str, ...]] = (), fit: bool = False) -> None:
    """Measure, or fit.

    Args:
        sequences: Folders of EXR files with references.
        fit: Print weights that suit the sequences best, and measure nothing.
    """
    if fit:
        return fit_weights(sequences)
    documents = {
        signal: run(sequences, OUT / signal, EvaluateOptions(METHODS, metrics=METRICS, signal=signal))
        for signal in SIGNALS
    }
    rows = []
    for signal, document in documents.items():
        for row in document.results:
            facts = document.sequences[row["sequence"]]
            rows.append({
                "signal": signal, "sequence": row["sequence"], "method": row["method"], "frames": len(facts["frames"]),
                "size": facts["size"], "ms": row["ms"]["median"],
                "uncovered_pixels": facts["uncovered_share"] * math.prod(facts["size"]) * (len(facts["frames"]) - 1),
                **{region: {m: row["errors"][region][m] for m in METRICS} for region in REGIONS},
            })  # fmt: skip
    for name, facts in documents["color"].sequences.items():
        strips.draw(OUT / "color", name, facts, SHOWN, PICTURES / f"{name}.webp")
    harness.publish(RESULT, {"weights": combination.WEIGHTS, "rows": rows}, digits=5, pages=PAGES, tables=tables)


# --- tables -----------------------------------------------------------------------------------------------------------


def tables(document: dict) -> dict[str, str]:
    """Sections `offline-aims`, `offline-aims-alone`, without OIDN, and `offline`."""
    return {"offline-aims": _aims(document, OFFLINE), "offline-aims-alone": _aims(document, ALONE),
            "offline": _all(document)}  # fmt: skip


def _aims(document: dict, method: str) -> str:
    """A line for each aim."""
    lines = ["| gain over OIDN | average | aim | least | aim |", "|---" * 5 + "|"]
    names = {"psnr_corrected": "corrected PSNR", "tpsnr_corrected": "corrected tPSNR", "tpsnr": "tPSNR"}
    for (region, metric), (average, least) in AIMS.items():
        gains = [gain for pair in _pairs(document, method) if (gain := _gain(*pair, region, metric)) is not None]
        cells = [_judged(float(np.mean(gains)), average), _judged(min(gains), least)]
        lines.append(f"| {names[metric]}, {region} | {' | '.join(cells)} |")
    times = [pair[0]["ms"] / pair[1]["ms"] for pair in _pairs(document, method)]
    lines.append(f"| time as a multiple of OIDN's | {np.median(times):.1f}× | – | {min(times):.1f}× | – |")
    return "\n".join(lines)


def _judged(value: float, aim: float | None) -> str:
    if aim is None:
        return f"{value:+.2f} dB | –"
    return f"{value:+.2f} dB | {aim} dB: {'met' if value >= aim else 'missed'}"


def _all(document: dict) -> str:
    lines = [
        "| sequence, signal | frames | method | corrected PSNR | gain | uncovered | gain | FLIP "
        "| corrected tPSNR | gain |",
        "|---" * 10 + "|",
    ]
    for ours, oidn in _pairs(document, OFFLINE):
        for row in (oidn, *(harness.beside(document, ours, name) for name in ("default", ALONE)), ours):
            gains = [_gain(row, oidn, region, metric) for region, metric in AIMS]
            shown = ["–" if row is oidn or gain is None else f"{gain:+.2f}" for gain in gains]
            frame, uncovered = row["frame"], row["uncovered"]
            hidden = _number(uncovered["psnr_corrected"]) if gains[1] is not None else "–"
            cells = [
                f"{row['sequence']}, {row['signal']}", str(row["frames"]), f"`{row['method']}`",
                _number(frame["psnr_corrected"]), shown[0], hidden, shown[1], f"{frame['flip']:.3f}",
                _number(frame["tpsnr_corrected"]), shown[2],
            ]  # fmt: skip
            lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def _pairs(document: dict, method: str) -> list[tuple[dict, dict]]:
    """(method, OIDN) of every sequence and signal."""
    ours = [row for row in document["rows"] if row["method"] == method]
    return [(row, harness.beside(document, row, "oidn")) for row in ours]


def _gain(row: dict, peer: dict, region: str, metric: str) -> float | None:
    values = row[region][metric], peer[region][metric]
    few = region == "uncovered" and row["uncovered_pixels"] < MIN_UNCOVERED
    return None if None in values or few else values[0] - values[1]


def _number(value: float | None) -> str:
    return "–" if value is None else f"{value:.2f}"


# --- fit --------------------------------------------------------------------------------------------------------------


@torch.inference_mode()
def fit_weights(sequences: tuple[str, ...]) -> None:
    """Print the weights with the least squared error, every sequence and signal counting alike."""
    passes = Passes(device="cpu")
    names = list(combination.WEIGHTS)
    gram, vector = np.zeros((len(names), len(names))), np.zeros(len(names))
    for folder in sequences:
        for signal in SIGNALS:
            frames = list(open_sequence(folder, signal=signal, layers=("reference",)))[:FITTED]
            scale = display_exposure(torch.cat([frame.reference for frame in frames]))
            shown = [_shown(c, names, scale) for c in candidates(passes, frames)]
            inputs, truth = np.concatenate(shown), _values([frame.reference for frame in frames], scale)
            weight = 1 / np.mean((inputs[:, names.index("opinion")] - truth) ** 2) / len(truth)
            gram, vector = gram + weight * inputs.T @ inputs, vector + weight * inputs.T @ truth
    print(dict(zip(names, (round(w, 2) for w in solve(gram, vector, names)), strict=True)))


def candidates(passes: Passes, frames: list[Frame]) -> list[combination.Candidates]:
    """Of every frame of a shot."""
    frames = [sanitise(frame) for frame in frames]
    forward, history = [], None
    for frame in frames:
        estimate, history = passes.step(frame, history)
        forward.append(estimate)
    found, history = [], None
    for i in reversed(range(len(frames))):
        frame = completed(frames[i], *frames[i + 1 : i + 2])
        backward, history = passes.step(reverse(frame), history)
        found.insert(0, passes.candidates(frame, forward[i], backward))
    return found


def solve(gram: np.ndarray, vector: np.ndarray, names: list[str]) -> list[float]:
    """Least squares with the sum 1 and equal weights of forward and backward pass."""
    free = [name for name in names if name != "backward"]
    spread = np.array([[float(name == f or (name, f) == ("backward", "forward")) for f in free] for name in names])
    count, total = len(free), spread.sum(0)
    system = np.zeros((count + 1, count + 1))
    system[:count, :count], system[count, :count], system[:count, count] = spread.T @ gram @ spread, total, total
    found = np.linalg.solve(system, np.append(spread.T @ vector, 1))[:count]
    return [float(weight) for weight in spread @ found]


def _shown(found: combination.Candidates, names: list[str], scale: torch.Tensor) -> np.ndarray:
    return np.stack([_values([getattr(found, name)], scale) for name in names], axis=-1)


def _values(images: list[torch.Tensor], scale: torch.Tensor) -> np.ndarray:
    return display(torch.cat(images), scale).double().flatten().numpy()


if __name__ == "__main__":
    harness.run(main, __doc__)
