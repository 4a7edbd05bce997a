"""Replay what `rtdenoise export` wrote, through OpenGL, and check every pass: the smallest engine there is.

    pip install numpy moderngl
    python examples/engines/player.py EXPORT

It knows export.json and nothing of rtdenoise; a port to another engine or API does the same steps in the same order.
Prints a line for each pass that differs, and exits with 1 if one does.
"""

import json
import sys
import zlib
from pathlib import Path

import moderngl
import numpy as np


class Player:
    """The denoiser of an export folder, on one OpenGL context."""

    def __init__(self, folder, ctx):
        self.folder, self.ctx = Path(folder), ctx
        self.export = json.loads((self.folder / "export.json").read_text(encoding="utf-8"))
        self.shaders = {
            name: ctx.compute_shader((self.folder / shader["glsl"]).read_text(encoding="utf-8"))
            for name, shader in self.export["shaders"].items()
        }
        self.buffers = {}
        weights = (self.folder / "weights.bin").read_bytes()
        for name, buffer in self.export["buffers"].items():
            start, size = buffer.get("offset", 0), buffer["bytes"]
            content = weights[start : start + size] if buffer["kind"] == "weights" else bytes(size)
            self.buffers[name] = ctx.buffer(content)

    def play(self, kind, layers, after=lambda step: None):
        """Denoise a frame: `kind` is "first" (also after a cut) or "following", `layers` name -> bytes. Returns
        [3, H, W] float32 linear radiance. `after(step)` is called after every dispatch."""
        for name, content in layers.items():
            self.buffers[name].write(content)
        for step in self.export["frames"][kind]:
            self.dispatch(step)
            after(step)
        for before, now in self.export["keep"].items():  # this frame's history is the next one's past
            self.buffers[before], self.buffers[now] = self.buffers[now], self.buffers[before]
        return self.read(self.export["output"])

    def dispatch(self, step):
        """Bind the buffers of a step, set its parameters, run its work groups."""
        shader = self.shaders[step["shader"]]
        for name, value in step["parameters"].items():
            if name in shader:  # compilers drop what this shader does not use
                shader[name] = tuple(value) if isinstance(value, list) else value
        for slot in self.export["shaders"][step["shader"]]["buffers"]:
            self.buffers[step["buffers"][slot["name"]]].bind_to_storage_buffer(slot["binding"])
        shader.run(*step["groups"])
        self.ctx.memory_barrier()

    def read(self, name):
        """The content of a buffer."""
        buffer = self.export["buffers"][name]
        count = int(np.prod(buffer["shape"]))
        return np.frombuffer(self.buffers[name].read(), buffer["type"])[:count].reshape(buffer["shape"])

    def verdict(self, step):
        """Compare what a step wrote: "same" bits, "close" (another driver rounds differently) or "different"."""
        verdicts = []
        for slot, recorded in step["checks"].items():
            values = self.read(step["buffers"][slot])
            same = zlib.crc32(np.ascontiguousarray(values)) == recorded["crc32"]
            verdicts.append("same" if same else "close" if self.close(values.astype(float), recorded) else "different")
        return max(verdicts, key=("same", "close", "different").index)

    def close(self, values, recorded):
        """Whether mean and single values are those recorded, within the export's tolerance."""
        known = values[np.abs(values) < 1e30]  # greater ones stand for "none"
        found = [known.mean() if known.size else 0.0, *(values.flat[int(at)] for at in recorded["values"])]
        expected = np.array([recorded["mean"], *recorded["values"].values()])
        return bool((np.abs(found - expected) <= self.export["tolerance"] * (np.abs(expected) + recorded["rms"])).all())


def check(player):
    """Replay both sample frames; True if every pass does as recorded."""
    counts = {"same": 0, "close": 0, "different": 0}

    def compare(step):
        verdict = player.verdict(step)
        counts[verdict] += 1
        if verdict == "different":
            print(f"different: {step['shader']}, which writes {', '.join(step['buffers'][s] for s in step['checks'])}")

    for kind, files in player.export["sample"].items():
        layers = {name: (player.folder / file).read_bytes() for name, file in files.items() if name != "result"}
        image = player.play(kind, layers, compare)
        expected = np.frombuffer((player.folder / files["result"]).read_bytes(), np.float32).reshape(image.shape)
        print(f"{kind} frame: differs from the recorded result by {np.abs(image - expected).max():.2g} at most")
    print(", ".join(f"{count} passes {verdict}" for verdict, count in counts.items()))
    return not counts["different"]


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    backend = {"backend": "egl"} if sys.platform.startswith("linux") else {}
    context = moderngl.create_standalone_context(require=430, **backend)
    sys.exit(0 if check(Player(sys.argv[1], context)) else 1)
