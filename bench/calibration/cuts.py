"""Choose `frame.MAX_CUT_MISMATCH`, the threshold of `history.mismatch` above which a frame begins another shot.

python bench/calibration/cuts.py CLIPS [CLIPS ...]    # training sets

Within shots: every pair of consecutive frames. Cuts: every frame of a clip after a frame of the next clip, keeping the
motion vectors of its own shot, as in spliced files. Mirrored cuts, the hard ones: every frame after its own mirror
image, so that depths, materials and brightness are alike. Jumps: pairs with frames left out within a shot; a
restart there is right if history no longer fits, so jumps are counted as neither right nor wrong.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2]))  # this checkout, whatever rtdenoise is installed
from bench import DOCS, RESULTS, harness

# isort: split
import torch
import tyro

from rtdenoise.data.clips import ClipDataset
from rtdenoise.frame import MAX_CUT_MISMATCH, Frame, geometry
from rtdenoise.history import mismatch

RESULT, PAGES = RESULTS / "cuts.json", (DOCS / "results" / "stability.md",)
THRESHOLDS = (0.1, 0.15, 0.2, 0.25, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9)
JUMP = 5  # frames from one frame of a pair to the next


def main(folder: tyro.conf.Positional[Path], more: tyro.conf.Positional[tuple[Path, ...]] = ()) -> None:
    folders = [folder, *more]
    clips = [data.load(i) for data in map(ClipDataset, folders) for i in range(len(data))]
    kinds: dict[str, list[float]] = {"within": [], "cut": [], "mirrored": [], "jump": []}
    for clip, other in zip(clips, clips[1:] + clips[:1], strict=True):
        for before, now in pairwise(clip):
            kinds["within"].append(_mismatch(now, before))
            kinds["mirrored"].append(_mismatch(now, _mirrored(before)))
        if clip[0].size == other[0].size:
            kinds["cut"] += [_mismatch(now, before) for now, before in zip(clip[1:], reversed(other), strict=False)]
        kinds["jump"] += [_mismatch(now, before) for before, now in zip(clip, clip[JUMP:], strict=False)]

    found = {kind: torch.tensor(values) for kind, values in kinds.items()}
    cuts = torch.cat([found["cut"], found["mirrored"]])
    rows = [
        {"threshold": t,
         "precision": _share(int((cuts > t).sum()), int((cuts > t).sum() + (found["within"] > t).sum())),
         "recall": _share(int((cuts > t).sum()), len(cuts)),
         "recall_mirrored": _share(int((found["mirrored"] > t).sum()), len(found["mirrored"])),
         "false_alarms": int((found["within"] > t).sum()),
         "jumps_found": _share(int((found["jump"] > t).sum()), len(found["jump"]))}
        for t in THRESHOLDS
    ]  # fmt: skip
    for row in rows:
        print(row)
    content = {
        "clips": len(clips),
        "used": MAX_CUT_MISMATCH,
        "pairs": {kind: len(values) for kind, values in found.items()},
        "mismatch": {
            kind: {"least": v.min().item(), "median": v.median().item(), "greatest": v.max().item()}
            for kind, v in found.items()
        },
        "rows": rows,
    }
    harness.publish(RESULT, content, pages=PAGES, tables=tables)


def tables(document: dict) -> dict[str, str]:
    """Section `cuts`: precision over all cuts, recall by kind; the threshold in use is bold."""
    pairs = document["pairs"]
    lines = [f"| threshold | false alarms in {pairs['within']} pairs | precision | recall | recall, mirrored only |",
             "|---|---|---|---|---|"]  # fmt: skip
    for row in document["rows"]:
        label = f"**{row['threshold']:g}**" if row["threshold"] == document["used"] else f"{row['threshold']:g}"
        shares = " | ".join(f"{row[key]:.1%}" for key in ("precision", "recall", "recall_mirrored"))
        lines.append(f"| {label} | {row['false_alarms']} | {shares} |")
    cuts = pairs["cut"] + pairs["mirrored"]
    lines.append(f"\n{document['clips']} clips; {cuts} cuts, {pairs['cut']} spliced and {pairs['mirrored']} mirrored.")
    return {"cuts": "\n".join(lines)}


def _mismatch(now: Frame, before: Frame) -> float:
    return mismatch(now, geometry(before)).item()


def _mirrored(frame: Frame) -> Frame:
    """The frame's mirror image: x reversed in the picture and in the normals."""
    mirrored = frame.map(lambda tensor: tensor.flip(3))
    return replace(mirrored, normal=mirrored.normal * torch.tensor([-1.0, 1.0, 1.0]).reshape(1, 3, 1, 1))


def _share(part: int, whole: int) -> float:
    return round(part / max(whole, 1), 4)


if __name__ == "__main__":
    harness.run(main, __doc__)
