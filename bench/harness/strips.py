"""Strips of pictures: noisy | OIDN | setting A | ours | reference, each above its most uncovered part, enlarged."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import torch
from PIL import Image
from torch import Tensor
from torch.nn import functional as F

from rtdenoise.data.exr import read_channels
from rtdenoise.run.preview import strip

ENLARGED = 4  # times, by repeating pixels
GAP = 4  # rows between a frame and its detail
MAX_BYTES = 36_000  # of a strip: the repository holds them
MAX_WIDTH = 1640  # pixels; wider strips are scaled down
QUALITIES = range(80, 20, -5)  # of WebP, tried in this order until a strip is small enough


def draw(evaluation: Path, name: str, sequence: dict, methods: dict[str, str], out: Path) -> None:
    """Write the strip of a sequence's first still from the folder of an evaluation; `sequence` are its facts there."""
    still = evaluation / "pictures" / name / f"{sequence['stills'][0]:04d}"
    out.parent.mkdir(parents=True, exist_ok=True)
    out.write_bytes(encode(compose(still, methods, sequence["exposure"])))


def compose(still: Path, methods: dict[str, str], exposure: float) -> Image.Image:
    """One panel per method and one of the reference, from a frame's folder of pictures that `evaluate` wrote.

    `methods`: label -> name; methods without a picture are left out. An outline marks the most uncovered part, which
    lies below each frame, enlarged `ENLARGED` times.
    """
    planes = read_channels(still / "reference.exr", ["uncovered.V"])
    top, left, height, width = most_uncovered(planes["uncovered.V"])
    files = {label: still / f"{name}.exr" for label, name in (methods | {"reference": "reference"}).items()}
    panels = {
        label: _panel(_read(path), (top, left, height, width), 1 / exposure)
        for label, path in files.items()
        if path.is_file()
    }
    return strip(panels, exposure)


def most_uncovered(mask: np.ndarray) -> tuple[int, int, int, int]:
    """(top, left, height, width) of the window, 1 / `ENLARGED` as high and wide as `mask` [H, W], that holds most of
    it; of equal ones the most central."""
    height, width = (side // ENLARGED for side in mask.shape)
    shares = F.avg_pool2d(torch.from_numpy(mask)[None, None].float(), (height, width), stride=1)[0, 0]
    best = (shares >= shares.max() - 1e-6).nonzero().float()
    top, left = best[(best - best.mean(0)).square().sum(1).argmin()].int().tolist()
    return top, left, height, width


def encode(picture: Image.Image) -> bytes:
    """WebP of at most `MAX_BYTES`, in the best quality that fits, or else in the lowest of QUALITIES."""
    picture = picture.copy()
    picture.thumbnail((MAX_WIDTH, picture.height))
    for quality in QUALITIES:
        encoded = io.BytesIO()
        picture.save(encoded, "WEBP", quality=quality, method=6)
        if encoded.tell() <= MAX_BYTES:
            break
    return encoded.getvalue()


def _read(path: Path) -> Tensor:
    planes = read_channels(path, list("RGB"))
    return torch.from_numpy(np.stack([planes[c] for c in "RGB"]))[None]


def _panel(image: Tensor, part: tuple[int, int, int, int], white: float) -> Tensor:
    """The image `[1, 3, H, W]` with the part outlined, above that part enlarged."""
    top, left, height, width = part
    detail = image[..., top : top + height, left : left + width]
    detail = detail.repeat_interleave(ENLARGED, -2).repeat_interleave(ENLARGED, -1)
    outlined = image.clone()
    outlined[..., [top, top + height - 1], left : left + width] = white
    outlined[..., top : top + height, [left, left + width - 1]] = white
    missing = image.shape[-1] - detail.shape[-1]  # columns, where ENLARGED does not divide the width
    detail = F.pad(detail, (0, missing), value=white)
    gap = torch.full((*image.shape[:2], GAP, image.shape[-1]), white)
    return torch.cat([outlined, gap, detail], dim=-2)
