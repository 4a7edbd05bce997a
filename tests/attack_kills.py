"""Commands that are killed at random moments and run again: python tests/attack_kills.py COMMAND=KILLS ... [--seed N]

An undisturbed run gives the expected files and its time. Then the command is killed (SIGKILL, it and its workers) after
a random share of that time and started again, until it has been killed KILLS times. Whenever a run ends by itself, its
files are compared with the expected ones, and the folder is emptied. Prints an outcome a line, as JSON.

Every run is a fork of this process, which has imported the program, so that kills fall into the work and not into the
start. Files are compared to the last bit, but for the times that they hold.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import random
import shutil
import signal
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

import torch
from safetensors import safe_open
from safetensors.torch import load_file
from synthetic import TINY, make_frames, save_tiny, write_clips, write_sequence
from torch.nn.functional import avg_pool2d

from rtdenoise.cli import clips, combine, evaluate, render, train  # noqa: F401  (imported before the forks)
from rtdenoise.cli.main import main
from rtdenoise.models import PRESETS, CombinerConfig, create, save
from rtdenoise.run import correcting  # noqa: F401
from rtdenoise.training import loop  # noqa: F401

MOST_RUNS = 6  # for each kill, before the attack counts as failed
TIMES = {"seconds", "ms", "written", "skipped", "date", "sample_ms", "runs", "run", "command"}  # keys of JSON files
OF_TRAIN = (
    "--model tiny --steps 12 --batch 1 --frames 2 --size 16 --no-amp --validate-every 4 "
    "--checkpoint-minutes 0"  # after every step
)
OF_RENDER = "--frames 5 --size 32 --reference-spp 8"
OF_CLIPS = "--generator 1 --count 4 --size 32 --frames 2 --reference-spp 8 --workers 1"


@dataclass
class Outcome:
    """The outcome of an attack."""

    command: str
    kills: int = 0
    completed: int = 0  # runs that ended by themselves
    different: int = 0  # of them, with other files than an undisturbed run
    refused: list[str] = field(default_factory=list)  # lines of runs that ended with another code than 0
    tracebacks: int = 0
    left: list[str] = field(default_factory=list)  # unfinished files in the folder of a completed run
    lost: list[str] = field(default_factory=list)  # files that were there at a kill and not at the end
    outside: list[str] = field(default_factory=list)  # files that appeared or changed beside the output folder
    files: int = 0  # of an undisturbed run
    files_at_kill: list[int] = field(default_factory=list)
    seconds: float = 0.0  # of an undisturbed run

    @property
    def held(self) -> bool:
        return self.completed > 0 and not (
            self.different or self.refused or self.tracebacks or self.left or self.lost or self.outside
        )


def attack(command: str, kills: int, seed: int, folder: Path, warm_up: bool = True) -> Outcome:
    """Kill `command` this many times; its input and output lie in `folder`."""
    rng, outcome, out = random.Random(seed), Outcome(command), folder / "out"
    arguments, contents = prepare(command, folder)
    for _ in range(warm_up):  # compiled ops and rendering kernels are kept
        run([*arguments, "--out", str(folder / "warm")], None, outcome)
    started = time.monotonic()
    run([*arguments, "--out", str(folder / "whole")], None, outcome)
    outcome.seconds = time.monotonic() - started
    expected, input_files, seen = contents(folder / "whole"), beside(folder), set()
    outcome.files = len(visible(folder / "whole"))
    for _ in range(MOST_RUNS * kills):
        if outcome.kills == kills:
            break
        finished = run([*arguments, "--out", str(out)], rng.uniform(0.01, 1.0) * outcome.seconds, outcome)
        if finished:
            compare(out, contents, expected, seen, outcome)
            shutil.rmtree(out, ignore_errors=True)
            seen = set()
        else:
            seen |= (now := visible(out))
            outcome.files_at_kill.append(len(now))
    if outcome.kills == kills and run([*arguments, "--out", str(out)], None, outcome):
        compare(out, contents, expected, seen, outcome)
    outcome.outside = sorted(name for name, _ in beside(folder) ^ input_files)
    return outcome


def visible(out: Path) -> set[str]:
    return {str(path.relative_to(out)) for path in out.rglob("*") if path.is_file() and path.name[0] != "."}


def beside(folder: Path) -> set[tuple[str, int]]:
    """Name and time of every file that is not in the output folder."""
    return {(str(path.relative_to(folder)), path.stat().st_mtime_ns) for path in folder.rglob("*")
            if path.is_file() and path.relative_to(folder).parts[0] != "out"}  # fmt: skip


def compare(out: Path, contents: Callable, expected: object, seen: set[str], outcome: Outcome) -> None:
    if not out.exists():  # refused before it began
        return
    outcome.completed += 1
    outcome.lost += sorted(seen - visible(out))
    outcome.different += contents(out) != expected
    outcome.left += [path.name for path in out.rglob(".*") if path.is_file() and "lock" not in path.name
                     and path.name != ".rtdenoise-state.safetensors"]  # fmt: skip


def run(arguments: list[str], seconds: float | None, outcome: Outcome) -> bool:
    """Run the command line in a fork; kill it after `seconds`. Returns whether it came to its end."""
    error = tempfile.TemporaryFile()  # noqa: SIM115 (two processes hold it)
    if not (child := os.fork()):
        os.setsid()
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        os.dup2(error.fileno(), 2)
        code = 1
        try:
            main(arguments)
            code = 0
        except SystemExit as stop:
            code = stop.code if isinstance(stop.code, int) else 1
        except BaseException:
            import traceback

            traceback.print_exc()
        finally:
            sys.stderr.flush()
            os._exit(code)
    deadline = None if seconds is None else time.monotonic() + seconds
    while not (ended := os.waitpid(child, os.WNOHANG))[0]:
        if deadline is not None and time.monotonic() > deadline:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(child, signal.SIGKILL)
            ended = os.waitpid(child, 0)
            break
        time.sleep(0.002)
    error.seek(0)
    said = error.read().decode(errors="replace")
    outcome.tracebacks += "Traceback" in said
    if os.WIFSIGNALED(ended[1]):
        outcome.kills += 1
        return False
    if os.WEXITSTATUS(ended[1]):
        outcome.refused.append(said.strip().splitlines()[-1] if said.strip() else f"exit {os.WEXITSTATUS(ended[1])}")
    return True


def prepare(command: str, folder: Path) -> tuple[list[str], Callable[[Path], object]]:
    """The command without --out, on small input, and the function that reads the files to compare."""
    PRESETS["tiny"], model = TINY, save_tiny(folder)
    if command == "denoise":
        shot = write_sequence(folder / "shot", make_frames(24, H=96, W=128))
        return ["denoise", str(shot), "--model", str(model)], files
    if command == "combine":
        frames = make_frames(24, H=96, W=128)
        shot = write_sequence(folder / "shot", frames)
        blurred = [replace(frame, radiance=avg_pool2d(frame.radiance, 5, 1, 2)) for frame in frames]
        clean = write_sequence(folder / "clean", blurred)
        combiner = create(CombinerConfig(widths=(4, 4, 4), scales=2, kernel=3))
        for parameter in combiner.parameters():  # untrained it would correct nothing
            parameter.data.normal_(std=0.2)
        save(combiner, model := folder / "combiner.safetensors")
        return ["combine", str(shot), str(clean), "--model", str(model)], files
    if command == "evaluate":
        shots = [str(write_sequence(folder / f"shot{i}", make_frames(3, seed=i))) for i in range(4)]
        return ["evaluate", *shots, "--methods", "noisy", "accumulate", f"tiny={model}", "--metrics", "psnr"], files
    if command == "train":
        data = write_clips(folder / "clips", range(4))
        validation = write_clips(folder / "validation", range(4, 5))
        return ["train", "--data", str(data), "--val", str(validation), *OF_TRAIN.split()], trained
    if command == "render":
        return ["render", "procedural:3", *OF_RENDER.split()], files
    if command == "clips":
        return ["clips", *OF_CLIPS.split()], files
    raise ValueError(f"unknown command {command!r}")


def files(out: Path) -> dict[str, object]:
    """Path -> content of every visible file; JSON and the headers of clips without times."""
    return {str(path.relative_to(out)): content(path) for path in sorted(out.rglob("*"))
            if path.is_file() and path.name[0] != "." and path.suffix not in (".md", ".html")}  # fmt: skip


def content(path: Path) -> object:
    if path.suffix == ".json":
        return without_times(json.loads(path.read_text()))
    if path.suffix == ".safetensors":
        with safe_open(path, framework="np") as file:
            header = {key: without_times(parsed(value)) for key, value in (file.metadata() or {}).items()}
            return header, {name: file.get_tensor(name).tobytes() for name in sorted(file.keys())}
    return path.read_bytes()


def parsed(text: str) -> object:
    try:
        return json.loads(text)
    except ValueError:
        return text


def without_times(value: object) -> object:
    if isinstance(value, dict):
        return {key: without_times(item) for key, item in value.items() if key not in TIMES}
    return [without_times(item) for item in value] if isinstance(value, list) else value


def trained(out: Path) -> dict[str, object]:
    """Weights, the log and the checkpoint of a run."""
    state = torch.load(out / "checkpoint.pt", weights_only=True)
    rows = [without_times(json.loads(line)) for line in (out / "log.jsonl").read_text().splitlines()]
    weights = {name: tensor.numpy().tobytes() for name, tensor in load_file(out / "weights.safetensors").items()}
    model = {name: tensor.numpy().tobytes() for name, tensor in state["model"].items()}
    return {"step": state["step"], "best": state["best"], "model": model, "weights": weights, "log": rows}


if __name__ == "__main__":
    options = argparse.ArgumentParser()
    options.add_argument("attacks", nargs="+")
    options.add_argument("--seed", type=int, default=0)
    options.add_argument("--cold", action="store_true", help="no run before the first that is timed")
    chosen = options.parse_args()
    for name, _, number in (text.partition("=") for text in chosen.attacks):
        with tempfile.TemporaryDirectory() as place:
            found = attack(name, int(number), chosen.seed, Path(place), not chosen.cold)
            print(json.dumps(asdict(found) | {"held": found.held}), flush=True)
