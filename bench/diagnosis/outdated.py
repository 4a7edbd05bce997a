"""What is it worth that the previous picture gives way where light has changed?

    render="bpyenv/bin/python examples/blender/render.py"
    $render shots/flicker --set flicker --frames 8                  # likewise evening
    $render shots/flicker-reference --set flicker --frames 8 --samples 256 --seed 77
    python bench/diagnosis/outdated.py shots/{flicker,evening} data/standard/{street,bathroom,window,outdoor,backdrop}

Sequences with references, or a folder of these beside each ("-reference"). PSNR over OIDN's at 1 sample a pixel: of
single frames, with history as it is, and with history that does not know of `ops.outdated`. Writes
bench/results/outdated.json and the table of docs/notes/outdated.md.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2]))  # this checkout, whatever rtdenoise is installed
from bench import DOCS, RESULTS, harness

# isort: split
import torch
import tyro
from torch import Tensor

from bench.diagnosis.turned import cases, errors, leads, pictures, pictures_of_oidn, table
from rtdenoise.frame import Frame
from rtdenoise.models import load, past
from rtdenoise.run.passes import InMemory, Passes

RESULT, PAGES = RESULTS / "outdated.json", (DOCS / "notes" / "outdated.md",)
MODELS = {  # name, frames ahead
    "`fast`": ("fast", 0),
    "`default`": ("default", 0),
    "`hybrid`": ("hybrid", 0),
    "`hybrid` with `--lookahead 2`": ("hybrid", 2),
    "`hybrid-large`": ("hybrid-large", 0),
}
ALONE, WITHOUT, WITH = "single frames", "history as before", "and what is outdated"


def main(sequences: tyro.conf.Positional[tuple[Path, ...]]) -> None:
    rows = []
    for told, frames, peer in cases(sequences, rows):
        for label, (name, ahead) in MODELS.items():
            if not ahead:
                add(rows, told | {"model": label, "variant": ALONE}, frames, singles(frames, name), peer)
            with ignored():
                add(rows, told | {"model": label, "variant": WITHOUT}, frames, pictures(frames, name, ahead), peer)
            add(rows, told | {"model": label, "variant": WITH}, frames, pictures(frames, name, ahead), peer)
        with ignored():
            add(rows, told | {"model": "`--offline`", "variant": WITHOUT}, frames, offline(frames), peer)
        add(rows, told | {"model": "`--offline`", "variant": WITH}, frames, offline(frames), peer)
    harness.publish(RESULT, {"rows": rows}, digits=4, pages=PAGES, tables=tables)


def add(rows: list[dict], told: dict, frames: list[Frame], images: list[Tensor], peer: dict) -> None:
    rows.append(told | leads(errors(frames, images), peer))
    print(rows[-1], flush=True)


@contextmanager
def ignored() -> Iterator[None]:
    """Nothing is outdated."""
    use = past.outdated
    past.outdated = lambda found, agree, frames: torch.zeros_like(agree)
    try:
        yield
    finally:
        past.outdated = use


@torch.inference_mode()
def singles(frames: list[Frame], name: str) -> list[Tensor]:
    network = load(name, precision="fp32")
    return [network.step(frame)[0] for frame in frames]


def offline(frames: list[Frame], name: str = "hybrid", **settings: object) -> list[Tensor]:
    """`settings`: attributes of `Passes` and of its network."""
    passes = Passes(name)
    for part in (passes, passes.backend.network):
        vars(part).update(settings)
    passes, history, images = InMemory(passes), None, []
    for frame in frames:
        _, history = passes.step(frame, history)
    for _ in frames:
        image, history = passes.step(None, history)
        images.append(image)
    return images


METHODS = {  # of other scripts: what runs over frames, a picture each
    "OIDN, albedo and normal filtered first": lambda frames: pictures_of_oidn(frames, clean=True),
    "`hybrid`, single frames": lambda frames: singles(frames, "hybrid"),
    "`default`": lambda frames: pictures(frames, "default", 0),
    "`hybrid`": lambda frames: pictures(frames, "hybrid", 0),
    "`hybrid` with `--lookahead 2`": lambda frames: pictures(frames, "hybrid", 2),
    "`hybrid-large`": lambda frames: pictures(frames, "hybrid-large", 0),
    "`hybrid-large` with `--lookahead 2`": lambda frames: pictures(frames, "hybrid-large", 2),
    "`--offline`": offline,
}


def tables(document: dict) -> dict[str, str]:
    """Section `outdated`: the lead over OIDN on each sequence, beauty and indirect light."""
    return {"outdated": table(document["rows"], WITH)}


if __name__ == "__main__":
    harness.run(main, __doc__)
