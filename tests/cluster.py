"""A real Dask cluster on this machine: a scheduler and worker processes, started by command."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

_START_S = 60.0


@dataclass
class Cluster:
    """What runs; `workers` loses those that are killed."""

    address: str
    scheduler: subprocess.Popen[bytes]
    workers: list[subprocess.Popen[bytes]]

    def kill_worker(self, pid: int | None = None) -> int:
        """End a worker (that with the pid, else the first) by SIGKILL, and return its pid."""
        worker = next(w for w in self.workers if pid in (None, w.pid))
        self.workers.remove(worker)
        _kill(worker)
        return worker.pid


@contextmanager
def cluster(workers: int = 2) -> Iterator[Cluster]:
    """A scheduler at a free port of 127.0.0.1 and workers of one thread, without nannies.

    The tests' folder is on their path, so tasks can be functions of a module there.
    """
    with tempfile.TemporaryDirectory(prefix="dask-") as folder:
        told = Path(folder) / "scheduler.json"
        log = Path(folder) / "log.txt"
        started: list[subprocess.Popen[bytes]] = []
        path = os.pathsep.join([str(Path(__file__).parent), os.environ.get("PYTHONPATH", "")])

        def start(command: str, *words: str) -> subprocess.Popen[bytes]:
            with log.open("ab") as out:
                process = subprocess.Popen(
                    [sys.executable, "-m", f"distributed.cli.{command}", "--no-dashboard", *words],
                    env=os.environ | {"PYTHONPATH": path},
                    stdin=subprocess.DEVNULL,
                    stdout=out,
                    stderr=out,
                    cwd=folder,
                )
            started.append(process)
            return process

        try:
            scheduler = start(
                "dask_scheduler", "--host", "127.0.0.1", "--port", "0",
                "--scheduler-file", str(told),
            )  # fmt: skip
            running = [
                start(
                    "dask_worker", "--scheduler-file", str(told), "--host", "127.0.0.1",
                    "--no-nanny", "--nthreads", "1", "--memory-limit", "0",
                    "--local-directory", folder,
                )
                for _ in range(workers)
            ]  # fmt: skip
            yield Cluster(_address(told, log, started), scheduler, running)
        finally:
            for process in started:
                _kill(process)


def _address(told: Path, log: Path, started: list[subprocess.Popen[bytes]]) -> str:
    """The scheduler's address, once it and all workers are there."""
    import distributed

    end = time.monotonic() + _START_S
    while time.monotonic() < end and all(process.poll() is None for process in started):
        try:
            address = str(json.loads(told.read_text("utf-8"))["address"])
        except (FileNotFoundError, ValueError):  # not there, or half written
            time.sleep(0.05)
            continue
        with distributed.Client(address, timeout=_START_S, set_as_default=False) as client:
            client.wait_for_workers(len(started) - 1, timeout=_START_S)
        return address
    raise RuntimeError(f"the cluster did not start: {log.read_text('utf-8')}")


def _kill(process: subprocess.Popen[bytes]) -> None:
    process.send_signal(signal.SIGKILL)
    process.wait()
