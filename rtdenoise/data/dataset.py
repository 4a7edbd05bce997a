"""Training clips on disk: one safetensors file a clip, written atomically, read in slices. Needs no renderer.

`clip_000123.safetensors` holds tensors `[T, C, H, W]`: float16 radiance, albedo and normal; float32 depth and motions
(half precision would cost subpixels); uint8 id. Its header carries the clip's facts as JSON under "clip".
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save

from rtdenoise.errors import InputError
from rtdenoise.frame import Frame

RADIANCE = ("color", "indirect", "reference", "indirect_reference", "reference_half", "indirect_reference_half")
DTYPES = {"depth": np.float32, "motion": np.float32, "motion_next": np.float32, "id": np.uint8}
SIGNALS = {
    "color": {"radiance": "color", "reference": "reference", "reference_half": "reference_half"},
    "indirect": {
        "radiance": "indirect", "reference": "indirect_reference", "reference_half": "indirect_reference_half",
    },
}  # fmt: skip
FEATURES = ("albedo", "normal", "depth", "motion", "motion_next", "id")


def clip_path(folder: Path, index: int) -> Path:
    return Path(folder) / f"clip_{index:06d}.safetensors"


def write_clip(path: Path, frames: list[Mapping[str, np.ndarray]], facts: Mapping) -> None:
    """Write consecutive frames, layers [H, W, C] each, under the names that `RADIANCE` and `FEATURES` list."""
    tensors = {}
    for name in (*RADIANCE, *FEATURES):
        stacked = np.stack([frame[name] for frame in frames]).transpose(0, 3, 1, 2)
        dtype = DTYPES.get(name, np.float16)
        if dtype is np.float16:
            limit = float(np.finfo(np.float16).max)
            stacked = np.clip(stacked, -limit, limit)
        tensors[name] = np.ascontiguousarray(stacked, dtype)
        if not np.isfinite(tensors[name]).all():
            raise ValueError(f"{path}: {name} is not finite")
    write_atomically(path, save(tensors, metadata={"clip": json.dumps(dict(facts))}))


def write_atomically(path: Path, content: bytes) -> None:
    """The file appears under its name only when it is complete."""
    temporary = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        temporary.write_bytes(content)
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


def read_facts(path: Path) -> dict:
    """The facts of a clip: seed, samples, uncovered share and so on."""
    with _opened(path) as clip:
        return json.loads(clip.metadata()["clip"])


class ClipDataset:
    """The clips of a folder, in the order of their names."""

    def __init__(self, folder: str | Path):
        self.paths = sorted(Path(folder).glob("clip_*.safetensors"))
        if not self.paths:
            raise InputError(f"{folder}: no clips found; expected files clip_000000.safetensors and so on")

    def __len__(self) -> int:
        return len(self.paths)

    def facts(self, index: int) -> dict:
        return read_facts(self.paths[index])

    def load(
        self,
        index: int,
        *,
        signal: str = "color",  # color | indirect
        size: int | tuple[int, int] | None = None,  # of the window, (height, width); None: the whole image
        frames: int | None = None,  # how many consecutive ones; None: all
        rng: np.random.Generator | None = None,  # draws window and first frame; None: centre and first
    ) -> list[Frame]:
        """Consecutive frames of clip `index`, tensors [1, C, H, W] float32, of one random window; no more is read."""
        path = self.paths[index]
        if signal not in SIGNALS:
            raise InputError(f"unknown signal '{signal}'; expected {' or '.join(SIGNALS)}")
        with _opened(path) as clip:
            length, _, height, width = clip.get_slice("color").get_shape()
            count = length if frames is None else frames
            window = (height, width) if size is None else (size, size) if isinstance(size, int) else size
            if count > length or window[0] > height or window[1] > width:
                raise InputError(f"{path}: expected at least {count} frames of {window[1]}×{window[0]}, "
                                 f"found {length} of {width}×{height}")  # fmt: skip
            room = (length - count, height - window[0], width - window[1])
            first, top, left = rng.integers(0, room, endpoint=True) if rng else (0, room[1] // 2, room[2] // 2)
            layers = SIGNALS[signal] | {name: name for name in FEATURES}
            time, rows, columns = (
                slice(start, start + length)
                for start, length in zip((first, top, left), (count, *window), strict=True)
            )
            tensors = {field: clip.get_slice(layer)[time, :, rows, columns].float() for field, layer in layers.items()}
        return [
            Frame(**{field: t[i : i + 1] for field, t in tensors.items()}, number=int(first) + i, name=path.name)
            for i in range(count)
        ]


def _opened(path: Path):
    try:
        return safe_open(path, framework="pt")
    except (SafetensorError, OSError) as error:
        raise InputError(f"{path}: not a readable clip ({error}); delete it and render it again") from error


def write_card(folder: Path, command: str) -> dict:
    """`dataset.json` and `DATA.md` for the clips that are in the folder now. Returns what was written."""
    folder = Path(folder)
    facts = [read_facts(path) for path in ClipDataset(folder).paths]
    shares = np.array([f["uncovered"] for f in facts])
    first = facts[0]
    card = {
        "clips": len(facts),
        "frames_per_clip": first["frames"],
        "size": first["size"],
        "seeds": [min(f["seed"] for f in facts), max(f["seed"] for f in facts)],
        "command": command,
        "spp": first["spp"],
        "reference_spp": {"min": min(f["reference_spp"] for f in facts), "max": max(f["reference_spp"] for f in facts),
                          "mean": float(np.mean([f["reference_spp"] for f in facts]))},
        "uncovered_share": {"mean": float(shares.mean()), "clips_above_1.5%": float((shares > 0.015).mean())},
        "kinds": {k: sum(f["kind"] == k for f in facts) for k in sorted({f["kind"] for f in facts})},
        "seconds": float(sum(f["seconds"] for f in facts)),
        "versions": first["versions"],
    }  # fmt: skip
    write_atomically(folder / "dataset.json", json.dumps(card, indent=2).encode())
    write_atomically(folder / "DATA.md", _card_text(card).encode())
    return card


def _card_text(card: dict) -> str:
    height, width = card["size"]
    spp, share = card["reference_spp"], card["uncovered_share"]
    return f"""# Training clips

{card["clips"]} clips of {card["frames_per_clip"]} frames, {width}×{height}, procedural scenes {card["seeds"][0]} to
{card["seeds"][1]}: closed rooms, half-open rooms and open ground with textured surfaces, moving objects and cameras.
Made by `{card["command"]}` in {card["seconds"] / 3600:.1f} CPU-core hours. Everything in them is generated by the
program: no third-party data, no licence but the program's own.

- noisy frames: {card["spp"]} sample(s) a pixel
- references: {spp["min"]} to {spp["max"]} samples a pixel (mean {spp["mean"]:.0f}), more for noisier scenes;
  the mean of two independent halves, of which the first is stored (second = 2 × mean − first)
- moving objects uncover {100 * share["mean"]:.1f} % of the pixels a frame on average, and more than 1.5 % in
  {100 * share["clips_above_1.5%"]:.0f} % of the clips
- kinds: {", ".join(f"{n} {k}" for k, n in card["kinds"].items())}
- versions: {", ".join(f"{k} {v}" for k, v in card["versions"].items())}
- tensors `[T, C, H, W]` and conventions: `rtdenoise/data/dataset.py`, `rtdenoise/frame.py`
"""
