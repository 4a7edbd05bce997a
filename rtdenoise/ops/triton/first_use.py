"""What happens before the first kernel: is this Triton new enough, and one line when it compiles kernels of ours, since
the first frames then take long."""

from __future__ import annotations

import functools
import logging

import triton
from triton.runtime import driver

COMPILE_SECONDS = 30  # of all kernels of a step of `default`
LEAST = 3, 4  # takes tuples of pointers, and tells what it compiles; with PyTorch 2.8


def prepare() -> None:
    """Start Triton's driver, which a C compiler makes at the first time. Raises RuntimeError for an older Triton, and
    what Triton does where the driver cannot be made."""
    if tuple(int(part) for part in triton.__version__.split(".")[:2]) < LEAST:
        raise RuntimeError(f"Triton {triton.__version__} is older than 3.4, which comes with PyTorch 2.8")
    _ = driver.active.utils
    listen_to_compilations()


def listen_to_compilations() -> None:
    """From now on say so when a kernel of ours is compiled, once a process."""
    knob = triton.knobs.compilation
    earlier = knob.listener

    def listen(*, src, cache_hit: bool, **others) -> None:
        if not cache_hit and getattr(getattr(src, "fn", None), "__module__", "").startswith("rtdenoise."):
            _announce()
        if earlier is not None:
            earlier(src=src, cache_hit=cache_hit, **others)

    knob.listener = listen


@functools.cache
def _announce() -> None:
    message = "rtdenoise: compiling kernels for this GPU once, about %d s; they are kept in %s"
    logging.getLogger("rtdenoise").warning(message, COMPILE_SECONDS, triton.knobs.cache.dir)
