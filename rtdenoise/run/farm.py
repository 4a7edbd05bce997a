"""Independent jobs on an existing Ray cluster. Ray is imported inside functions: it is an extra of its own, `farm`.

Every machine of the cluster has the package, of one version, and sees the files under the same paths.
"""

from __future__ import annotations

import contextlib
import os
import secrets
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from .. import __version__
from ..errors import InputError

ATTEMPTS = 4  # of a job whose worker is killed
CONNECT, EXAMINE = 10.0, 120.0  # seconds to wait for an answer of the cluster, and of each of its machines


@dataclass(frozen=True)
class Farm:
    """A Ray cluster that writes into a folder."""

    address: str  # HOST:PORT of its head, 'auto' on one of its machines, or ray://HOST:PORT from elsewhere
    folder: Path  # of the output
    threads: int = 1  # cores that a job reserves, or all of the largest machine if that has fewer
    gpu: bool = False  # a job reserves a GPU where the cluster has any

    def run(self, function: Callable, jobs: list[tuple], start: Callable[[int], None], killed: str) -> Iterator:
        """As `processes.Place.run`, in the current folder of this process. A job whose worker is killed runs again, on
        any machine, and `killed` is raised after `ATTEMPTS` of them.

        Raises InputError where Ray is not installed, no cluster answers, it has no cores, or a machine of it lacks the
        package or does not see a folder.
        """
        ray = _connect(self.address)
        try:
            machines = [node for node in ray.nodes() if node["Alive"]]
            cores = int(max((node["Resources"].get("CPU", 0) for node in machines), default=0))
            if not cores:
                raise InputError(
                    f"--ray {self.address}: no machine of the cluster offers a core (`ray start --num-cpus`)"
                )
            _examine(ray, machines, self.folder)
            threads = min(self.threads, cores)
            gpu = int(self.gpu and ray.cluster_resources().get("GPU", 0) >= 1)
            options = {"num_cpus": threads, "num_gpus": gpu, "max_retries": ATTEMPTS - 1}
            remote = ray.remote(**options)(_call)
            running = {remote.remote(function, job, start, threads, os.getcwd()): job for job in jobs}
            while running:
                (done,), _ = ray.wait(list(running), num_returns=1)
                yield running.pop(done), _result(ray, done, killed)
        finally:
            ray.shutdown()  # ends what still runs


_started = False  # in a process of the cluster: whether `start` was called


def _call(function: Callable, job: tuple, start: Callable[[int], None], threads: int, folder: str) -> object:
    """A job, in a process of the cluster."""
    global _started
    os.chdir(folder)
    if not _started:
        start(threads)
        _started = True
    return function(*job)


def _connect(address: str):
    """The module ray, connected. Raises InputError."""
    try:
        import grpc  # noqa: F401  (of ray[client])
        import ray
    except ImportError as error:
        raise InputError(f"--ray: {error.name} is not installed; type: pip install 'rtdenoise[farm]'") from error
    if ":" in address and not _answers(address.removeprefix("ray://")):
        raise InputError(
            f"--ray {address}: no Ray cluster answers there; expected HOST:PORT of `ray start --head`, 'auto' on a "
            "machine of the cluster, or ray://HOST:10001"
        )
    os.environ.setdefault("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")  # what later versions of Ray do; else they warn
    try:
        ray.init(address, log_to_driver=False, logging_level="ERROR")
    except (ConnectionError, RuntimeError, ValueError) as error:
        raise InputError(f"--ray {address}: {' '.join(str(error).split())}") from error
    return ray


def _answers(address: str) -> bool:
    """Whether a gRPC server, which the head of a cluster is, answers at HOST:PORT. Ray itself would try for minutes."""
    if os.environ.get("RAY_USE_TLS") == "1":  # needs certificates
        return True
    import grpc

    with grpc.insecure_channel(address) as channel:
        try:
            grpc.channel_ready_future(channel).result(CONNECT)
        except grpc.FutureTimeoutError:
            return False
    return True


def _examine(ray, machines: list[dict], folder: Path) -> None:
    """Raise InputError where a machine lacks this version of the package, the current folder, or what lies in `folder`.

    A file is written into `folder` and looked for on every machine: a folder of that name may be another one there.
    """
    from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy

    def look(here: str, mark: str) -> tuple[str, bool, bool]:  # nested: Ray sends its code, not its name
        import os

        try:
            from rtdenoise import __version__ as version
        except ImportError:
            version = ""
        return version, os.path.isdir(here), os.path.isfile(mark)

    here, folder = os.getcwd(), folder.resolve()
    mark = folder / f".rtdenoise-farm-{secrets.token_hex(4)}"
    folder.mkdir(parents=True, exist_ok=True)
    mark.touch()
    try:
        for machine in machines:
            name = f"--ray: machine {machine['NodeManagerHostname']} ({machine['NodeManagerAddress']})"
            place = NodeAffinitySchedulingStrategy(machine["NodeID"], soft=False)
            asked = ray.remote(num_cpus=0, scheduling_strategy=place)(look).remote(here, str(mark))
            try:
                version, has_here, has_mark = ray.get(asked, timeout=EXAMINE)
            except ray.exceptions.RayError as error:
                raise InputError(f"{name} does not answer ({type(error).__name__})") from error
            if version != __version__:
                found = f"version {version}" if version else "no rtdenoise"
                raise InputError(f"{name} has {found}; expected version {__version__}, as here: install it there")
            if not has_mark or not has_here:
                raise InputError(
                    f"{name} does not see {folder if not has_mark else here}; expected a folder that all machines "
                    "share under this path, as over NFS: choose another --out, or start the command in another folder"
                )
    finally:
        with contextlib.suppress(OSError):
            mark.unlink()


def _result(ray, done, killed: str) -> object:
    """What a job returned. Raises what it raised, and InputError for a killed worker."""
    try:
        return ray.get(done)
    except ray.exceptions.RayTaskError as error:
        raise error.cause from error
    except ray.exceptions.RayError as error:  # WorkerCrashedError, OutOfMemoryError, NodeDiedError ...
        raise InputError(f"{killed} ({type(error).__name__}, {ATTEMPTS} times)") from error
