"""Robustness of files: runs killed at random moments, and long sequences in constant memory.

python bench/files.py [--kills 50] [--frames 2000]

Kills: `rtdenoise denoise` on the bundled sequence is killed (SIGKILL) after a random time and started again, `--kills`
times. Whenever a run completes, its files are compared, byte by byte, with those of an undisturbed run, and the
folder is emptied. Memory: a long sequence of links to the bundled frames is denoised in one process, whose resident
memory is read after every frame.
"""

from __future__ import annotations

import random
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))  # this checkout, whatever rtdenoise is installed
from bench import DOCS, RESULTS, ROOT, SAMPLE, harness

# isort: split

from rtdenoise.data.exr import write_layers
from rtdenoise.errors import InputError
from rtdenoise.run.denoise import Options, denoise

RESULT, PAGES = RESULTS / "files.json", (DOCS / "results" / "stability.md",)
CROP = 48  # pixels per side of the long sequence's frames


def main(kills: int = 50, frames: int = 2000) -> None:
    content = {"kills": kill_and_resume(kills), "memory": long_sequence(frames)}
    harness.publish(RESULT, content, pages=PAGES, tables=tables)


def tables(document: dict) -> dict[str, str]:
    """Section `files`."""
    kills, memory = document["kills"], document["memory"]
    at = kills["finished_frames_at_kill"]
    same = "the same files, byte by byte" if kills["identical"] else "**other files**"
    early, late = (f"{memory[key]:.0f} MB" for key in ("mb_after_a_tenth", "mb_at_the_end"))
    return {
        "files": f"Killed {kills['kills']} times, after {min(at)} to {max(at)} finished frames: {same}, "
        f"{kills['refused']} runs refused. A sequence of {memory['frames']} frames: {early} of memory after a tenth of "
        f"them, {late} at the end (`python bench/files.py`, [JSON](../../bench/results/files.json))."
    }


def kill_and_resume(kills: int) -> dict[str, object]:
    """Kill and restart runs: the frames finished at each kill, and whether the final files are an undisturbed run's."""
    rng = random.Random(0)
    with tempfile.TemporaryDirectory() as folder:
        whole, out = Path(folder) / "whole", Path(folder) / "out"
        command = [sys.executable, "-m", "rtdenoise", "denoise", str(SAMPLE), "--out"]
        started = time.monotonic()
        subprocess.run([*command, str(whole)], check=True, stdout=subprocess.DEVNULL, cwd=ROOT)
        length = time.monotonic() - started
        expected = _contents(whole)
        survived, finished, at, refused = 0, 0, [], 0
        while survived < kills:
            run = subprocess.Popen([*command, str(out)], cwd=ROOT, stdout=subprocess.DEVNULL,
                                   stderr=subprocess.DEVNULL)  # fmt: skip
            try:
                run.wait(rng.uniform(0.3, 1.0) * length)
            except subprocess.TimeoutExpired:
                run.send_signal(signal.SIGKILL)
                run.wait()
                survived += 1
                at.append(len(_contents(out)))
                continue
            refused += run.returncode != 0
            if _contents(out) != expected:
                sys.exit(f"after {survived} kills the files differ from those of an undisturbed run")
            finished += 1
            for path in out.iterdir():
                path.unlink()
        subprocess.run([*command, str(out)], check=True, stdout=subprocess.DEVNULL, cwd=ROOT)
        identical = _contents(out) == expected
    print(f"{kills} kills after {sorted(at)} frames, {finished} runs finished in between, {refused} refused")
    return {"kills": kills, "finished_frames_at_kill": at, "runs_finished_in_between": finished, "refused": refused,
            "identical": identical}  # fmt: skip


def _contents(out: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in out.glob("[!.]*.exr")} if out.is_dir() else {}


def long_sequence(count: int) -> dict[str, object]:
    """Resident memory in MB over a sequence of `count` frames."""
    memory: list[float] = []
    with tempfile.TemporaryDirectory() as folder:
        shot = Path(folder) / "shot"
        shot.mkdir()
        sources = []
        for frame in harness.mural("color"):
            small = frame.crop(60, 100, CROP, CROP)
            layers = {name: tensor[0].permute(1, 2, 0).numpy() for name, tensor in small.layers()}
            layers["color"] = layers.pop("radiance")
            sources.append(shot / f"frame.{len(sources):05d}.exr")
            write_layers(sources[-1], layers)
        for i in range(len(sources), count):
            (shot / f"frame.{i:05d}.exr").symlink_to(sources[i % len(sources)])
        try:
            denoise(str(shot), Path(folder) / "out", Options(), on_frame=lambda done, total: memory.append(_resident()))
        except InputError as error:
            sys.exit(str(error))
    tenth = max(1, count // 10)
    early, late = memory[tenth], memory[-1]
    print(f"{count} frames: {early:.0f} MB after {tenth}, {late:.0f} MB at the end, {max(memory):.0f} MB at most")
    return {"frames": count, "size": [CROP, CROP], "mb_after_a_tenth": early, "mb_at_the_end": late,
            "mb_at_most": max(memory)}  # fmt: skip


def _resident() -> float:
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return round(pages * 4096 / 1e6, 1)


if __name__ == "__main__":
    harness.run(main, __doc__)
