"""Windows in time: who is in them, and that few frames are held."""

import gc
import weakref

import pytest

from rtdenoise.run.windows import windows


def numbered(count, begins=(0,)):
    return [(number, number in begins) for number in range(count)]


def test_a_window_holds_the_frames_around_and_none_beyond_the_ends():
    assert list(windows(numbered(4), 2)) == [
        (None, None, 0, 1, 2), (None, 0, 1, 2, 3), (0, 1, 2, 3, None), (1, 2, 3, None, None),
    ]  # fmt: skip


def test_no_window_looks_across_the_start_of_a_shot():
    assert list(windows(numbered(5, begins=(0, 2)), 2)) == [
        (None, None, 0, 1, None), (None, 0, 1, None, None), (None, None, 2, 3, 4), (None, 2, 3, 4, None),
        (2, 3, 4, None, None),
    ]  # fmt: skip


def test_one_item_and_none():
    assert list(windows(numbered(1), 2)) == [(None, None, 0, None, None)]
    assert list(windows([], 2)) == []
    assert list(windows(numbered(2), 0)) == [(0,), (1,)]


class Item:
    pass


@pytest.mark.parametrize("cuts", [(), (700, 701, 1500)])
def test_two_thousand_frames_are_held_five_at_a_time(cuts):
    alive, most = weakref.WeakSet(), 0

    def stream():
        for number in range(2000):
            item = Item()
            alive.add(item)
            yield item, number in cuts
            del item

    count = 0
    for window in windows(stream(), 2):
        count += 1
        gc.collect(0)
        most = max(most, len(alive))
        del window
    assert count == 2000 and most <= 6  # five, and the one that the stream has just made
