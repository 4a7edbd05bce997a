"""Where the names of files have their frame numbers."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence

NUMBER = r"(?:(?<=[._ ])-)?\d+"  # a sign stands behind a separator, where it is none itself
VERSION = r"(?<![A-Za-z])(v|V)\d+"
NO_SIGN = 1000  # no show has as many frames before 0: a - before them only separates
SAMPLES = r"\d+ ?(?i:spp)(?![A-Za-z])"


def frame_numbers(names: Iterable[str]) -> dict[str, re.Match | None]:
    """Where each name has its frame number; None without digits.

    It is the last run of digits, negative in `shot.-0001`, not in `shot-0001`; a version such as `_v02`, and samples
    such as `_64spp`, only where there is no other. Nor is it what belongs to a word and is the same in all names of a
    kind, as `shot_0012_4k` and `shot_0013_4k`, unless there is no other."""
    found, kinds = {}, {}
    for name in names:
        kinds.setdefault(re.sub(NUMBER, "0", name), {})[name] = _numbers(name)
    for kind in kinds.values():
        runs = list(zip(*kind.values(), strict=True)) or [(None,) * len(kind)]
        free = [of for of in runs if of[0] and (_alone(of[0]) or len({int(run[0]) for run in of}) > 1)]
        found |= zip(kind, _unsigned((free or runs)[-1]), strict=True)
    return found


def _unsigned(runs: tuple[re.Match | None, ...]) -> tuple[re.Match | None, ...]:
    """The numbers of one kind of names; without signs where all have one and one of them can be none, as in `-0000`."""
    if not all(run and run[0].startswith("-") for run in runs):
        return runs
    if all(-NO_SIGN < int(run[0]) < 0 for run in runs):
        return runs
    return tuple(re.compile(r"\d+").match(run.string, run.start() + 1) for run in runs)


def _alone(run: re.Match) -> bool:
    """Whether digits touch no letter."""
    start, end = run.span()
    return not any(c.isalpha() for c in run.string[max(start - 1, 0) : start] + run.string[end : end + 1])


def _numbers(name: str) -> list[re.Match]:
    """The runs of digits that may be a frame number."""
    taken = [match.span() for match in re.finditer(f"{VERSION}|{SAMPLES}", name)]
    runs = list(re.finditer(NUMBER, name))
    return [run for run in runs if not any(start < run.end() and run.start() < end for start, end in taken)] or runs


def told_of_order(numbers: Sequence[int]) -> list[str]:
    """What there is to say of frames that may be in the wrong order."""
    if len(numbers) < 2 or numbers[-1] >= 0:
        return []
    return [f"all frames have numbers below 0, so that {numbers[0]} is the first; if the - before them only separates, "
            "time runs backwards: rename the files without it"]  # fmt: skip
