"""The data card of a folder of clips: `dataset.json` for programs, `DATA.md` for people."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from ..data.clip_file import LEAD_IN, read_facts
from ..data.clips import ClipDataset
from ..errors import InputError
from ..files import utf8, write_atomically
from ..wording import counted
from .options import CAUSTIC

COMPOSED = "composition of assets"  # source of clips of a library
PROCEDURAL_SCENES = """closed rooms, half-open rooms
and open ground with textured surfaces, moving objects and cameras"""
CAUSTIC_SCENES = """closed rooms
with glass, plastic and metal objects under small lamps"""
GENERATED = "program"  # source of clips without third-party data
IN_EVERY_CLIP = (
    "frames", "size", "generator", "seed", "spp", "reference_spp", "uncovered", "kind", "seconds", "versions"
)  # fmt: skip
"""Facts that `render_clips` writes whatever its options."""


def write_card(folder: Path, command: str) -> dict:
    """Write the card for the clips that are in the folder now. Returns the content of `dataset.json`.

    Raises InputError where one was not rendered here, but cut from a shot, say.
    """
    folder, facts = Path(folder), []
    for path in ClipDataset(folder).paths:
        facts.append(read_facts(path))
        if missing := [name for name in IN_EVERY_CLIP if name not in facts[-1]]:
            raise InputError(f"{path}: was not rendered by rtdenoise clips, as it does not tell its "
                             f"{', '.join(missing)}; move it to a folder of its own")  # fmt: skip
    shares = np.array([f["uncovered"] for f in facts])
    first = facts[0]
    card = {
        "clips": len(facts),
        "frames_per_clip": _range([f["frames"] for f in facts]),
        LEAD_IN: first.get(LEAD_IN, 0),
        "size": first["size"],
        "generators": sorted({f["generator"] for f in facts}),
        "seeds": [min(f["seed"] for f in facts), max(f["seed"] for f in facts)],
        "command": command,
        "spp": _range([f["spp"] for f in facts]),
        "reference_spp": _spread([f["reference_spp"] for f in facts]),
        "uncovered_share": {"mean": float(shares.mean()), "clips_above_1.5%": float((shares > 0.015).mean())},
        "sunlit": sum("sun_through" in f for f in facts),
        "kinds": _counts(f["kind"] for f in facts),
        "seconds": float(sum(f["seconds"] for f in facts)),
        "versions": first["versions"],
        "sources": _counts(f.get("source", GENERATED) for f in facts),
        "licences": {f["source"]: f["licence"] for f in facts if f.get("licence")},
        "pictures": _pictures([f["pictures"] for f in facts if "pictures" in f]),
        "assets": {name: entry for f in facts for name, entry in f.get("assets", {}).items()},
        "skipped_assets": {name: reason for f in facts for name, reason in f.get("skipped", {}).items()},
    }
    chosen = [f for f in facts if "chosen" in f]
    if chosen:
        card["windows"] = {
            "chosen_where_something_happens": float(np.mean([f["chosen"] == "activity" for f in chosen])),
            "uncovered_share_of_whole_pictures": float(np.mean([f["view_uncovered"] for f in chosen])),
        }
        card["reference_error"] = _spread([f["reference_error"] for f in chosen])
    write_atomically(folder / "dataset.json", json.dumps(card, indent=2).encode())
    write_atomically(folder / "DATA.md", utf8(_text(card)))
    return card


def _pictures(used: list[dict]) -> dict[str, dict]:
    """Folder of pictures -> count of clips that show some, names of the files, licence."""
    return {
        folder: {
            "clips": sum(u["folder"] == folder for u in used),
            "files": sorted({name for u in used if u["folder"] == folder for name in u["files"]}),
            "licence": next(u["licence"] for u in used if u["folder"] == folder),
        }
        for folder in sorted({u["folder"] for u in used})
    }


def _range(values: list[int]) -> int | list[int]:
    """The value of all clips, or the smallest and the largest."""
    low, high = min(values), max(values)
    return low if low == high else [low, high]


def _spread(values: list[float]) -> dict[str, float]:
    return {"min": min(values), "max": max(values), "mean": float(np.mean(values))}


def _counts(names) -> dict[str, int]:
    names = list(names)
    return {name: names.count(name) for name in sorted(set(names))}


def _text(card: dict) -> str:
    height, width = card["size"]
    spp, share = card["reference_spp"], card["uncovered_share"]
    scenes = {name: count for name, count in card["sources"].items() if name not in (GENERATED, COMPOSED)}
    first, last = card["seeds"]
    lead_in = f" after {card[LEAD_IN]} without references" if card[LEAD_IN] else ""
    clips, frames = counted(card["clips"], "clip"), card["frames_per_clip"]
    frames = counted(frames, "frame") if isinstance(frames, int) else f"{_span(frames)} frames"
    text = f"""# Training clips

