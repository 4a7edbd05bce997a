"""Attacks: commands killed at random moments, fuzzed files, sanitizers over the C ops, little memory, hostile files.

python bench/attacks.py [--kinds kills fuzz ...] [--kills 50] [--commands train ...] [--executions 10000]
                        [--formats exr ...]

    kills       every command that takes long, killed `--kills` times and resumed (tests/attack_kills.py)
    fuzz        `--executions` inputs for each kind of file, mutated by atheris (tools/fuzz.py, tests/fuzz_targets.py)
    sanitizers  the C ops under address and undefined-behaviour sanitizers, 1×1 to 4K (tests/attack_sanitizers.py)
    memory      denoise under ever smaller limits of its address space (tests/attack_memory.py)
    files       the tests that feed hostile files, folders, caches and consoles, counted

Kinds, commands and formats that are left out keep their rows. `make fuzz` runs all kinds; fuzz needs atheris (extra
`fuzz`).
"""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import tempfile
from datetime import date
from importlib.util import find_spec
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))  # this checkout, whatever rtdenoise is installed
from bench import DOCS, RESULTS, ROOT, harness

# isort: split
from rtdenoise.errors import InputError

RESULT, PAGES = RESULTS / "attacks.json", (DOCS / "results" / "attacks.md",)
TESTS = ROOT / "tests"
COMMANDS = ("denoise", "combine", "evaluate", "train", "render", "clips")
FORMATS = {"exr": "EXR files", "layout": "layout presets", "scene": "scene.json", "state": "saved states",
           "weights": "weights", "clip": "training clips", "evaluation": "evaluation.json"}  # fmt: skip
SIZES = ("1x1", "1x7", "9x1", "2x2", "5x17", "31x23", "64x64", "270x480", "1080x1920", "2160x3840")
LIMITS = (100, 300, 500, 690, 720, 800, 900, 1000, 1200, 1500, 2000, 3000)  # MB
CASES = {  # file of tests -> what it attacks
    "test_fuzz.py": "damaged EXR files and scenes (hypothesis, 150 examples each)",
    "test_exr_format.py": "crafted EXR headers and chunk tables",
    "test_stored.py": "damaged saved histories",
    "test_config.py": "damaged weights and configurations",
    "test_files.py": "FIFOs, links, locks and unfinished files",
    "test_output.py": "links, colliding names, replaced frames",
    "test_cache.py": "the cache of compiled code, also of two processors on one home folder",
    "test_train_damage.py": "damaged checkpoints, logs and clips",
    "test_cli.py": "Ctrl-C, closed pipes, consoles",
    "test_memory.py": "too little memory",
}
KINDS = ("kills", "fuzz", "sanitizers", "memory", "files")


def main(
    kinds: tuple[str, ...] = KINDS,
    kills: int = 50,
    commands: tuple[str, ...] = COMMANDS,
    executions: int = 10_000,
    formats: tuple[str, ...] = tuple(FORMATS),
) -> None:
    if unknown := set(kinds) - set(KINDS):
        raise InputError(f"unknown kind {min(unknown)!r}; expected some of {', '.join(KINDS)}")
    run = {"kills": lambda: _kills(commands, kills), "fuzz": lambda: _fuzz(formats, executions),
           "sanitizers": _sanitizers, "memory": _memory, "files": _files}  # fmt: skip
    broken = []
    for kind in kinds:
        found = run[kind]()
        rows = harness.read(RESULT)["kinds"] if RESULT.is_file() else {}  # another run may do other kinds
        part = {"kills": commands != COMMANDS, "fuzz": formats != tuple(FORMATS)}.get(kind, False)
        known = {row["attack"]: row for row in rows.get(kind, {}).get("rows", [])} if part else {}
        known |= {row["attack"]: row for row in found}
        rows[kind] = {"date": date.today().isoformat(), "rows": list(known.values())}
        harness.publish(RESULT, {"kinds": {k: rows[k] for k in KINDS if k in rows}}, pages=PAGES, tables=tables)
        broken += [f"{kind}: {row['attack']}: {row['result']}" for row in found if not row["held"]]
    print(f"did not hold: {broken or 'nothing'}")
    if broken:
        sys.exit(1)


def _row(attack: str, count: int, held: bool, result: str, **counts: int) -> dict[str, object]:
    """`counts`: tracebacks, not_finite, lost, outside; those that an attack cannot have are left out."""
    return {"attack": attack, "count": count, "held": held, "result": result, **counts}


