"""What an engine programmer, a researcher and a passer-by do with the installed wheel, in a fresh environment."""

import os
import shutil
from pathlib import Path

from browser import Browser
from environments import ROOT, run
from synthetic import make_frames, write_sequence

JOURNEYS = Path(__file__).parent / "journeys"


def walk(environment, script, *arguments, cwd):
    """Run a journey with the programs of an environment first on the path. Returns what it prints."""
    keep = {key: value for key, value in os.environ.items() if not key.startswith(("PYTHON", "VIRTUAL_ENV"))}
    path = f"{environment.folder / 'bin'}{os.pathsep}{os.environ['PATH']}"
    return run("sh", JOURNEYS / script, *arguments, cwd=cwd, env=keep | {"PATH": path})


def test_export_and_replay_without_torch(without_torch, tmp_path):
    player = shutil.copy(ROOT / "examples" / "engines" / "player.py", tmp_path)
    printed = walk(without_torch, "engine.sh", player, cwd=tmp_path)
    assert "0 passes close, 0 passes different" in printed


def test_own_frames_to_trained_weights_to_a_report(with_torch, tmp_path):
    for name, seed in (("a", 1), ("b", 2)):
        write_sequence(tmp_path / "shots" / name, make_frames(4, H=40, W=64, seed=seed))
    printed = walk(with_torch, "researcher.sh", ROOT / "rtdenoise/weights/fast.safetensors", cwd=tmp_path)
    assert "next: rtdenoise denoise shots/a --out clean/" in printed
    assert (tmp_path / "run" / "weights.safetensors").is_file()
    with Browser(tmp_path / "profile") as page:
        page.open(tmp_path / "out" / "report.html")
        page.wait("document.getElementById('players').dataset.ready")
        assert page.value("[...document.querySelectorAll('#legend button')].map((b) => b.textContent)") == [
            "noisy", "accumulate", "fast", "mine",
        ]  # fmt: skip
        assert page.problems == []


def test_the_demo_from_anywhere(with_torch, tmp_path):
    printed = walk(with_torch, "passer_by.sh", cwd=tmp_path)
    assert "mural-window: 9 frames" in printed and "default" in printed and (tmp_path / "demo" / "strip.png").is_file()
