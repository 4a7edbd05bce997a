"""What a newcomer does with the installed wheel, in a fresh environment: arrays, Mitsuba in memory, no torch at all."""

import re
from pathlib import Path

import pytest
from environments import ROOT
from synthetic import make_frames, write_sequence

JOURNEYS = Path(__file__).parent / "journeys"
PAGE = ROOT / "docs/use/python.md"

# Appended to the page's script: the last frame against a reference, by relative squared error.
CHECK = """
reference = np.array(mi.render(scene, spp=256, seed=1))[..., :3]
errors = [float(np.mean((image - reference) ** 2 / (reference**2 + 0.01))) for image in (color, clean)]
assert not denoiser.started and errors[1] < errors[0] / 10, errors
print(errors)
"""


def mitsuba_script(size, frames):
    """The page's script, smaller."""
    script = re.search(r"runs this script. -->\n```python\n(.*?)```", PAGE.read_text(), re.S)[1]
    assert "SIZE, FRAMES, FOV = (360, 640), 24," in script
    return script.replace("(360, 640), 24", f"{size}, {frames}")


def test_arrays_in_three_lines(with_torch):
    lines = (JOURNEYS / "numpy_arrays.py").read_text().splitlines()
    used = [line for line in lines if "enois" in line and not line.startswith(('"', "#"))]
    assert len(used) == 3, "import, denoiser, call"
    assert "of the clean one" in with_torch.run("python", JOURNEYS / "numpy_arrays.py")


def test_the_same_arrays_without_torch(without_torch):
    printed = without_torch.run("python", JOURNEYS / "without_torch.py", JOURNEYS / "numpy_arrays.py")
    assert "of the clean one" in printed
    assert "PyTorch is not installed; type: pip install 'rtdenoise[torch]'" in printed


def test_a_mitsuba_animation_in_memory(with_torch, tmp_path):
    script = tmp_path / "animate.py"
    script.write_text(mitsuba_script((72, 128), 4) + CHECK)
    with_torch.run("python", script, cwd=tmp_path)
    assert len(list(tmp_path.glob("clean.*.exr"))) == 4


@pytest.mark.parametrize("words", [(), ("--signal", "indirect", "--recombine")])
def test_files_without_torch(without_torch, tmp_path, words):
    shot = write_sequence(tmp_path / "shot", make_frames(2))
    assert "not checked: it takes PyTorch" in without_torch.run("rtdenoise", "inspect", shot)
    out = tmp_path / "out"
    printed = without_torch.run("rtdenoise", "denoise", shot, "--out", out, "--preview", "--model", "fast", *words)
    assert "2 frames written" in printed
    assert {"frame.0001.exr", "preview.png"} <= {path.name for path in out.iterdir()}
