"""Does what is bright, dark or of a pure colour keep its light?

python bench/diagnosis/extremes.py                     # synthetic frames: nothing to be downloaded
python bench/diagnosis/extremes.py --before FILE       # beside what an older checkout's run wrote

Even light with the noise of one sample a pixel, four frames that stand still: the light that each method leaves, as a
share of what is there. Writes bench/results/extremes.json and the table of docs/notes/hybrid.md.
"""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2]))  # this checkout, whatever rtdenoise is installed
from bench import DOCS, RESULTS, harness

# isort: split
import torch
from torch import Tensor

from rtdenoise.baselines import Oidn
from rtdenoise.frame import Frame
from rtdenoise.models import load

RESULT, PAGES = RESULTS / "extremes.json", (DOCS / "notes" / "hybrid.md",)
SIZE = H, W = 180, 320
FRAMES, INSET = 4, 4  # pixels from an edge that are not looked at
METHODS = {"OIDN": None, "`default`": ("default", "fp32"), "`hybrid`": ("hybrid", "fp32"),
           "`hybrid`, int8": ("hybrid", "int8"), "`hybrid-large`": ("hybrid-large", "fp32"),
           "`hybrid-large`, int8": ("hybrid-large", "int8")}  # fmt: skip
PRIMARIES = {"red": 0, "green": 1, "blue": 2}


def cases() -> dict[str, tuple[Tensor, tuple[slice, slice]]]:
    """Name -> the light `[1, 3, H, W]`, and where it is looked at."""
    found, walls = {}, {0.0: "before nothing", 1e-6: "10⁻⁶ behind", 1e-4: "10⁻⁴ behind", 1e-2: "10⁻² behind"}
    for side in (16, 40):
        for behind, where in walls.items():
            light = torch.full((1, 3, H, W), behind)
            light[..., 60 : 60 + side, 100 : 100 + side] = 1.0
            inside = slice(60 + INSET, 60 + side - INSET), slice(100 + INSET, 100 + side - INSET)
            found[f"{side}×{side} pixels of 1, {where}"] = light, inside
    for dark in (1e-2, 1e-4):
        light = torch.ones(1, 3, H, W)
        light[..., : W // 5] = dark
        found[f"a fifth of the frame {dark:g}, the rest 1"] = light, (slice(None), slice(INSET, W // 5 - INSET))
    for name, channel in PRIMARIES.items():
        light = torch.zeros(1, 3, H, W)
        light[:, channel] = 1.0
        found[f"pure {name}"] = light, (slice(None), slice(None))
    return found


def main(before: Path | None = None) -> None:
    torch.set_num_threads(1)
    networks = {name: load(what[0], precision=what[1]) if what else Oidn() for name, what in METHODS.items()}
    rows = []
    for case, (light, place) in cases().items():
        torch.manual_seed(0)
        frames = [noisy(light) for _ in range(FRAMES)]
        row = {"case": case}
        for name, network in networks.items():
            history = None
            for frame in frames:
                with torch.inference_mode():
                    image, history = network.step(frame, history)
            row[name] = (image[..., *place].mean() / light[..., *place].mean()).item()
        rows.append(row)
    content = {"rows": rows}
    if before is not None:
        older = harness.read(before)
        content["before"] = {"commit": older["commit"], "rows": older["rows"]}
    harness.publish(RESULT, content, digits=3, pages=PAGES, tables=tables)


def noisy(light: Tensor) -> Frame:
    """A still frame with this light, whose noise is as large as it is."""
    flat = torch.zeros(1, 1, H, W)
    still, normal = torch.cat([flat, flat], 1), torch.cat([flat, flat, flat + 1], 1)
    lit = light.mean(1, keepdim=True) == light.mean(1, keepdim=True).max()
    radiance = light * torch.empty(1, 1, H, W).exponential_()
    return Frame(radiance, albedo=torch.full_like(light, 0.8), normal=normal, depth=torch.where(lit, 4.0, 8.0),
                 motion=still, motion_next=still)  # fmt: skip


def tables(document: dict) -> dict[str, str]:
    before = {row["case"]: row for row in document.get("before", {}).get("rows", [])}
    lines = ["| | " + " | ".join(METHODS) + " |", "|---" * (len(METHODS) + 1) + "|"]
    for row in document["rows"]:
        older = before.get(row["case"], row)
        cells = [
            f"{row[name]:.2f}" + (f" ({older[name]:.2f})" if abs(row[name] - older[name]) >= 0.02 else "")
            for name in METHODS
        ]
        lines.append(f"| {row['case']} | {' | '.join(cells)} |")
    return {"extremes": "\n".join(lines)}


if __name__ == "__main__":
    harness.run(main, __doc__)
