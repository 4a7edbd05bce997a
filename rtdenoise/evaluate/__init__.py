"""Error and time: `registry` lists methods, `measure` measures them on frames, `run` on sequences on disk."""

from .measure import ALL_METRICS, ALL_REGIONS, METRICS, REGIONS, WHOLE_METRICS, Result, evaluate, uncovered
from .registry import Method, choose, methods

__all__ = [
    "ALL_METRICS", "ALL_REGIONS", "METRICS", "REGIONS", "WHOLE_METRICS", "Method", "Result", "choose", "evaluate",
    "methods", "uncovered",
]  # fmt: skip
