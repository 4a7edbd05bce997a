"""What is found between two frames, once: frames that wait are ahead of several others."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import TYPE_CHECKING

from ..frame import Frame

if TYPE_CHECKING:
    from torch import Tensor


class Once:
    """`find` of two frames with depth, whose last `most` results are kept. A frame is known by its depth, which stays
    the same tensor when light is divided by a gain."""

    def __init__(self, find: Callable[[Frame, Frame], Tensor], most: int) -> None:
        self._find = find
        self._found: deque[tuple[Tensor, Tensor, Tensor]] = deque(maxlen=most)

    def __call__(self, first: Frame, second: Frame) -> Tensor:
        for a, b, result in self._found:
            if a is first.depth and b is second.depth:
                return result
        result = self._find(first, second)
        self._found.append((first.depth, second.depth, result))
        return result
