"""Jobs of test_farm.py. The workers of the cluster import this module, so it imports little."""

import os
import time


def set_threads(threads):
    os.environ["FARM_TEST_THREADS"] = str(threads)


def work(folder, number):
    """Three pieces of work, each a file that is kept, and holds the process that did it."""
    for piece in range(3):
        path = folder / f"{number}-{piece}"
        if not path.exists():
            (folder / f"{number}-{piece}.begun").write_text(str(os.getpid()))
            time.sleep(30 if (number, piece) == (0, 1) and not (folder / "killed").exists() else 0.05)
            path.write_text(str(os.getpid()))
    return os.environ["FARM_TEST_THREADS"], os.getcwd()
