"""What is it worth to take fireflies out of the picture, where history does not know them?

    render="bpyenv/bin/python examples/blender/render.py"
    $render shots/turntable --set turntable --frames 8     # likewise all other sets; --samples 16 for turntable-16
    $render shots/turntable-reference --set turntable --frames 8 --samples 128 --seed 77
    python bench/diagnosis/fireflies.py shots/{turntable,ocean,…} data/standard/{street,bathroom,…}

Shots of Cycles, read as `denoise` reads them, with a folder of references beside each ("-reference"), and sequences
with references. PSNR over OIDN's of all frames but the first, with fireflies and without: at 1 sample a pixel of
`hybrid` and `hybrid-large`, two frames ahead, and of `--offline`; of shots of more samples of `hybrid-large-many`,
whose fireflies stay. Writes bench/results/fireflies.json and the tables of docs/notes/fireflies.md.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2]))  # this checkout, whatever rtdenoise is installed
from bench import DOCS, RESULTS, harness

# isort: split
import numpy as np
import tyro

from bench.diagnosis.outdated import offline
from bench.diagnosis.turned import errors, leads, paired, pictures, pictures_of_oidn, with_references
from rtdenoise.frame import Frame
from rtdenoise.run.choice import CLEAN, open_chosen
from rtdenoise.run.options import AHEAD, Options

RESULT, PAGES = RESULTS / "fireflies.json", (DOCS / "notes" / "fireflies.md",)
FEW, OFFLINE, MANY = ("hybrid", CLEAN[0]), "--offline", CLEAN[1]


def main(sequences: tyro.conf.Positional[tuple[Path, ...]]) -> None:
    rows = []
    for told, frames, samples in cases(sequences):
        peer = errors(frames, pictures_of_oidn(frames))
        for model in (MANY,) if samples > 1 else (*FEW, OFFLINE):
            for kept in (True, False):
                how = {"keeps_fireflies": kept}
                images = offline(frames, **how) if model == OFFLINE else pictures(frames, model, AHEAD, **how)
                found = errors(frames, images)
                rows.append(told | {"samples": samples, "model": model, "fireflies": kept} | leads(found, peer))
                print(rows[-1], flush=True)
    harness.publish(RESULT, {"rows": rows}, digits=4, pages=PAGES, tables=tables)


def cases(sequences: tuple[Path, ...]) -> Iterator[tuple[dict, list[Frame], int]]:
    """What names a row, the frames, and their samples a pixel, of each sequence and signal."""
    for folder in sequences:
        beside = folder.with_name(f"{folder.name}-reference")
        if beside.is_dir():
            sequence, _, _ = open_chosen(str(folder), Options())
            told = {"sequence": folder.name, "signal": "color"}
            yield told, paired(sequence, beside), int(sequence.header.samples)
            continue
        for signal in ("color", "indirect"):
            yield {"sequence": folder.name, "signal": signal}, with_references(folder, signal), 1


def tables(document: dict) -> dict[str, str]:
    """Sections `fireflies` and `fireflies-many`: what it gains on each sequence, frame and uncovered."""
    gains = {}
    for row in document["rows"]:
        key = row["sequence"], row["signal"], row["samples"]
        of_model = gains.setdefault(key, {}).setdefault(row["model"], {})
        of_model[row["fireflies"]] = [np.nan if row[k] is None else row[k] for k in ("frame", "uncovered")]
    few = [(key, of) for key, of in gains.items() if key[2] == 1]
    many = [(key, of) for key, of in gains.items() if key[2] > 1]
    return {"fireflies": table(few, (*FEW, OFFLINE)), "fireflies-many": table(many, (MANY,))}


def table(gains: list[tuple[tuple, dict]], models: tuple[str, ...]) -> str:
    lines = [f"| | {' | '.join(f'`{model}`' for model in models)} |", "|---" * (len(models) + 1) + "|"]
    every = []
    for (name, signal, _), of in gains:
        every.append([np.subtract(of[model][False], of[model][True]) for model in models])
        lines.append(f"| `{name}`{', indirect light' if signal == 'indirect' else ''} | {cells(every[-1])} |")
    return "\n".join([*lines, f"| **mean** | {cells(np.nanmean(every, axis=0))} |"])


def cells(found: list[np.ndarray]) -> str:
    return " | ".join(", ".join("–" if np.isnan(x) else f"{x:+.2f}" for x in pair) for pair in found)


if __name__ == "__main__":
    harness.run(main, __doc__)
