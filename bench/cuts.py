"""Cuts that no layer tells: how well `history.mismatch` finds them, by its threshold.

    python bench/cuts.py CLIPS [CLIPS ...]        (folders of `rtdenoise render --clips`)

Within shots: every pair of consecutive frames. Cuts: every frame of a clip after one of the next clip, with the motion
vectors that it has in its own shot, which is what files spliced together look like. Hard cuts: every frame after its
own picture seen in a mirror, so that depths, materials and brightness are alike. Jumps: frames left out within a shot,
for which starting anew is right in so far as history no longer fits; they are counted, and neither right nor wrong.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import harness
import torch

from rtdenoise.data.clips import ClipDataset
from rtdenoise.frame import MAX_CUT_MISMATCH, Frame, History
from rtdenoise.history import mismatch

RESULT = harness.ROOT / "bench" / "results" / "cuts.json"
THRESHOLDS = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9)
JUMP = 5  # frames


def main(folders: list[Path]) -> None:
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
    document = {
        **harness.origin({"torch": harness.cpu()}),
        "clips": len(clips),
        "used": MAX_CUT_MISMATCH,
        "pairs": {kind: len(values) for kind, values in found.items()},
        "mismatch": {
            kind: {"least": v.min().item(), "median": v.median().item(), "greatest": v.max().item()}
            for kind, v in found.items()
        },
        "rows": rows,
    }
    harness.write(RESULT, **document)
    harness.insert_all(tables(document))


def tables(document: dict) -> dict[str, str]:
    """What docs/stability.md has of this: precision over all cuts, recall by kind; the threshold in use is bold."""
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
    return mismatch(now, History(before.radiance, before.motion_next, before.depth, before.normal)).item()


def _mirrored(frame: Frame) -> Frame:
    """The scene seen in a mirror at its left border: x turned round, in the picture and in the normals."""
    mirrored = frame.map(lambda tensor: tensor.flip(3))
    return replace(mirrored, normal=mirrored.normal * torch.tensor([-1.0, 1.0, 1.0]).reshape(1, 3, 1, 1))


def _share(part: int, whole: int) -> float:
    return round(part / max(whole, 1), 4)


if __name__ == "__main__":
    main([Path(argument) for argument in sys.argv[1:]])
