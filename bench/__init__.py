"""Benchmarks of rtdenoise. README.md holds their contract and says which question each script answers."""

import os
from pathlib import Path

# Set before torch is loaded: by default its idle threads spin, which slows measurements on a busy CPU.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")

ROOT = Path(__file__).resolve().parents[1]
RESULTS = ROOT / "bench" / "results"
DOCS = ROOT / "docs"
SAMPLE = ROOT / "samples" / "mural"
