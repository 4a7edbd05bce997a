"""Error and time: `registry` lists methods, `sequence` runs one, `judge` measures images, `measure` several methods on
frames, `run` measures them on sequences on disk."""

from .judge import ALL_METRICS, ALL_REGIONS, WHOLE_METRICS
from .measure import METRICS, REGIONS, Result, evaluate
from .registry import Method, choose, methods
from .sequence import Output, Step, outputs, uncovered

__all__ = [
    "ALL_METRICS", "ALL_REGIONS", "METRICS", "REGIONS", "WHOLE_METRICS", "Method", "Output", "Result", "Step", "choose",
    "evaluate", "methods", "outputs", "uncovered",
]  # fmt: skip
