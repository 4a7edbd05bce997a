"""Somebody without PyTorch: the same call runs as shaders, and nothing on the way imports torch."""

import sys
from pathlib import Path

exec(Path(sys.argv[1]).read_text())
assert "torch" not in sys.modules
try:
    rtdenoise.Denoiser(backend="torch")  # noqa: F821 (from the other journey)
except rtdenoise.InputError as error:  # noqa: F821
    print(error)
