"""Choose the default parameters of the baselines on validation clips.

python bench/calibration/tune_baselines.py CLIPS    # a set that no model was trained on

Every fourth clip, indirect light, a coarse grid. The greatest mean PSNR over the frame wins: one objective for all
methods. Each stage starts from the best of the stage before, so that the grids for edges and for history are not
multiplied. Clamping is searched over usual windows and ranges: small k with large windows turns history into a box
filter of the current frame, which gains PSNR but no longer accumulates.
"""

from __future__ import annotations

import sys
from dataclasses import asdict, replace
from itertools import product
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2]))  # this checkout, whatever rtdenoise is installed
from bench import RESULTS, harness

# isort: split
import tyro

from rtdenoise.baselines import Accumulate, Svgf, Trmv
from rtdenoise.data.clips import ClipDataset
from rtdenoise.evaluate import METRICS, REGIONS
from rtdenoise.frame import Frame

EVERY = 4  # one clip in EVERY is used
EDGES = {"sigma_l": (4.0, 8.0, 16.0, 32.0), "sigma_n": (4.0, 16.0, 64.0), "sigma_z": (1.0, 3.0, 10.0)}
HISTORY = {"alpha": (0.1, 0.2, 0.4), "clamp": (None, 1.0, 2.0)}
GRIDS = {
    "accumulate-clamped": (Accumulate(clamp=1.0), [{"clamp": (0.5, 1.0, 1.5, 2.0), "window": (3, 5)}]),
    "svgf": (Svgf(), [EDGES, HISTORY]),
    "trmv": (Trmv(), [EDGES, HISTORY]),
}


def main(folder: tyro.conf.Positional[Path]) -> None:
    clips = ClipDataset(folder)
    chosen = range(0, len(clips), EVERY)
    sequences = [clips.load(index, signal="indirect") for index in chosen]
    results = {}
    for name, (best, stages) in GRIDS.items():
        tried = []
        for stage in stages:
            stage_tried = []
            for values in product(*stage.values()):
                parameters = dict(zip(stage, values, strict=True))
                candidate = replace(best, **parameters)
                errors = mean_errors(candidate, sequences)
                stage_tried.append((candidate, errors))
                print(name, parameters, errors["frame"], flush=True)
            best = max(stage_tried, key=lambda pair: round(pair[1]["frame"]["psnr"], 2))[0]  # the first of equals
            tried += stage_tried
        print(name, "chosen:", best)
        results[name] = {
            "chosen": asdict(best),
            "tried": [{"parameters": asdict(candidate), "errors": errors} for candidate, errors in tried],
        }
    objective = "mean PSNR of the frame, to 0.01 dB"
    content = {"clips": list(chosen), "signal": "indirect", "objective": objective, "results": results}
    harness.publish(RESULTS / "tune_baselines.json", content)


def mean_errors(method, sequences: list[list[Frame]]) -> dict[str, dict[str, float]]:
    """region -> metric -> mean error over the sequences."""
    means = harness.mean_errors(method.step, sequences, METRICS, REGIONS)
    return {region: {metric: round(means[region][metric], 4) for metric in METRICS} for region in REGIONS}


if __name__ == "__main__":
    harness.run(main, __doc__)
