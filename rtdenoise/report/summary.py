"""What `evaluate` measured, as a table for the terminal."""

from __future__ import annotations

from collections.abc import Sequence

from rich import box
from rich.table import Table

from .markdown import write_number
from .readings import METRICS, label

# Or what stands for it where it is unknown.
SHOWN = {"psnr_corrected": "psnr", "ssim": "", "relmse": "", "flip": "", "fovvideovdp": ""}
LEAST = len("hybrid-ahead6")  # width of the names of methods
REGIONS = ("frame", "uncovered")


def summary(rows: Sequence[dict]) -> Table:
    """`rows`: those of `document.Document.results`, a line each. Decibels over both regions, others over the frame;
    metrics that were not measured have no column. Where none of `SHOWN` was, all that were have one."""
    metrics = [m for pair in SHOWN.items() for m in _known(pair, rows)]
    metrics = metrics or [m for m in METRICS if _known((m, ""), rows)]
    columns = [(m, region) for m in metrics for region in REGIONS if region == "frame" or METRICS[m].unit == "dB"]
    table = Table(box=box.SIMPLE, padding=0)  # a space between columns
    table.add_column("sequence", overflow="fold")
    table.add_column("spp", justify="right", no_wrap=True)
    table.add_column("method", overflow="fold", min_width=LEAST)
    for metric, region in columns:  # words below each other: all fits into 80 columns
        words = [*reversed(METRICS[metric].label.replace("corrected", "corr.").split()), region[:5]]
        table.add_column("\n".join(words), justify="right", no_wrap=True)
    table.add_column("ms", justify="right", no_wrap=True)
    for row in rows:
        errors = [write_number(metric, _error(row, metric, region)) for metric, region in columns]
        table.add_row(row["sequence"], str(row["spp"]), label(row), *errors, f"{row['ms']['median']:.0f}")
    return table


def _known(names: tuple[str, str], rows: Sequence[dict]) -> list[str]:
    """The first of a metric and its stand-in that any row has a number of."""
    return [m for m in names if any(_error(row, m, "frame") is not None for row in rows)][:1]


def _error(row: dict, metric: str, region: str) -> float | None:
    """None where it is unknown, which is NaN in results that have just been measured."""
    value = row["errors"][region].get(metric)
    return value if value == value else None
