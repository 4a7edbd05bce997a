"""Mutate files under atheris, guided by the lines that they reach: python tools/fuzz.py KIND [--runs N]

KIND is one of tests/fuzz_targets.py. Starts from valid files and from tests/corpus/KIND. Ends with the first input that
the target does not survive, which is left in the current folder. Half of the mutations of JSON, also in the headers of
safetensors files, replace one value. Needs atheris: pip install 'rtdenoise[fuzz]'.
"""

from __future__ import annotations

import argparse
import functools
import sys
import tempfile
import warnings
from pathlib import Path

import atheris

ROOT = Path(__file__).parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "tests")]
warnings.simplefilter("ignore")

with atheris.instrument_imports(include=["rtdenoise.data", "rtdenoise.models.weights", "rtdenoise.models.config",
                                         "rtdenoise.run.denoise", "rtdenoise.history", "rtdenoise.evaluate.document",
                                         "rtdenoise.files", "tomllib"]):  # fmt: skip
    import fuzz_targets

MAX_BYTES = 16_384


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("kind", choices=fuzz_targets.TARGETS)
    options.add_argument("--runs", type=int, default=10_000)
    options.add_argument("--seed", type=int, default=1)
    options.add_argument("--corpus", type=Path, help="folder that inputs which reach new lines are added to")
    chosen = options.parse_args()
    corpus = chosen.corpus or Path(tempfile.mkdtemp())
    corpus.mkdir(parents=True, exist_ok=True)
    for number, seed in enumerate(fuzz_targets.seeds(chosen.kind)):
        (corpus / f"seed{number}").write_bytes(seed)
    shipped = fuzz_targets.CORPUS / chosen.kind
    arguments = [f"-runs={chosen.runs}", f"-seed={chosen.seed}", f"-max_len={MAX_BYTES}", "-timeout=20",
                 "-rss_limit_mb=6000", "-print_final_stats=1", str(corpus)]  # fmt: skip
    folders = [str(shipped)] if shipped.is_dir() else []
    atheris.Setup([sys.argv[0], *arguments, *folders], fuzz_targets.TARGETS[chosen.kind],
                  custom_mutator=functools.partial(mutate, chosen.kind))  # fmt: skip
    atheris.Fuzz()


def mutate(kind: str, data: bytes, most: int, seed: int) -> bytes:
    """The next input."""
    if seed % 2 or kind not in fuzz_targets.JSON_KINDS + fuzz_targets.SAFETENSORS_KINDS:
        return atheris.Mutate(data, most)
    if kind in fuzz_targets.JSON_KINDS:
        return fuzz_targets.mutated_json(data, seed)[:most]
    header, zero, content = data.partition(b"\0")
    return (fuzz_targets.mutated_json(header, seed) + zero + content)[:most]


if __name__ == "__main__":
    main()
