"""Errors of `hybrid` on shots with a part of it as it is, and in other ways, and their table."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from unittest.mock import patch

from bench.diagnosis.outdated import singles
from bench.diagnosis.turned import errors, paired, pictures, pictures_of_oidn, with_references
from rtdenoise.frame import Frame
from rtdenoise.run.choice import open_chosen
from rtdenoise.run.options import Options

MODES = {"in real time": 0, "two frames ahead": 2}


def read(shot: Path) -> list[Frame]:
    """Sanitised frames with references: shots of Cycles as `denoise` reads them, beauty of other sequences."""
    if not Path(f"{shot}-reference").is_dir():
        return with_references(shot, "color")
    return paired(open_chosen(str(shot), Options())[0], f"{shot}-reference")


def compared(
    shots: tuple[Path, ...],
    part: ModuleType | type,
    ways: dict[str, dict],
    facts: Callable[[list[Frame]], dict] = lambda frames: {},
) -> list[dict]:
    """Errors of OIDN and of `hybrid`, with each of these values of names of a part. `facts` of a shot are in its rows,
    and columns of the table."""
    rows = []
    for shot in shots:
        frames = read(shot)
        told = {"shot": shot.name} | facts(frames)
        rows.append(told | {"method": "OIDN"} | errors(frames, pictures_of_oidn(frames)))
        rows.append(told | {"method": "hybrid", "way": "single frames"} | errors(frames, singles(frames, "hybrid")))
        for mode, ahead in MODES.items():
            for way, values in ways.items():
                with patch.multiple(part, **values):
                    found = errors(frames, pictures(frames, "hybrid", ahead))
                rows.append(told | {"method": mode, "way": way} | found)
                print(rows[-1], flush=True)
    return rows


def table(document: dict, *facts: str) -> str:
    """What was `compared`: these facts, then frame and uncovered, as dB more than OIDN."""
    found = {(row["shot"], row["method"], row.get("way")): row for row in document["rows"]}
    keys = [key for key in dict.fromkeys((method, way) for _, method, way in found) if key[0] != "OIDN"]
    names = [*facts, *(way if method == "hybrid" else f"{method}, {way}" for method, way in keys)]
    lines = [f"| | {' | '.join(names)} |", "|---" * (len(names) + 1) + "|"]
    for shot in dict.fromkeys(shot for shot, *_ in found):
        peer = found[shot, "OIDN", None]
        regions = [x for x in ("frame", "uncovered") if peer[x] is not None and math.isfinite(peer[x])]
        cells = [f"{peer[fact]:.2f}" for fact in facts]
        cells += [", ".join(f"{found[shot, *key][x] - peer[x]:+.2f}" for x in regions) for key in keys]
        lines.append(f"| `{shot}` | {' | '.join(cells)} |")
    return "\n".join(lines)
