"""How good is `denoise` on shots of Cycles of every kind, beside OIDN?

    render="bpyenv/bin/python examples/blender/render.py"
    $render shots/night --set night --frames 8                      # likewise all other sets
    $render shots/night-reference --set night --frames 8 --samples 128 --seed 77
    $render shots/night-reference-2 --set night --frames 8 --samples 64 --seed 78
    python bench/shots.py shots/night ...

A shot has the name of its set, and its references lie in the folder of its name and "-reference"; a second render, in
that of "-reference-2", tells their noise. Corrected PSNR at 1 sample a pixel, of all frames but the first. OIDN takes
frames as they are rendered; the other methods take them, and `denoise` its network, as the command does. Writes
bench/results/shots.json and the table of docs/results/shots.md.
"""

from __future__ import annotations

import ast
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))  # this checkout, whatever rtdenoise is installed
from bench import DOCS, RESULTS, ROOT, harness

# isort: split
import numpy as np
import tyro

from bench.diagnosis.outdated import offline, singles
from bench.diagnosis.turned import errors, paired, pictures, pictures_of_oidn
from rtdenoise.data.opening import open_sequence
from rtdenoise.run.choice import open_chosen
from rtdenoise.run.options import Options

RESULT, PAGES = RESULTS / "shots.json", (DOCS / "results" / "shots.md",)
OIDN, CLEAN, CHOSEN, UNCOVERED = "OIDN", "OIDN, albedo and normal filtered first", "`denoise`", "uncovered"
METHODS = {  # of frames as they are rendered, as `denoise` reads them, and of the options that it chooses
    OIDN: lambda rendered, read, chosen: pictures_of_oidn(rendered),
    CLEAN: lambda rendered, read, chosen: pictures_of_oidn(rendered, clean=True),
    "`hybrid`, single frames": lambda rendered, read, chosen: singles(read, "hybrid"),
    "`--lookahead 0`": lambda rendered, read, chosen: pictures(read, "hybrid", 0),
    CHOSEN: lambda rendered, read, chosen: pictures(read, chosen.model, chosen.lookahead),
    "`--offline`": lambda rendered, read, chosen: offline(read, chosen.model),
}


def main(shots: tyro.conf.Positional[tuple[Path, ...]]) -> None:
    """`shots`: folders of frames of Cycles."""
    rows = []
    for shot in shots:
        sequence, chosen, _ = open_chosen(str(shot), Options())
        rendered, read = (paired(noisy, f"{shot}-reference") for noisy in (open_sequence(str(shot)), sequence))
        for method, run in METHODS.items():
            found = errors(read, run(rendered, read, chosen))
            row = {"shot": shot.name, "method": method, "psnr": found["frame"], UNCOVERED: found["uncovered"]}
            rows.append(row | ({"model": chosen.model} if method == CHOSEN else {}))
            print(rows[-1], flush=True)
    harness.publish(RESULT, {"rows": rows}, digits=4, pages=PAGES, tables=tables)


def tables(document: dict) -> dict[str, str]:
    """Section `shots`: OIDN's PSNR on each shot, and how much more the others have."""
    found = {(row["shot"], row["method"]): row for row in document["rows"]}
    told, others = descriptions(), [method for method in METHODS if method != OIDN]
    lines = [f"| shot | {' | '.join(METHODS)} | {CHOSEN}, {UNCOVERED} |", "|---" * (len(METHODS) + 2) + "|"]
    leads = []
    for shot in dict.fromkeys(shot for shot, _ in found):
        peer, chosen = found[shot, OIDN], found[shot, CHOSEN]
        uncovered = np.nan if chosen[UNCOVERED] is None else chosen[UNCOVERED] - peer[UNCOVERED]
        leads.append([*(found[shot, method]["psnr"] - peer["psnr"] for method in others), uncovered])
        network = "" if chosen["model"] == "hybrid" else f" (`{chosen['model']}`)"
        lines.append(f"| `{shot}`: {told[shot]}{network} | {peer['psnr']:.1f} | {cells(leads[-1])} |")
    lines.append(f"| **mean** | | {cells(np.nanmean(leads, axis=0))} |")
    return {"shots": "\n".join(lines)}


def cells(leads: list[float]) -> str:
    return " | ".join("–" if np.isnan(lead) else f"{lead:+.2f}" for lead in leads)


def descriptions() -> dict[str, str]:
    """What each set of examples/blender shows: the first sentence of the function that builds it."""
    said, built = {}, {}
    for file in sorted((ROOT / "examples" / "blender").glob("*sets.py")):
        for node in ast.parse(file.read_text()).body:
            if isinstance(node, ast.FunctionDef):
                said[node.name] = (ast.get_docstring(node) or "").split(".")[0].replace("\n", " ")
            elif isinstance(node, ast.Assign) and isinstance(node.value, ast.Dict):
                built |= {key.value: name.id for key, name in zip(node.value.keys, node.value.values, strict=True)}
    return {name: said[function].replace(" of `sets`", "").replace("build_", "") for name, function in built.items()}


if __name__ == "__main__":
    harness.run(main, __doc__)
