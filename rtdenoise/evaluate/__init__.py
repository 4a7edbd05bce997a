"""Error and time: `registry` lists methods, `sequence` runs one, `measure` measures several on frames, `run` measures
them on sequences on disk."""

from .measure import ALL_METRICS, ALL_REGIONS, METRICS, REGIONS, WHOLE_METRICS, Result, evaluate
from .registry import Method, choose, methods
from .sequence import Output, Step, outputs, uncovered

__all__ = [
    "ALL_METRICS", "ALL_REGIONS", "METRICS", "REGIONS", "WHOLE_METRICS", "Method", "Output", "Result", "Step", "choose",
    "evaluate", "methods", "outputs", "uncovered",
]  # fmt: skip
