"""The report as one HTML file that needs nothing else: template, style, scripts, numbers and pictures."""

from __future__ import annotations

import base64
import html
import importlib.util
from dataclasses import asdict
from importlib import resources
from pathlib import Path

import numpy as np
import torch
from PIL import Image

from ..data.exr import read_channels
from ..errors import InputError
from ..evaluate.document import Document
from ..files import dumps
from ..metrics import flip_map
from . import readings
from .budgets import comparisons
from .pictures import encode_map, encode_motion, encode_picture, pack

ASSETS = resources.files("rtdenoise") / "report" / "assets"
SCRIPTS = (
    "format.js", "marks.js", "verdict.js", "chart.js", "scatter.js", "tables.js", "lines.js", "picture.js",
    "playback.js", "compare.js", "main.js",
)  # fmt: skip
PEERS = 2  # families beside ours that are played


def page(
    data: dict, document: Document, folder: Path, pictures: tuple[str, ...] = (), sequences: tuple[str, ...] = ()
) -> str:
    """The page for `data` (`payload`), with the pictures in `folder` of these methods and sequences (empty: all)."""
    blobs = _pictures(document, folder, pictures, sequences)
    strips = _strips(document, folder, pictures, sequences)
    data = data | {
        "pictures": {name: sorted({key.split("/")[1] for key in found}) for name, found in blobs.items()},
        "playback": {name: [key.split("/")[1] for key in found] for name, found in strips.items()},
    }
    parts = [
        f'<script type="text/plain" data-key="{html.escape(key)}">{blob}</script>'
        for found in (*blobs.values(), *strips.values())
        for key, blob in found.items()
    ]
    scripts = "\n".join((ASSETS / name).read_text(encoding="utf-8") for name in SCRIPTS)
    return (
        (ASSETS / "report.html").read_text(encoding="utf-8")
        .replace("/*STYLE*/", (ASSETS / "report.css").read_text(encoding="utf-8"))
        .replace("<!--PICTURES-->", "\n".join(parts))
        .replace("/*DATA*/", pack(dumps(data, digits=4, separators=(",", ":")).encode()))
        .replace("/*SCRIPTS*/", scripts)
    )  # fmt: skip


def payload(document: Document) -> dict:
    """All numbers of the page: the measurements, and the readings of them. Raises InputError without results."""
    if not document.results:
        raise InputError("nothing to report: no method was measured; evaluation.json says why each was left out")
    rows = sorted(document.results, key=lambda row: list(document.methods).index(row["method"]))  # variants together
    rows += readings.pooled(rows, document.sequences)
    readings.mark_fronts(rows, document.sequences, document.methods)
    us = readings.speaks_for_us(rows, document.methods)
    lost, won = readings.losses_and_wins(document.results, document.methods, us)
    return {
        "signal": document.signal,
        "pool": readings.POOL,
        "ours": us,
        "metrics": {name: asdict(metric) for name, metric in readings.METRICS.items()},
        "methods": document.methods,
        "sequences": document.sequences,
        "sample_ms": {
            name: readings.sample_of(name, document.sequences) for name in (readings.POOL, *document.sequences)
        },
        "rows": [
            {k: v for k, v in row.items() if k != "fingerprint"}
            | {"label": readings.label(row), "frames": _columns(row["frames"])}
            for row in rows
        ],
        "lost": lost,
        "won": won,
        "comparisons": comparisons(rows, document.methods, document.sequences, us),
        "skipped": document.skipped,
        "runs": document.runs,
    }


def _columns(frames: list[dict]) -> dict:
    """Errors of single frames as region -> metric -> list, and the frame numbers.

    Four digits, and only the metrics of the verdict: the rest would be most of the page.
    """
    found: dict = {"number": [frame["number"] for frame in frames]}
    for region in readings.REGIONS if frames else ():
        drawn = [m for m in (*readings.HEADLINE, "psnr_corrected") if m in frames[0][region]]
        found[region] = {m: [_shortened(frame[region].get(m)) for frame in frames] for m in drawn}
    return found


def _shortened(value: float | None) -> float | None:
    return None if value is None else float(f"{value:.4g}")


