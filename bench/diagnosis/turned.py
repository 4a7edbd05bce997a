"""What is it worth that history gives way where surfaces turn?

    render="bpyenv/bin/python examples/blender/render.py"
    $render shots/turntable --set turntable --frames 8
    $render shots/turntable-reference --set turntable --frames 8 --samples 256 --seed 77
    python bench/diagnosis/turned.py shots/turntable data/standard/{street,bathroom,window,outdoor,backdrop}

Sequences with references, or a folder of these beside each ("-reference"). PSNR over OIDN's at 1 sample a pixel, with
history as it is and with history that does not know of turns; for `hybrid` with other constants of `ops.turned`, too.
Writes bench/results/turned.json and the table of docs/notes/turned.md.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2]))  # this checkout, whatever rtdenoise is installed
from bench import DOCS, RESULTS, harness

# isort: split
import numpy as np
import torch
import tyro
from torch import Tensor

from rtdenoise import ops
from rtdenoise.baselines import Oidn
from rtdenoise.data.opening import open_sequence
from rtdenoise.data.sequences import Sequence
from rtdenoise.frame import Frame, Known
from rtdenoise.history import advanced, going_ahead
from rtdenoise.models import load, past
from rtdenoise.models.settled import settled
from rtdenoise.ops import turned
from rtdenoise.run.lookahead import SETTLES_FROM
from rtdenoise.sanitise import sanitise
from rtdenoise.splat import completed_shot

RESULT, PAGES = RESULTS / "turned.json", (DOCS / "notes" / "turned.md",)
FRAMES, SKIP = 12, 1  # of a sequence; the first has no history
MODELS = {  # name, frames ahead
    "`default`": ("default", 0),
    "`hybrid`": ("hybrid", 0),
    "`hybrid` with `--lookahead 2`": ("hybrid", 2),
    "`hybrid-large`": ("hybrid-large", 0),
}
WITHOUT, WITH = "history as before", "and turns"
CLEAN = "albedo and normal filtered first"
OTHERS = {  # of `hybrid`: TURNED_NOISE, TURNED_ANGLE
    "noise counts as a turn": (0.0, turned.TURNED_ANGLE),
    "half the angle": (turned.TURNED_NOISE, turned.TURNED_ANGLE / 2),
    "twice the angle": (turned.TURNED_NOISE, 2 * turned.TURNED_ANGLE),
}


def main(sequences: tyro.conf.Positional[tuple[Path, ...]]) -> None:
    rows = []
    for told, frames, peer in cases(sequences, rows):
        for label, (name, ahead) in MODELS.items():
            variants = {WITHOUT: (turned.TURNED_NOISE, math.inf), WITH: None}
            for variant, constants in (variants | (OTHERS if label == "`hybrid`" else {})).items():
                with knowing(constants):
                    found = errors(frames, pictures(frames, name, ahead))
                rows.append(told | {"model": label, "variant": variant} | leads(found, peer))
                print(rows[-1], flush=True)
    harness.publish(RESULT, {"rows": rows}, digits=4, pages=PAGES, tables=tables)


def cases(sequences: tuple[Path, ...], rows: list[dict]) -> Iterator[tuple[dict, list[Frame], dict]]:
    """What names a row, the frames, and the errors of OIDN's pictures, of each sequence and signal. To `rows` it adds
    OIDN with albedo and normal filtered first."""
    for folder in sequences:
        for signal in ("color", "indirect"):
            frames = with_references(folder, signal)
            if not frames:
                continue
            told, peer = {"sequence": folder.name, "signal": signal}, errors(frames, pictures_of_oidn(frames))
            clean = errors(frames, pictures_of_oidn(frames, clean=True))
            rows.append(told | {"model": "OIDN", "variant": CLEAN} | leads(clean, peer))
            yield told, frames, peer


def with_references(folder: Path, signal: str) -> list[Frame]:
    """Sanitised frames; none where there are no references of the signal."""
    beside = folder.with_name(f"{folder.name}-reference")
    if beside.is_dir():
        if signal != "color":
            return []
        return paired(open_sequence(folder), beside)
    sequence = open_sequence(folder, signal=signal, layers=("reference", "reference_half"))
    return [sanitise(sequence[i]) for i in range(min(FRAMES, len(sequence)))]


def paired(noisy: Sequence, references: Path | str) -> list[Frame]:
    """Sanitised frames with references; with halves of them, so that errors are corrected, where a folder of the same
    name and "-2" has them with other noise, of fewer samples or as many."""
    truths, beside = open_sequence(references), Path(f"{references}-2")
    others = open_sequence(beside) if beside.is_dir() else None
    found = []
    for i, (frame, truth) in enumerate(zip(noisy, truths, strict=True)):
        known = {"reference": truth.radiance}
        if others is not None:
            n, m, other = truths.header.samples, others.header.samples, others[i].radiance
            mean = (n * truth.radiance + m * other) / (n + m)
            apart = math.sqrt(n * m) / (n + m) * (truth.radiance - other)  # as two halves of all samples would be
            known = {"reference": mean, "reference_half": mean + apart}
        found.append(replace(sanitise(frame), **known))
    return found


@contextmanager
def knowing(constants: tuple[float, float] | None) -> Iterator[None]:
    """Turns found with other constants; None: with its own."""
    if constants is None:
        yield
        return
    own, use = (turned.TURNED_NOISE, turned.TURNED_ANGLE), past.turned
    turned.TURNED_NOISE, turned.TURNED_ANGLE = constants

    def plain(*images: Tensor) -> Tensor:
        with ops.use("plain"):
            return use(*images)

    past.turned = plain
    try:
        yield
    finally:
        (turned.TURNED_NOISE, turned.TURNED_ANGLE), past.turned = own, use


def pictures_of_oidn(frames: list[Frame], clean: bool = False) -> list[Tensor]:
    oidn = Oidn(clean=clean)
    return [oidn.step(oidn.prefiltered(frame) if clean else frame)[0] for frame in frames]


@torch.inference_mode()
def pictures(frames: list[Frame], name: str, ahead: int, **settings: object) -> list[Tensor]:
    """As `denoise --lookahead` has them. `settings`: attributes of the network."""
    network, history, found = load(name, precision="fp32"), None, []
    vars(network).update(settings)
    network.keeps_trust = settles = ahead >= SETTLES_FROM
    step = going_ahead(network.step)
    frames = completed_shot(frames)
    for i, frame in enumerate(frames):
        known = Known(ahead=tuple(frames[i + 1 : i + 1 + ahead - settles]), waits=ahead > 0)
        image, after = step(frame, history, known)
        found.append(image)
        if i and settles:
            found[i - 1] = settled(history, after, advanced(frame, frames[i - 1]))
        history = after
    return found


def errors(frames: list[Frame], images: list[Tensor]) -> dict[str, float | None]:
    return harness.psnr_of_regions(frames, dict([*enumerate(images)][SKIP:]))


def leads(found: dict[str, float | None], peer: dict[str, float | None]) -> dict[str, float | None]:
    return {key: None if None in (found[key], peer[key]) else found[key] - peer[key] for key in peer}


def tables(document: dict) -> dict[str, str]:
    """Section `turned`: the lead over OIDN on each sequence, beauty and indirect light."""
    return {"turned": table(document["rows"], WITH)}


def table(rows: list[dict], bold: str) -> str:
    """The leads of each model and variant; `bold`: the one that is used."""
    names = list(dict.fromkeys(row["sequence"] for row in rows))
    lines = [f"| | | mean | uncovered | {' | '.join(names)} |", "|---" * (len(names) + 4) + "|"]
    for model, variant in dict.fromkeys((row["model"], row["variant"]) for row in rows):
        mine = [row for row in rows if (row["model"], row["variant"]) == (model, variant)]
        seen = [row["uncovered"] for row in mine if row["uncovered"] is not None]
        cells = [f"{np.mean([row['frame'] for row in mine]):+.2f}", f"{np.mean(seen):+.2f}"]
        cells += [", ".join(f"{row['frame']:+.2f}" for row in mine if row["sequence"] == name) for name in names]
        label = f"**{variant}**" if variant == bold else variant
        lines.append(f"| {model} | {label} | {' | '.join(cells)} |")
    return "\n".join(lines)


if __name__ == "__main__":
    harness.run(main, __doc__)
