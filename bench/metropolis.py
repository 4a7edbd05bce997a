"""Where does Metropolis sampling pay? Its rate, and its error against path tracing at equal time.

python bench/metropolis.py

Two caustic scenes and two plain ones. Times are processor seconds of one thread, so other programs on the machine
disturb them less. The time of Metropolis sampling has everything in it: the bootstrap and the recording of the step.
References: two independent halves, by Metropolis sampling in caustic scenes, where path tracing leaves fireflies in any
reference, and path traced in the others. Writes bench/results/metropolis.json, the tables, and a picture of a further
scene.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))  # this checkout, whatever rtdenoise is installed
from bench import DOCS, RESULTS, harness
from bench.harness.strips import encode

# isort: split
import numpy as np
import torch

from rtdenoise.color import display_exposure
from rtdenoise.files import write_atomically
from rtdenoise.metrics import image as metrics
from rtdenoise.render.frames import grey, radiance
from rtdenoise.render.metropolis import MetropolisOptions, metropolis
from rtdenoise.render.scenes.named import open_scene
from rtdenoise.render.stage import Stage, start_mitsuba
from rtdenoise.run.preview import strip

RESULT, PAGES = RESULTS / "metropolis.json", (DOCS / "results" / "metropolis.md",)
PICTURE = DOCS / "images" / "metropolis.webp"
PICTURED, PICTURE_SIZE = "caustic:1", 112
SCENES = {"caustic:2000000": "caustic", "caustic:2000002": "caustic", "sample": "plain", "procedural:3": "plain"}
SIGNALS = ("color", "indirect")
CHAINS = (1024, 4096)
REFERENCE_STREAM = 1000  # streams from here on make references
RESERVE = 32  # samples of path tracing that its time is measured with


def main(size: int = 64, mutations: tuple[int, ...] = (32,), runs: int = 2, reference: int = 192) -> None:
    """Measure, write the results and the picture.

    Args:
        size: Width and height in pixels.
        mutations: A pixel, of the comparisons at equal time.
        runs: Pictures of every kind, with other random numbers.
        reference: Mutations a pixel of the references; path traced ones have twice as many samples.
    """
    start_mitsuba(1)
    bench = Bench(size)
    rates, errors = [], []
    for name, kind in SCENES.items():
        bench.open(name)
        if name in ("caustic:2000000", "sample"):
            rates += [{"scene": name} | bench.rate(chains) for chains in CHAINS]
        references = bench.references(kind, reference)
        for count in mutations:
            errors += [{"scene": name, "kind": kind} | row for row in bench.compare(references, count, runs)]
        print(*(row for row in errors if row["scene"] == name), sep="\n", flush=True)
    bench = Bench(PICTURE_SIZE)
    bench.open(PICTURED)
    write_atomically(PICTURE, encode(bench.picture(bench.references("caustic", reference), mutations[-1])))
    content = {"size": size, "max_depth": bench.depth, "reference": reference, "rates": rates, "errors": errors}
    harness.publish(RESULT, content, digits=4, pages=PAGES, tables=tables)


class Bench:
    """A scene, rendered both ways."""

    depth = 8  # path edges

    def __init__(self, size: int):
        self.size, self.pixels = (size, size), size * size
        self.stage: Stage | None = None

    def open(self, name: str) -> None:
        self.stage = Stage(open_scene(name))
        self.path(2, 0), self.chains(1, 0)  # compiles

    def path(self, samples: int, stream: int) -> tuple[dict[str, np.ndarray], float]:
        """(layers, processor seconds)."""
        start = time.process_time()
        beauty, indirect = radiance(self.stage, 0, self.size, samples, 1, stream, self.depth)
        return {"color": beauty, "indirect": indirect}, time.process_time() - start

    def chains(self, mutations: int, stream: int, count: int = 0) -> tuple[dict[str, np.ndarray], float]:
        start = time.process_time()
        options = MetropolisOptions(chains=count)
        layers, _ = metropolis(self.stage, 0, self.size, mutations, 1, stream, self.depth, options)
        return layers, time.process_time() - start

    def rate(self, count: int) -> dict[str, float]:
        """Millions of samples and mutations a second of further ones, in turn; medians."""
        paths, chains, few, many = [], [], 8, 72
        self.chains(1, 0, count)  # warm
        for k in range(2):
            times = [self.path(n, k)[1] for n in (few, many)] + [self.chains(n, k, count)[1] for n in (few, many)]
            paths.append(1e-6 * self.pixels * (many - few) / (times[1] - times[0]))
            chains.append(1e-6 * self.pixels * (many - few) / (times[3] - times[2]))
        ratio = float(np.median(np.divide(chains, paths)))
        return {"chains": count, "path": float(np.median(paths)), "pssmlt": float(np.median(chains)), "ratio": ratio}

    def references(self, kind: str, mutations: int) -> tuple[dict, dict]:
        """Two independent halves."""
        made = (
            self.chains(mutations // 2, stream)[0] if kind == "caustic" else self.path(mutations, stream)[0]
            for stream in (REFERENCE_STREAM, REFERENCE_STREAM + 1)
        )
        return tuple(made)

    def compare(self, references: tuple[dict, dict], mutations: int, runs: int) -> list[dict]:
        """A row for each method and signal; path tracing gets the samples that fit into the time of the mutations."""
        chains = [self.chains(mutations, 100 + k) for k in range(runs)]
        seconds = float(np.mean([time for _, time in chains]))
        samples = max(round(seconds / self.seconds_per_sample()), 1)
        paths = [self.path(samples, 200 + k) for k in range(runs)]
        pictures = {"pssmlt": [layers for layers, _ in chains], "path": [layers for layers, _ in paths]}
        spent = {"pssmlt": seconds, "path": float(np.mean([time for _, time in paths]))}
        rows = []
        for method, made in pictures.items():
            for signal in SIGNALS:
                found = [errors_of(layers[signal], *(half[signal] for half in references)) for layers in made]
                rows.append({
                    "method": method, "signal": signal, "mutations": mutations, "seconds": spent[method],
                    "samples": mutations if method == "pssmlt" else samples,
                    **{key: float(np.mean([error[key] for error in found])) for key in found[0]},
                })  # fmt: skip
        return rows

    def seconds_per_sample(self) -> float:
        """Of path tracing, for a sample in every pixel."""
        return self.path(RESERVE, stream=60)[1] / RESERVE

    def picture(self, references: tuple[dict, dict], mutations: int):
        """Path tracing, Metropolis sampling and its parts at about equal time, and the reference."""
        layers, seconds = self.chains(mutations, 100)
        samples = max(round(seconds / self.seconds_per_sample()), 1)
        reference = (references[0]["color"] + references[1]["color"]) / 2
        images = {
            f"path tracing, {samples} spp": self.path(samples, 200)[0]["color"],
            f"PSSMLT, {mutations} mutations": layers["color"], "large steps": layers["large"],
            "small steps": layers["small"], "proposals": layers["proposals"], "reference": reference,
        }  # fmt: skip
        panels = {label: _tensor(np.kron(image, np.ones((2, 2, 1), np.float32))) for label, image in images.items()}
        return strip(panels, display_exposure(_tensor(reference)))


def errors_of(image: np.ndarray, first: np.ndarray, second: np.ndarray) -> dict[str, float]:
    """Errors against the mean of two half-references, and how alike neighbouring errors are.

    `correlation`: of (a − r)/(a + r), on luminance, between pixels one column apart; bounded, so no firefly rules it.
    """
    reference = (first + second) / 2
    a, r, half = _tensor(image), _tensor(reference), _tensor(first)
    scale = display_exposure(r)
    x, y = grey(image), grey(reference)
    error = (x - y) / (x + y + 1e-3 * y.mean())
    error = error - error.mean()
    return {
        "relmse": metrics.relmse(a, r, scale, reference_half=half),
        "psnr": metrics.psnr_corrected(a, r, scale, reference_half=half),
        "smape": metrics.smape(a, r, scale),
        "correlation": float((error[:, 1:] * error[:, :-1]).mean() / (error**2).mean()),
    }


def _tensor(image: np.ndarray) -> torch.Tensor:
    return torch.from_numpy(np.ascontiguousarray(image)).permute(2, 0, 1)[None]


# --- tables -----------------------------------------------------------------------------------------------------------


def tables(document: dict) -> dict[str, str]:
    """Sections `metropolis-rates` and `metropolis-errors`."""
    lines = ["| scene | chains | path tracing, M samples/s | PSSMLT, M mutations/s | ratio |", "|---" * 5 + "|"]
    for row in document["rates"]:
        judged = "met" if row["ratio"] >= 0.4 else "missed"
        lines.append(f"| {row['scene']} | {row['chains']} | {row['path']:.3f} | {row['pssmlt']:.3f} | "
                     f"{row['ratio']:.2f} (aim 0.4: {judged}) |")  # fmt: skip
    return {"metropolis-rates": "\n".join(lines), "metropolis-errors": _errors(document)}


def _errors(document: dict) -> str:
    lines = [
        "| scene, signal | mutations = samples in the same time | relMSE | corrected PSNR | SMAPE | correlation |",
        "|---" * 6 + "|",
    ]
    rows = document["errors"]
    for ours in (row for row in rows if row["method"] == "pssmlt"):
        key = ("scene", "signal", "mutations")
        other = next(r for r in rows if r["method"] == "path" and all(r[k] == ours[k] for k in key))
        cells = [f"{ours['scene']}, {ours['signal']}", f"{ours['samples']} = {other['samples']}"]
        cells += [_pair(other["relmse"], ours["relmse"], "{:.3f}"), _pair(other["psnr"], ours["psnr"], "{:.2f}", -1)]
        cells += [_pair(other["smape"], ours["smape"], "{:.3f}")]
        cells += [f"{other['correlation']:.2f}, {ours['correlation']:.2f}"]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def _pair(path: float | None, ours: float | None, form: str, sign: int = 1) -> str:
    """Both values, the better one bold."""
    if path is None or ours is None:
        return ", ".join("–" if value is None else form.format(value) for value in (path, ours))
    better = sign * ours < sign * path
    first, second = form.format(path), form.format(ours)
    return f"{first}, **{second}**" if better else f"**{first}**, {second}"


if __name__ == "__main__":
    harness.run(main, __doc__)
