"""The tables and strips of docs/results/quality.md, on numbers and pictures whose results are known."""

import copy
import importlib
import io
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from rtdenoise.data.exr import write_layers

ROOT = Path(__file__).parent.parent
EXPOSURE = 0.5


@pytest.fixture(scope="module")
def quality():
    return importlib.import_module("bench.quality")


@pytest.fixture
def strips(quality):
    return importlib.import_module("bench.harness.strips")


def row(method, psnr, corrected):
    errors = {
        "psnr": psnr, "psnr_corrected": corrected, "ssim": 0.5, "relmse": 0.05, "flip": 0.1 * (30 - psnr),
        "tpsnr": 20.0, "mse": 10 ** (-psnr / 10),
        "mse_corrected": None if corrected is None else 10 ** (-corrected / 10),
    }  # fmt: skip
    return {
        "signal": "indirect", "sequence": "hall", "method": method, "run": 0, "frame": errors | {"fovvideovdp": 7.125},
        "uncovered": copy.deepcopy(errors), "ghost_length": 3.0, "ms": 10.0,
    }  # fmt: skip


def document(*rows):
    facts = {
        "size": [180, 320], "frames": 16, "uncovered_share": 0.0125, "reference_psnr": 28.5, "reference_relmse": 0.02,
    }  # fmt: skip
    return {"sequences": {"indirect": {"hall": facts}}, "rows": list(rows)}


def test_the_aims_compare_with_oidn_and_with_setting_a(quality):
    rows = [row("oidn", 22.0, 24.0), row("A", 20.0, 21.0), row("hybrid", 25.0, 31.0)]
    last = quality.tables(document(*rows))["aims"].splitlines()[-1]
    ratios = f"{0.5 / 0.8:.2f} | {10**-0.5:.2f} | {10**-1.0:.2f}"
    assert last == f"| hall | indirect | +3.00 dB | +7.00 dB | +5.00 dB | +10.00 dB | {ratios} |"


def test_the_settings_are_compared_one_by_one(quality):
    rows = [row("A", 20.0, 21.0), row("B", 20.0, 21.5), row("C", 20.0, 21.25), row("default", 25.0, None)]
    found = quality.tables(document(*rows))["settings"].splitlines()[2:]
    assert found[0] == "| B over A | 1 of 1 | +0.50 | 1 of 1 | +0.50 |"
    assert found[1] == "| C over B | 0 of 1 | -0.25 | 0 of 1 | -0.25 |"
    assert found[3] == "| `default` over C | – | – | – | – |"


def test_missing_measurements_are_dashes(quality):
    rows = [row("oidn", 22.0, None), row("hybrid", 25.0, None)]
    found = quality.tables(document(*rows))
    assert found["aims"].splitlines()[-1] == "| hall | indirect | +3.00 dB | – | – | – | 0.62 | – | – |"
    assert "| OIDN | 22.00 | – | 0.500 |" in found["scenes"]


def test_a_scene_says_how_good_its_references_are(quality):
    text = quality.tables(document(row("hybrid", 25.0, 31.0), row("noisy", 9.0, 9.1)))["scenes"]
    assert "16 frames of 320×180, 1.2 % uncovered; the references' own error: 28.50 dB PSNR, relMSE 0.0200." in text
    head, _, *methods = text.splitlines()[-4:]
    assert methods[0].startswith("| noisy, 1 spp | 9.00 | 9.10 |") and methods[1].startswith("| **`hybrid`** | 25.00")
    assert all(line.count("|") == head.count("|") for line in methods)
    assert methods[1].endswith("| 3 |") and "| 7.12 |" in methods[1]


@pytest.fixture
def still(tmp_path):
    """A folder as `evaluate` writes it: a gradient as reference, a black picture, one uncovered region."""
    height, width = 72, 128
    gradient = np.linspace(0, 2, width, dtype=np.float32)[None, :, None].repeat(height, 0).repeat(3, 2)
    uncovered = np.zeros((height, width, 1), np.float32)
    uncovered[40:46, 90:100] = 1
    write_layers(tmp_path / "reference.exr", {"color": gradient, "uncovered": uncovered})
    write_layers(tmp_path / "noisy.exr", {"color": np.zeros_like(gradient)})
    return tmp_path


def test_a_strip_enlarges_the_most_uncovered_part(strips, still):
    picture = np.asarray(strips.compose(still, {"noisy": "noisy", "left out": "magic"}, EXPOSURE)).astype(int)
    assert picture.shape == (72 + strips.GAP + 72, 128 + 4 + 128, 3)
    frame, detail = picture[:72, 132:], picture[72 + strips.GAP :, 132:]
    part = strips.most_uncovered(np.pad(np.ones((6, 10), np.float32), ((40, 26), (90, 28))))
    top, left, height, width = part
    assert (height, width) == (18, 32) and top <= 40 < 46 <= top + height and left <= 90 < 100 <= left + width
    inside = frame[top + 1 : top + height - 1, left + 1 : left + width - 1]
    enlarged = detail[4:-4:4, 4:-4:4]  # without the row and column under the outline
    rows = inside.shape[0] - 6  # and above the label
    np.testing.assert_array_equal(enlarged[:rows], inside[:rows])
    assert (frame[top, left : left + width] == 255).all()
    assert (picture[4:8, 4:100] == 0).all()  # black stays black


def test_strips_are_small(strips):
    noise = Image.fromarray(np.random.default_rng(0).integers(0, 255, (100, 200, 3), np.uint8))
    encoded = strips.encode(noise)
    assert Image.open(io.BytesIO(encoded)).size == (200, 100) and len(encoded) <= strips.MAX_BYTES
