"""Sets of clips without processes: where these are not what is tested, their start would take most of the time."""

import pytest

from rtdenoise.render import clips


class Here:
    """Takes the place of `Processes`: jobs run in this process, on one thread each."""

    def __init__(self, count):
        self.count = count

    def run(self, function, jobs, start, killed):
        import drjit as dr

        threads = dr.thread_count()
        start(1)
        try:
            for job in jobs:
                yield job, function(*job)
        finally:
            dr.set_thread_count(threads)


def render_here(*arguments):
    """As `clips.render_clips`, in this process."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(clips, "Processes", Here)
        return clips.render_clips(*arguments)