{clips} of {frames}{lead_in}, {width}×{height}, seeds {first} to {last}.
{_scenes(card)}
Made by `{card["command"]}` in {card["seconds"] / 3600:.1f} CPU-core hours.

- noisy frames: {_span(card["spp"])} sample(s) a pixel
- references: {spp["min"]} to {spp["max"]} samples a pixel (mean {spp["mean"]:.0f}), more for noisier scenes;
  the mean of two independent halves, of which the first is stored (second = 2 × mean − first)
- moving objects uncover {100 * share["mean"]:.1f} % of the pixels a frame on average, and more than 1.5 % in
  {100 * share["clips_above_1.5%"]:.0f} % of the clips
"""
    if windows := card.get("windows"):
        error, whole = card["reference_error"], windows["uncovered_share_of_whole_pictures"]
        chosen, times = 100 * windows["chosen_where_something_happens"], share["mean"] / max(whole, 1e-9)
        text += f"""- windows of larger pictures: {chosen:.0f} % chosen where most is uncovered, the rest at random;
  uncovered pixels are {times:.1f} times as frequent as in the whole pictures ({100 * whole:.1f} %)
- relative squared error of the references, as estimated before rendering them:
  {error["min"]:.4f} to {error["max"]:.4f} (mean {error["mean"]:.4f})
"""
    if card["sunlit"]:
        text += f"""- {card["sunlit"]} clips have a sun, closed rooms a side less for it; some have windows,
  and all their lamps are black
"""
    text += f"""- kinds: {", ".join(f"{n} {k}" for k, n in card["kinds"].items())}
- versions: {", ".join(f"{k} {v}" for k, v in card["versions"].items())}
- tensors `[T, C, H, W]` and conventions: `rtdenoise/data/clip_file.py`, `rtdenoise/frame.py`
"""
    if scenes:
        lines = (f"- {name}: {counted(count, 'clip')}\n" for name, count in scenes.items())
        text += "\n## Scenes by others\n\n" + "".join(lines)
    for name, licence in card["licences"].items():
        text += f"\n### {name}\n\n{licence.strip()}\n"
    text += _asset_credits(card)
    for folder, pictures in card["pictures"].items():
        files = ", ".join(pictures["files"])
        licence = pictures["licence"].strip() or "No LICENSE.txt lay in the folder: find out before passing clips on."
        text += f"\n## Pictures from {folder}\n\nIn {counted(pictures['clips'], 'clip')}: {files}\n\n{licence}\n"
    return text


def _scenes(card: dict) -> str:
    """The kinds of scenes in the clips."""
    lines = []
    if generated := card["sources"].get(GENERATED, 0):
        generators = ", ".join(map(str, card["generators"]))
        shown = CAUSTIC_SCENES if card["generators"] == [CAUSTIC] else PROCEDURAL_SCENES
        lines.append(f"{generated} are of procedural scenes (generator {generators}): {shown}. {_origin(card)}")
    if composed := card["sources"].get(COMPOSED, 0):
        lines.append(f"""{composed} are of rooms, streets, table tops, gardens and showrooms composed of other people's
models, environment maps and pictures, named below with their authors.""")
    return "\n".join(lines)


def _span(value: int | list[int]) -> str:
    return f"{value[0]} to {value[1]}" if isinstance(value, list) else f"{value}"


def _asset_credits(card: dict) -> str:
    """Every licence with the assets under it; then the assets that could not be loaded."""
    text = ""
    for licence in sorted({entry["licence"] for entry in card["assets"].values()}):
        text += f"\n### Assets: {licence}\n\n"
        under = {name: entry for name, entry in sorted(card["assets"].items()) if entry["licence"] == licence}
        for author in sorted({entry["author"] for entry in under.values()}):
            names = [f"{name} ({entry['source']})" for name, entry in under.items() if entry["author"] == author]
            text += f"- **{author}**: {'; '.join(names)}\n"
    if card["skipped_assets"]:
        text += "\n### Assets that could not be loaded and were left out\n\n"
        text += "".join(f"- {name}: {reason}\n" for name, reason in sorted(card["skipped_assets"].items()))
    return text


def _origin(card: dict) -> str:
    if card["pictures"]:
        return "All but the pictures\non some surfaces, named below, is generated by the program."
    return "Everything in these is generated by the program: no\nthird-party data, no licence but the program's own."