def _kills(commands: tuple[str, ...], kills: int) -> list[dict]:
    environment = os.environ | {"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    rows = []
    for command in commands:
        result = subprocess.run([sys.executable, TESTS / "attack_kills.py", f"{command}={kills}"], capture_output=True,
                                text=True, env=environment, cwd=ROOT)  # fmt: skip
        if result.returncode:
            rows.append(
                _row(f"`{command}` killed at random moments", kills, False, result.stderr.strip().splitlines()[-1])
            )
            continue
        found = json.loads(result.stdout)
        part = sum(0 < count < found["files"] for count in found["files_at_kill"])  # killed in the middle of the work
        said = (
            f"resumed to the same files; at {part} kills some of the {found['files']} files were written, "
            f"{found['completed']} runs completed"
        )
        problems = {key: found[key] for key in ("different", "refused", "left") if found[key]}
        rows.append(_row(
            f"`{command}` killed at random moments", found["kills"], found["held"] and part > 0,
            str(problems) if problems else said,
            tracebacks=found["tracebacks"], lost=len(found["lost"]), outside=len(found["outside"]),
        ))  # fmt: skip
        print(f"{command}: {rows[-1]}", flush=True)
    return rows


def _fuzz(formats: tuple[str, ...], executions: int) -> list[dict]:
    if find_spec("atheris") is None:
        raise InputError("atheris is not installed: pip install 'rtdenoise[fuzz]', or leave fuzz out of --kinds")
    rows = []
    for kind in formats:
        with tempfile.TemporaryDirectory() as folder:
            command = [sys.executable, ROOT / "tools" / "fuzz.py", kind, "--runs", str(executions)]
            result = subprocess.run(command, capture_output=True, text=True, cwd=folder, errors="replace")
        said = re.search(r"number_of_executed_units: (\d+)", result.stderr)
        count = int(said[1]) if said else 0
        held = result.returncode == 0 and count >= executions
        error = re.search(r"Uncaught Python exception: ===\n(.*)", result.stderr)
        outcome = (
            "read, or refused in one line" if held else (error[1] if error else result.stderr.strip().splitlines()[-1])
        )
        tracebacks = int("Uncaught Python exception" in result.stderr)
        finite = {"not_finite": 0} if kind in ("state", "weights") and held else {}
        rows.append(_row(f"fuzzed {FORMATS[kind]}", count, held, outcome, tracebacks=tracebacks, **finite))
        print(f"{kind}: {rows[-1]}", flush=True)
    return rows


def _sanitizers() -> list[dict]:
    result = subprocess.run([sys.executable, TESTS / "attack_sanitizers.py", *SIZES], capture_output=True, text=True)
    found = [json.loads(line) for line in result.stdout.splitlines() if line.startswith("{")]
    calls, wrong = sum(row["calls"] for row in found), [name for row in found for name in row["not_finite"]]
    same = len({row["ops"] for row in found}) == 1  # every op at every size
    held = result.returncode == 0 and len(found) == len(SIZES) and same and not wrong
    outcome = f"no report, at {len(found)} sizes from 1×1 to 3840×2160"
    if not held:
        outcome = ", ".join(wrong) or result.stdout.strip().splitlines()[-1]
    return [_row("calls of C ops under sanitizers", calls, held, outcome, not_finite=len(wrong))]


def _memory() -> list[dict]:
    result = subprocess.run([sys.executable, TESTS / "attack_memory.py", *map(str, LIMITS)], capture_output=True,
                            text=True, env=os.environ | {"PYTHONPATH": str(ROOT)})  # fmt: skip
    found = [json.loads(line) for line in result.stdout.splitlines()]
    broken = [f"{row['megabytes']} MB: {row['line'] or row['code']}" for row in found if not row["held"]]
    done = [row["megabytes"] for row in found if row["code"] == 0]
    outcome = f"1920×1080 is denoised from {min(done)} MB on, one line below" if done else "one line each"
    held = result.returncode == 0 and len(found) == len(LIMITS) and not broken
    return [_row("`denoise` with little address space", len(found), held, "; ".join(broken) or outcome, tracebacks=0)]


def _files() -> list[dict]:
    rows = []
    for file, what in CASES.items():
        command = [sys.executable, "-m", "pytest", "-q", "--tb=no", "-p", "no:cacheprovider", TESTS / file]
        result = subprocess.run(command, capture_output=True, text=True, cwd=ROOT)
        counts = {word: int(n) for n, word in re.findall(r"(\d+) (passed|failed|error)", result.stdout)}
        held = result.returncode == 0
        rows.append(_row(what, sum(counts.values()), held, "all tests pass" if held else f"{counts}"))
        print(f"{file}: {rows[-1]}", flush=True)
    return rows


def tables(document: dict) -> dict[str, str]:
    """Section `attacks`."""
    columns = {"tracebacks": "tracebacks", "not_finite": "not finite", "lost": "files lost", "outside": "outside --out"}
    lines = [f"| attack | count | {' | '.join(columns.values())} | result |", "|---" * (3 + len(columns)) + "|"]
    for kind in document["kinds"].values():
        for row in kind["rows"]:
            cells = [str(row.get(key, "–")) for key in columns]
            result = row["result"] if row["held"] else f"**{row['result']}**"
            lines.append(f"| {row['attack']} | {row['count']} | {' | '.join(cells)} | {result} |")
    return {"attacks": "\n".join(lines)}


if __name__ == "__main__":
    harness.run(main, __doc__)
