"""Train a tiny network on made-up clips: the script that `test_train` starts in two processes.

python -m torch.distributed.run --nproc-per-node 2 run_training.py CLIPS VALIDATION OUT
"""

import sys
from pathlib import Path

from synthetic import TINY

from rtdenoise.models import PRESETS
from rtdenoise.training.loop import train
from rtdenoise.training.trainer import TrainConfig

PRESETS["tiny"] = TINY
clips, other_clips, out = map(Path, sys.argv[1:])
train(TrainConfig((clips,), out, val=other_clips, model="tiny", steps=6, batch=4, frames=3, size=16, amp=False,
                  validate_every=3))  # fmt: skip
names = [comm.read_text().strip() for comm in Path("/proc/self/task").glob("*/comm")]
assert not [name for name in names if "gloo" in name], f"threads outlive their process group: {names}"