def _pictures(
    document: Document, folder: Path, wanted: tuple[str, ...], sequences: tuple[str, ...]
) -> dict[str, dict[str, str]]:
    """sequence -> "sequence/label/kind" -> encoded; kinds are image, flip, motion and uncovered."""
    found: dict[str, dict[str, str]] = {}
    for name, sequence in document.sequences.items():
        still = folder / "pictures" / name / f"{sequence['stills'][0]:04d}"
        truth = _read(still / "reference.exr", "RGB")
        if truth is None or (sequences and name not in sequences):
            continue
        exposure, blobs = sequence["exposure"], {}
        blobs[f"{name}/reference/image"] = encode_picture(truth, exposure)
        blobs[f"{name}/reference/motion"] = encode_motion(_read(still / "reference.exr", ("motion.X", "motion.Y")))
        blobs[f"{name}/reference/uncovered"] = encode_map(_read(still / "reference.exr", ("uncovered.V",))[..., 0])
        for method in wanted or document.methods:
            image, label = _read(still / f"{method}.exr", "RGB"), _label(document, name, method)
            if image is not None:
                blobs[f"{name}/{label}/image"] = encode_picture(image, exposure)
                if importlib.util.find_spec("flip_evaluator"):
                    blobs[f"{name}/{label}/flip"] = encode_map(_flip(image, truth, exposure))
        found[name] = blobs
    return found


def _strips(
    document: Document, folder: Path, wanted: tuple[str, ...], sequences: tuple[str, ...]
) -> dict[str, dict[str, str]]:
    """sequence -> "sequence/label/strip" -> WebP of its frames; of noisy, `PEERS` of other families, ours and the
    reference unless `wanted` says otherwise."""
    found: dict[str, dict[str, str]] = {}
    for name, sequence in document.sequences.items():
        if "playback" not in sequence or (sequences and name not in sequences):
            continue
        size = (
            sequence["playback"]["window"][3],
            len(sequence["playback"]["frames"]) * sequence["playback"]["window"][2],
        )
        paths = {
            method: folder / "playback" / name / f"{method}.webp"
            for method in (*(wanted or _to_play(document, name)), "reference")
        }
        blobs = {
            f"{name}/{_label(document, name, method)}/strip": base64.b64encode(path.read_bytes()).decode()
            for method, path in paths.items()
            if path.is_file() and _size(path) == size  # an older run may have kept fewer frames
        }
        if f"{name}/reference/strip" in blobs and len(blobs) > 1:
            found[name] = blobs
    return found


def _to_play(document: Document, sequence: str) -> list[str]:
    """noisy, the best methods of `PEERS` other families by PSNR, and our network."""
    rows = [row for method in document.methods if (row := document.pictured(sequence, method))]
    psnr = {row["method"]: row["errors"]["frame"].get("psnr") or 0.0 for row in rows}
    best: dict[str, str] = {}  # family -> method
    for method in sorted(psnr, key=psnr.get, reverse=True):
        best.setdefault(document.methods[method]["family"], method)
    ours = readings.speaks_for_us(rows, document.methods)
    ours = next((row["method"] for row in rows if readings.label(row) == ours), None)
    peers = sorted((m for f, m in best.items() if f not in ("input", "network", "ablation")), key=psnr.get)[-PEERS:]
    return [name for name in ("noisy" if "noisy" in psnr else None, *peers, ours) if name]


def _label(document: Document, sequence: str, method: str) -> str:
    """Of the result that the pictures of a method show."""
    row = document.pictured(sequence, method)
    return readings.label(row) if row else method


def _size(path: Path) -> tuple[int, int]:
    with Image.open(path) as image:
        return image.size


def _read(path: Path, channels: tuple[str, ...] | str) -> np.ndarray | None:
    """`[H, W, C]`; None where there is no such file."""
    if not path.is_file():
        return None
    planes = read_channels(path, list(channels))
    return np.stack([planes[name] for name in channels], axis=-1)


def _flip(image: np.ndarray, truth: np.ndarray, exposure: float) -> np.ndarray:
    a, r = (torch.from_numpy(x).permute(2, 0, 1)[None] for x in (image, truth))
    return flip_map(a, r, exposure)[0, 0].numpy()
