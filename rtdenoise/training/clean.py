"""Cleaner references for training: each is denoised by Intel Open Image Denoise.

At dozens of samples a pixel a filter removes most of the remaining noise in milliseconds, where a path tracer needs
four times the samples to halve it (docs/notes/clean.md has figures). Not for evaluation: such references reward methods
as smooth as the filter.
"""

from __future__ import annotations

import importlib.metadata
from collections.abc import Callable
from pathlib import Path

import torch
from torch import Tensor

from ..baselines.oidn import Oidn
from ..data.clip_file import LEAD_IN, OPTIONAL, read_facts, read_layers, write_clip
from ..data.clips import ClipDataset
from ..data.layers import SIGNALS
from ..errors import InputError
from ..files import lock, read_bytes, remove_unfinished, utf8, write_atomically
from ..frame import Frame

CARD = """# Training clips with cleaned references

The clips of another folder, {count} of them. References: {cleaned} (Intel Open Image Denoise), with
albedo and normal of many samples where the clips have them. Both halves are the whole reference here: they say nothing
about its error. For training, not for validation. The rest is as it was, and so are its licences:

"""


def clean(folder: Path, out: Path, progress: Callable[[int, int], None] = lambda done, total: None) -> int:
    """Write the clips of `folder` to `out` with cleaned references; returns their number. Existing clips are kept.

    Raises InputError where there are no clips, `out` is `folder`, holds other clips or is being written to, a clip was
    cleaned before, or `pyoidn` is missing.
    """
    out = Path(out)
    if out.resolve() == Path(folder).resolve():
        raise InputError(f"{out}: is where the clips are; their own references are needed for validation")
    paths = ClipDataset(folder).paths
    out.mkdir(parents=True, exist_ok=True)
    with lock(out):
        remove_unfinished(out)
        return _clean_all(Path(folder), paths, out, progress)


def _clean_all(folder: Path, paths: list[Path], out: Path, progress: Callable[[int, int], None]) -> int:
    oidn = Oidn(prefilter=True)
    if more := {path.name for path in out.glob("clip_*.safetensors")} - {path.name for path in paths}:
        raise InputError(f"{out / min(more)}: is not the cleaned clip of one in {folder}, and training would take it; "
                         "remove it, or choose another --out")  # fmt: skip
    missing = [path for path in paths if not _is_there(path, out / path.name)]
    for done, path in enumerate(missing):
        progress(done, len(missing))
        _clean(path, out / path.name, oidn)
    progress(len(missing), len(missing))
    card = CARD.format(count=len(paths), cleaned=read_facts(out / paths[0].name)["references"])
    described = folder / "DATA.md"
    write_atomically(out / "DATA.md", utf8(card) + (read_bytes(described) if described.is_file() else b""))
    return len(missing)


def _is_there(path: Path, out: Path) -> bool:
    """Whether `out` is the cleaned clip of `path`. Raises InputError where it is another clip."""
    if not out.exists():
        return False
    found = read_facts(out)
    if "references" not in found or {k: v for k, v in found.items() if k != "references"} != read_facts(path):
        raise InputError(f"{out}: is not the cleaned clip of {path}; choose another --out")
    return True


def _clean(path: Path, out: Path, oidn: Oidn) -> None:
    facts = read_facts(path)
    if "references" in facts:
        raise InputError(f"{path}: its references are denoised already; give the folder that was rendered")
    layers = {name: torch.from_numpy(layer) for name, layer in read_layers(path).items()}
    signals = [name for name, signal in SIGNALS.items() if signal["radiance"] in layers]
    for signal in map(SIGNALS.get, signals):
        cleaned = layers[signal["reference"]]
        for i in range(facts.get(LEAD_IN, 0), len(cleaned)):
            cleaned[i] = _filtered(layers, signal["reference"], i, oidn)[0]
        layers[signal["reference_half"]] = cleaned
    frames = [
        {key: layer[i].permute(1, 2, 0).numpy() for key, layer in layers.items()} for i in range(len(layers["depth"]))
    ]
    facts |= {"references": f"denoised by pyoidn {importlib.metadata.version('pyoidn')}, features prefiltered"}
    write_clip(out, frames, facts, [name for name in OPTIONAL if name in layers], signals)


def _filtered(layers: dict[str, Tensor], reference: str, i: int, oidn: Oidn) -> Tensor:
    features = (name if (name := f"{key}_reference") in layers else key for key in ("albedo", "normal"))
    radiance, albedo, normal, depth = (layers[key][i : i + 1] for key in (reference, *features, "depth"))
    return oidn.step(Frame(radiance, albedo=albedo, normal=normal, depth=depth))[0]
