"""The report for a README: first where a peer wins, then a table for each sequence."""

from __future__ import annotations

import html
import re

from .readings import METRICS, POOL, grouped

COLUMNS = ("psnr", "psnr_corrected", "ssim", "relmse", "flip", "tpsnr")
UNCOVERED = COLUMNS[:2]


def markdown(data: dict) -> str:
    """`page.payload` as GitHub Markdown, each sequence at its fewest samples per pixel."""
    rows = _at_fewest(data["rows"])
    several = [key for key in ("spp", "device") if len({row[key] for row in rows}) > 1]
    samples = " and ".join(str(spp) for spp in sorted({row["spp"] for row in rows}))
    run = data["runs"][-1]
    parts = [
        "# Error against run time",
        f"{data['signal']} light, {samples} spp, {_count(len(data['sequences']), 'sequence')}: "
        f"{', '.join(map(plain, data['sequences']))}. "
        f"Commit {run['commit']}, {run['date']}, {plain(', '.join(run['devices'].values()))}. "
        "`report.html` has the pictures.",
        "![Error against time](report.png)",
        _losses(data, {(row["sequence"], row["spp"]) for row in rows}, several),
        *(_table(group, data, several) for group in _in_order(grouped(rows, "sequence", "device"))),
        _readings(data),
    ]
    return "\n\n".join(part for part in parts if part) + "\n"


def plain(text: str) -> str:
    """Text whose characters mean nothing in Markdown or HTML: names of folders and methods are the user's."""
    return re.sub(r"([\\`*$|\[\]])", r"\\\1", html.escape(text, quote=False)).replace("\n", " ")


def write_number(metric: str, value: float | None) -> str:
    """With the digits of the metric; a dash for None."""
    return "–" if value is None else f"{value:.{METRICS[metric].digits}f}"


def _count(number: int, what: str) -> str:
    return f"{number} {what}{'' if number == 1 else 's'}"


def _at_fewest(rows: list[dict]) -> list[dict]:
    """The rows of each sequence at its fewest samples per pixel."""
    fewest = {group[0]["sequence"]: min(row["spp"] for row in group) for group in grouped(rows, "sequence")}
    return [row for row in rows if row["spp"] == fewest[row["sequence"]]]


def _name(row: dict, several: list[str]) -> str:
    """Its sequence, with those of samples and device of which the report has several."""
    more = {"spp": f"{row['spp']} spp", "device": row["device"]}
    return plain(", ".join([row["sequence"], *(more[key] for key in several)]))


def _in_order(groups: list[list[dict]]) -> list[list[dict]]:
    return sorted(groups, key=lambda group: group[0]["sequence"] != POOL)


def _losses(data: dict, inputs: set[tuple[str, int]], several: list[str]) -> str:
    """Of these (sequence, samples per pixel)."""
    lost, won = ([row for row in data[key] if (row["sequence"], row["spp"]) in inputs] for key in ("lost", "won"))
    if not lost and not won:
        return ""
    lines = [
        "## Where a peer wins",
        "",
        f"In {len(lost)} of {len(lost) + len(won)} comparisons with rtdenoise `{data['ours']}`.",
    ]
    if lost:
        lines += [
            "",
            "| sequence | region | metric | peer | its error | ours | its time |",
            "|---|---|---|---|---|---|---|",
        ]
    for row in lost:
        metric = row["metric"]
        values = [write_number(metric, row[key]) for key in ("peer_value", "our_value")]
        lines.append(
            f"| {_name(row, several)} | {row['region']} | {METRICS[metric].label} | {plain(row['peer'])} | "
            f"{values[0]} | {values[1]} | {row['time_ratio']:.2f}× |"
        )
    return "\n".join(lines)


def _table(group: list[dict], data: dict, several: list[str]) -> str:
    ours = next((row["ms"]["median"] for row in group if row["label"] == data["ours"]), None)
    lines = [
        f"## {_name(group[0], several)}",
        "",
        *_references(data["sequences"].get(group[0]["sequence"])),
        f"| | {' | '.join(METRICS[m].label for m in COLUMNS)} | "
        f"{' | '.join(f'{METRICS[m].label}, uncovered' for m in UNCOVERED)} | time |",
        "|---" * (len(COLUMNS) + len(UNCOVERED) + 2) + "|",
    ]
    for row in group:
        values = [write_number(m, row["errors"]["frame"].get(m)) for m in COLUMNS]
        values += [write_number(m, row["errors"]["uncovered"].get(m)) for m in UNCOVERED]
        is_input = data["methods"][row["method"]]["family"] == "input"
        time = "–" if is_input or not ours else f"{row['ms']['median'] / ours:.2f}×"
        name = f"**{plain(row['label'])}**" if row["label"] == data["ours"] else plain(row["label"])
        lines.append(f"| {name} | {' | '.join(values)} | {time} |")
    return "\n".join(lines)


def _references(sequence: dict | None) -> list[str]:
    """The references' own error; nothing where that is not known."""
    if not sequence or sequence.get("reference_psnr") is None:
        return []
    own = [write_number(m, sequence[f"reference_{m}"]) for m in ("psnr", "relmse")]
    return [f"The references' own error: {own[0]} dB PSNR, relMSE {own[1]}; corrected PSNR is without it.", ""]


def _readings(data: dict) -> str:
    """Equal error and equal time by PSNR, of each sequence that was measured at several sample counts."""
    rows = [row for row in data["comparisons"] if row["metric"] == "psnr"]
    told = dict.fromkeys(row["sequence"] for row in rows if row["area"])
    if not told:
        return ""
    goal = f"To reach the PSNR of rtdenoise `{data['ours']}` at its fewest samples; ≈ is extrapolated."
    tables = [_reading(name, [row for row in rows if row["sequence"] == name]) for name in told]
    return "\n\n".join(["## Equal error and equal time", goal, *tables])


def _reading(sequence: str, rows: list[dict]) -> str:
    lines = [
        f"| {plain(sequence)} | needs | that takes | error ratio in our time | over all budgets |",
        "|---|---|---|---|---|",
    ]
    for row in rows:
        needs, has, area = row["equal_error"], row["equal_time"], row["area"]
        samples = f"{'≈ ' if needs['extrapolated'] else ''}{needs['spp']:.3g} spp" if needs else "–"
        takes = f"{needs['ms']:.0f} ms" if needs and needs["ms"] else "–"
        ratios = [f"{has['cost_ratio']:.2f}×" if has else "–", f"{area['factor']:.2f}×" if area else "–"]
        name = "plain Monte Carlo" if row["peer"] == "noisy" else plain(row["peer"])
        lines.append(f"| {name} | {samples} | {takes} | {ratios[0]} | {ratios[1]} |")
    return "\n".join(lines)
