"""How much should the network's history count beside OIDN's picture?

python bench/diagnosis/trust.py SEQ ...    # sequences with references that no network was trained on

Of frames on disk (`--offline`, every third frame): corrected PSNR over OIDN's with other shares, with and without
trust. Writes bench/results/trust.json and the table of docs/notes/trust.md.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2]))  # this checkout, whatever rtdenoise is installed
from bench import DOCS, RESULTS, harness

# isort: split
import numpy as np
import torch
import tyro
from torch import Tensor

from rtdenoise.baselines import Oidn
from rtdenoise.evaluate.inputs import Source
from rtdenoise.frame import Frame, reverse
from rtdenoise.run import combination
from rtdenoise.run.passes import Passes
from rtdenoise.run.sides import corrected
from rtdenoise.sanitise import sanitise
from rtdenoise.splat import completed

RESULT, PAGES = RESULTS / "trust.json", (DOCS / "notes" / "trust.md",)
FRAMES, EVERY = 16, 3  # of a sequence; they take long
KIND = "offline"  # of the rows; older ones are of a mode that is gone
OFFLINE = {  # the network's share, whether trust counts
    "0.32 of the network, 0.68 of OIDN": (0.32, False),
    "as far as each pass trusts its history": (0.32, True),
    "0.2 of the network": (0.2, False),
    "**0.2 as far as each pass trusts its history**": (0.2, True),
    "OIDN alone": (0.0, False),
}
Pictures = dict[int, Tensor]  # number of a frame -> denoised


def main(sequences: tyro.conf.Positional[tuple[Path, ...]]) -> None:
    rows = []
    for folder in sequences:
        for signal in ("color", "indirect"):
            source = Source.open(folder, signal, "auto", FRAMES)
            frames = source.frames(source.spp)
            if frames[0].reference_half is None:
                continue
            told = {"sequence": source.name, "signal": signal, "kind": KIND}
            rows += [told | row for row in offline(frames)]
            print(rows[-1], flush=True)
    harness.publish(RESULT, {"rows": rows}, digits=4, pages=PAGES, tables=tables)


@torch.inference_mode()
def offline(frames: list[Frame]) -> list[dict]:
    """A row for each of `OFFLINE`, and OIDN, of some of the frames."""
    passes, alone = Passes("default", "cpu", "fp32"), Oidn()
    prepared = [sanitise(frame) for frame in frames]
    prepared = [completed(*pair) for pair in zip(prepared, [*prepared[1:], None], strict=True)]
    forward, history = [], None
    for frame in prepared:
        estimate, history = passes.step(frame, history)
        forward.append(estimate)
    images: dict[str, Pictures] = {name: {} for name in ("oidn", *OFFLINE)}
    history = None
    for i in reversed(range(len(frames))):
        frame = prepared[i]
        backward, history = passes.step(reverse(frame), history)
        if i % EVERY == 1:
            images["oidn"][i] = alone.step(frame)[0]
            found = passes.candidates(frame, forward[i], backward)
            for name, (share, trusts) in OFFLINE.items():
                weights = (share, share, -share, 1 - share)
                combination.WEIGHTS = dict(zip(combination.WEIGHTS, weights, strict=True))
                image = combination.combine(found if trusts else replace(found, trust_forward=1.0, trust_backward=1.0))
                images[name][i] = corrected(frame, image.image, forward[i], backward)
    return [{"variant": name} | harness.psnr_of_regions(frames, some) for name, some in images.items()]


def tables(document: dict) -> dict[str, str]:
    """Section `trust-offline`: a line a variant, the mean and the least lead over OIDN."""
    names = list(dict.fromkeys(row["sequence"] for row in document["rows"]))
    lines = [f"| | mean | least | uncovered | least | {' | '.join(names)} |", "|---" * (len(names) + 5) + "|"]
    rows = {(r["sequence"], r["signal"], r["variant"]): r for r in document["rows"] if r["kind"] == KIND}
    for variant in OFFLINE:
        leads: dict[str, list[tuple[str, float]]] = {"frame": [], "uncovered": []}
        for (sequence, signal, name), row in rows.items():
            peer = rows[sequence, signal, "oidn"]
            for region, found in leads.items():
                if name == variant and None not in (row[region], peer[region]):
                    found.append((sequence, row[region] - peer[region]))
        cells = []
        for found in leads.values():
            values = [lead for _, lead in found]
            cells += [f"{np.mean(values):+.2f}", f"{min(values):+.2f}"]
        cells += [", ".join(f"{lead:+.2f}" for sequence, lead in leads["frame"] if sequence == name) for name in names]
        lines.append(f"| {variant} | {' | '.join(cells)} |")
    return {"trust-offline": "\n".join(lines)}


if __name__ == "__main__":
    harness.run(main, __doc__)
