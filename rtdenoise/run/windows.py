"""Windows in time: every frame of a stream with the frames around it, a few in memory at a time."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from typing import TypeVar

Item = TypeVar("Item")
Window = tuple[Item | None, ...]  # 2 · reach + 1 consecutive items, the current one in the middle


def windows(items: Iterable[tuple[Item, bool]], reach: int) -> Iterator[Window]:
    """The window of each item, in order: up to `reach` items before and after it; None beyond the ends of its shot.

    `items` are (item, whether a shot begins with it). An item is taken from the stream `reach` items before its own
    window is returned, and dropped `reach` windows after; so at most 2 · reach + 1 are held.
    """
    shot: deque[Item] = deque()  # the latest items of the current shot
    ahead = 0  # items at the end of `shot` whose windows are yet to come

    def window() -> Window:
        current = len(shot) - ahead
        return tuple(shot[i] if 0 <= i < len(shot) else None for i in range(current - reach, current + reach + 1))

    def pop() -> Window:
        nonlocal ahead
        found = window()
        ahead -= 1
        while len(shot) - ahead > reach:
            shot.popleft()
        return found

    for item, begins in items:
        if begins:
            while ahead:
                yield pop()
            shot.clear()
        shot.append(item)
        del item  # the deque alone decides how long it lives
        ahead += 1
        if ahead > reach:
            yield pop()
    while ahead:
        yield pop()
