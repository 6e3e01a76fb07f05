"""Results survive whatever ends a process, and are the same whoever made them."""

from __future__ import annotations

import importlib
import io
import os
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("fsspec", reason="extra train")
pytest.importorskip("threadpoolctl", reason="extra train")
pytest.importorskip("distributed", reason="extra cluster")

import execution_tasks
from cluster import Cluster, cluster

from boxgrasp.errors import MissingExtraError, StoreError, WorkError
from boxgrasp.execution import Store, Workers, cluster_workers, finish, local_workers, workers_for

progressing = importlib.import_module("boxgrasp.execution.progress")
FINISH = """
import sys
sys.path.insert(0, {tests!r})
import execution_tasks
from boxgrasp.execution import Store, finish, local_workers
if __name__ == "__main__":
    tasks = {{f"part/{{i:02}}": ({marks!r}, f"{{i:02}}") for i in range({count})}}
    try:
        with local_workers(2) as workers:
            print("go", flush=True)
            finish(Store({place!r}), tasks, execution_tasks.slow, workers, "")
    except KeyboardInterrupt:
        sys.exit(130)
"""


@pytest.fixture(scope="module")
def running() -> Iterator[Cluster]:
    with cluster(workers=2) as started:
        yield started


def by_index(workers: Workers, function: Callable[[Any], Any], tasks: list[Any]) -> list[Any]:
    """Results in the order of the tasks, each exactly once."""
    pairs = list(workers.run(function, tasks))
    assert sorted(index for index, _ in pairs) == list(range(len(tasks)))
    return [result for _, result in sorted(pairs)]


def kept(folder: Path) -> list[str]:
    """Names of the finished results of a folder."""
    found = [path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()]
    return sorted(name for name in found if ".unfinished-" not in name)


def alive(pid: int) -> bool:
    try:
        return "\nState:\tZ" not in Path(f"/proc/{pid}/status").read_text("utf-8")
    except (FileNotFoundError, ProcessLookupError):
        return False


def wait_for(what: Callable[[], Any], seconds: float = 30.0) -> None:
    end = time.monotonic() + seconds
    while not what():
        assert time.monotonic() < end, "waited in vain"
        time.sleep(0.01)


# ---- store


@pytest.mark.parametrize("kind", ["folder", "file", "memory"])
def test_store_keeps_what_is_written(kind: str, tmp_path: Path) -> None:
    places = {"folder": "", "file": "file://", "memory": "memory://"}
    store = Store(f"{places[kind]}{tmp_path}/out/")
    assert str(store) == f"{places[kind]}{tmp_path}/out"
    assert not store.exists("a/b")
    for name, data in (("a/b", b"1"), ("a/bc", b""), ("c", b"3"), ("a/b", b"anew")):
        store.write(name, data)
    assert [store.read(name) for name in ("a/b", "a/bc", "c")] == [b"anew", b"", b"3"]
    assert store.exists("a/b") and not store.exists("a") and not store.exists("a/c")
    with pytest.raises(StoreError, match=r"out/a/x: .*; valid: a place to read and write$"):
        store.read("a/x")
    if kind != "memory":
        assert kept(tmp_path / "out") == ["a/b", "a/bc", "c"]


def test_relative_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Store(Path("out")).write("a", b"1")
    assert (tmp_path / "out" / "a").read_bytes() == b"1"


@pytest.mark.parametrize("before", [None, b"old"])
def test_killed_between_write_and_replace(before: bytes | None, tmp_path: Path) -> None:
    store = Store(tmp_path)
    if before:
        store.write("a", before)
    code = f"""
import os, signal
os.replace = lambda *_: os.kill(os.getpid(), signal.SIGKILL)
from boxgrasp.execution import Store
Store({str(tmp_path)!r}).write("a", b"new")
"""
    assert subprocess.run([sys.executable, "-c", code]).returncode == -signal.SIGKILL
    assert len(list(tmp_path.iterdir())) == 1 + bool(before)  # the half-written one is there
    assert store.exists("a") == bool(before)
    assert not before or store.read("a") == before
    store.write("a", b"new")
    assert store.read("a") == b"new" and kept(tmp_path) == ["a"]


def test_full_disk_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(_: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(StoreError, match=f"^{tmp_path}/a: No space left on device; valid: "):
        Store(tmp_path).write("a", b"new")
    assert list(tmp_path.iterdir()) == []


def test_places_that_cannot_be_used(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    for place in (tmp_path / "file", tmp_path / "file" / "under", Path("/proc/none")):
        with pytest.raises(StoreError, match=rf"^{place}/a: .+; valid: ") as told:
            Store(place).write("a", b"")
        assert "\n" not in str(told.value)
    for place in ("nope://x", ""):
        with pytest.raises(
            StoreError, match="^(nope://x: |no place).+; valid: a folder or an fsspec"
        ):
            Store(place)


def test_unreachable_is_not_taken_for_empty(monkeypatch: pytest.MonkeyPatch) -> None:
    store = Store("memory://unreachable")

    def fail(*_: Any, **__: Any) -> None:
        raise ConnectionError("no\nroute")

    for name in ("info", "pipe_file", "cat_file"):
        monkeypatch.setattr(f"fsspec.implementations.memory.MemoryFileSystem.{name}", fail)
    for call in (lambda: store.exists("a"), lambda: store.write("a", b""), lambda: store.read("a")):
        with pytest.raises(StoreError, match="^memory://unreachable/a: no route; valid: "):
            call()


@pytest.mark.parametrize(
    ("package", "call"),
    [
        ("fsspec", lambda: Store("memory://x")),
        ("threadpoolctl", lambda: local_workers(1).__enter__()),
        ("distributed", lambda: cluster_workers("tcp://127.0.0.1:1").__enter__()),
    ],
)
def test_missing_extra(
    package: str, call: Callable[[], Any], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(MissingExtraError, match=rf"needs {package}; .*pip install 'boxgrasp\["):
        call()
    Store(tmp_path).write("a", b"")  # a folder needs none of them


# ---- workers


def test_same_bytes_and_one_thread_everywhere(running: Cluster) -> None:
    from threadpoolctl import threadpool_info

    def state() -> tuple[dict[str, int], dict[str, str]]:
        return {one["filepath"]: one["num_threads"] for one in threadpool_info()}, dict(os.environ)

    threads, environment = state()
    results = []
    for workers in (local_workers(1), local_workers(2), cluster_workers(running.address)):
        with workers as opened:
            assert by_index(opened, execution_tasks.threads, [0] * 4) == [(1, 1)] * 4
            results.append(by_index(opened, execution_tasks.numeric, list(range(6))))
    assert results[0] == results[1] == results[2]
    assert len(set(results[0])) == 6
    after = state()
    assert environment == after[1] and threads.items() <= after[0].items()
    if len(os.sched_getaffinity(0)) > 1:  # the limit is what did it, and it is gone
        assert execution_tasks.threads(0)[1] > 1


def test_tasks_run_in_two_other_processes(tmp_path: Path) -> None:
    tasks = [(str(tmp_path), f"{i}") for i in range(6)]
    with local_workers(2) as workers:
        by_index(workers, execution_tasks.slow, tasks)
        first = {pid for _, pid in execution_tasks.marks(tmp_path)}
        by_index(workers, execution_tasks.slow, tasks)
    pids = {pid for _, pid in execution_tasks.marks(tmp_path)}
    assert len(pids) == 2 and first == pids and os.getpid() not in pids
    assert not any(map(alive, pids))


def test_killed_worker_costs_no_result(tmp_path: Path) -> None:
    tasks = [(str(tmp_path), f"{i}") for i in range(4)]
    with local_workers(2) as workers:
        results = by_index(workers, execution_tasks.die_once, tasks)
    assert results == [name.encode() for _, name in tasks]
    assert Counter(name for name, _ in execution_tasks.marks(tmp_path)) == {
        str(i): 2 for i in range(4)
    }


def test_task_that_always_kills_its_worker_is_told() -> None:
    with (
        local_workers(2) as workers,
        pytest.raises(WorkError, match=r"^task 0 of 1 ended its worker process 3 times, .*SIGKILL"),
    ):
        list(workers.run(execution_tasks.die, [1]))


def test_script_without_a_guard_is_told(tmp_path: Path) -> None:
    script = tmp_path / "script.py"
    script.write_text(
        "from boxgrasp.execution import local_workers\n"
        "with local_workers(2) as workers:\n"
        "    list(workers.run(abs, [1]))\n"
    )
    done = subprocess.run([sys.executable, script], capture_output=True, text=True, timeout=60)
    assert done.returncode == 1
    assert "exit status 1; has the main script its `if __name__" in done.stderr.splitlines()[-1]


@pytest.mark.parametrize("kind", ["one", "two", "dask"])
def test_task_exception_ends_the_run(kind: str, running: Cluster, tmp_path: Path) -> None:
    tasks = {f"{i:03}": i for i in range(100)}
    address = running.address if kind == "dask" else None
    with workers_for({"one": 1, "two": 2}.get(kind), address) as workers:
        with pytest.raises(ValueError, match="^three"):
            finish(Store(tmp_path), tasks, execution_tasks.fail_at_three, workers, "")
        assert len(kept(tmp_path)) < 90  # later tasks were not run
        for name in kept(tmp_path):
            assert (tmp_path / name).read_bytes() == bytes([int(name)])
        assert by_index(workers, execution_tasks.fail_at_three, [7, 8]) == [b"\7", b"\10"]


def test_exception_that_cannot_travel_is_told() -> None:
    with local_workers(2) as workers, pytest.raises(RuntimeError, match="OddError: odd 1 2"):
        list(workers.run(execution_tasks.fail_oddly, [1]))


def test_run_given_up_leaves_nothing_to_the_next(tmp_path: Path) -> None:
    with local_workers(2) as workers:
        given_up = workers.run(execution_tasks.slow, [(str(tmp_path), f"{i}") for i in range(6)])
        next(given_up)
        assert by_index(workers, execution_tasks.fail_at_three, [1, 2]) == [b"\1", b"\2"]


def test_no_tasks(running: Cluster) -> None:
    for workers in (local_workers(1), local_workers(2), cluster_workers(running.address)):
        with workers as opened:
            assert list(opened.run(execution_tasks.die, [])) == []


def test_who_works_is_said_clearly() -> None:
    for count in (0, -2):
        with pytest.raises(WorkError, match=f"^{count} processes; valid: 1 or more$"):
            workers_for(count, None).__enter__()
    with pytest.raises(WorkError, match="^both processes and a cluster; valid: one of them$"):
        workers_for(2, "tcp://h:1")


@pytest.mark.parametrize("address", ["here", "", "tcp://127.0.0.1:1", "nope://127.0.0.1:1"])
def test_no_scheduler_is_one_line(address: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("boxgrasp.execution._dask._REACH_S", 1)
    with pytest.raises(WorkError, match=f"^no Dask scheduler at {address}: .") as told:
        cluster_workers(address).__enter__()
    assert "\n" not in str(told.value)


# ---- finished parts


def start(folder: Path, count: int) -> tuple[subprocess.Popen[str], Path, Path]:
    """A process that finishes slow tasks, its results' folder, and that of the tasks' marks."""
    marks, out = folder / "marks", folder / "out"
    marks.mkdir()
    out.mkdir()
    script = folder / "script.py"
    tests = str(Path(__file__).parent)
    script.write_text(
        FINISH.format(tests=tests, count=count, marks=str(marks), place=str(out)), "utf-8"
    )
    process = subprocess.Popen(
        [sys.executable, script],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    return process, out, marks


def test_killed_run_goes_on_where_it_was(tmp_path: Path) -> None:
    process, out, marks = start(tmp_path, 14)
    wait_for(lambda: len(kept(out)) >= 4)
    process.kill()
    process.communicate()
    before = kept(out)
    assert 4 <= len(before) < 14
    wait_for(lambda: not any(alive(pid) for _, pid in execution_tasks.marks(marks)), 10)
    tasks = {f"part/{i:02}": (str(marks), f"{i:02}") for i in range(14)}
    with local_workers(1) as workers:
        finish(Store(out), tasks, execution_tasks.slow, workers, "")
    assert kept(out) == sorted(tasks)
    runs = Counter(name for name, _ in execution_tasks.marks(marks))
    assert all(runs[name[5:]] == 1 for name in before)
    assert sum(runs.values()) <= 14 + 4  # two under way, two handed out before the write
    with local_workers(1) as workers:
        expected = by_index(workers, execution_tasks.slow, list(tasks.values()))
    assert [(out / name).read_bytes() for name in tasks] == expected


@pytest.mark.parametrize("after_s", [0.0, 0.1, None])
def test_interrupt_ends_at_once(after_s: float | None, tmp_path: Path) -> None:
    """Also while the processes start; None is after the first result."""
    process, out, marks = start(tmp_path, 400)
    assert process.stdout is not None and process.stdout.readline() == "go\n"
    if after_s is None:
        wait_for(lambda: kept(out))
    else:
        time.sleep(after_s)
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does
    _, errors = process.communicate(timeout=10)
    assert (process.returncode, errors) == (130, "")
    assert not any(alive(pid) for _, pid in execution_tasks.marks(marks))
    with pytest.raises(ProcessLookupError):  # nobody of its group is left
        wait_for(lambda: os.killpg(process.pid, 0), 5)


def test_finished_store_runs_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    Store(tmp_path).write("a", b"kept")
    with local_workers(1) as workers:
        finish(Store(tmp_path), {"a": 3}, execution_tasks.fail_at_three, workers, "some work")
    assert (tmp_path / "a").read_bytes() == b"kept"
    assert capsys.readouterr().err == ""


# ---- Dask


def test_killed_dask_worker_costs_no_result(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("boxgrasp.execution._dask._REACH_S", 2)  # for the lost scheduler at the end
    marks, out = tmp_path / "marks", tmp_path / "out"
    marks.mkdir()
    tasks = {f"{i:02}": (str(marks), f"{i:02}") for i in range(16)}
    with cluster(workers=2) as running, cluster_workers(running.address) as workers:
        killed: list[int] = []

        class Killing(Store):
            def write(self, name: str, data: bytes) -> None:
                super().write(name, data)
                if len(kept(out)) == 4:
                    killed.append(running.kill_worker())

        finish(Killing(out), tasks, execution_tasks.slow, workers, "")
        starts = execution_tasks.marks(marks)
        held = {name for name, pid in starts if pid == killed[0]}
        again = {name for name, pid in starts if pid != killed[0]}
        assert held & again  # it was killed with a task under way
        with local_workers(1) as alone:
            expected = by_index(alone, execution_tasks.slow, list(tasks.values()))
        assert [(out / name).read_bytes() for name in tasks] == expected
        given = workers.run(execution_tasks.slow, list(tasks.values()))
        next(given)
        running.scheduler.kill()
        with pytest.raises(WorkError, match=f"^lost the Dask scheduler at {running.address}$"):
            list(given)
        with pytest.raises(WorkError, match=f"^lost the Dask scheduler at {running.address}$"):
            list(workers.run(execution_tasks.slow, list(tasks.values())))


def test_task_that_always_kills_its_dask_worker_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES", "0")
    with (
        cluster(workers=1) as running,
        cluster_workers(running.address) as workers,
        pytest.raises(WorkError, match="a task was under way on 1 Dask workers that died"),
    ):
        list(workers.run(execution_tasks.die, [1]))


@pytest.mark.filterwarnings("ignore:Mismatched versions")
def test_dask_worker_with_other_versions_is_refused(
    running: Cluster, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("distributed.versions._version_cached", lambda _: "0.0.other")
    with (
        pytest.raises(WorkError, match=r"^Dask worker tcp:.* needed is 0\.0\.other as here"),
        cluster_workers(running.address),
    ):
        pass


# ---- progress


def test_lines_where_there_is_no_terminal(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    clock = [100.0]
    monkeypatch.setattr(progressing.time, "monotonic", lambda: clock[0])
    with progressing.progress("cast labels", 800, 100) as step:
        for _ in range(700):
            clock[0] += 0.5
            step()
    lines = capsys.readouterr().err.splitlines()
    assert lines[0] == "cast labels: 120 of 800, 10 s, about 340 s left"
    assert lines[-1] == "cast labels: 800 of 800, 350 s"
    assert len(lines) == 35  # one every ten seconds


def test_silent_with_an_empty_title(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    with progressing.progress("", 2, 0) as step:
        step()
        step()
    assert capsys.readouterr().err == ""
    monkeypatch.setattr(sys, "stderr", None)  # started with it closed
    with progressing.progress("closed", 1, 0) as step:
        step()


def test_bar_on_a_terminal_that_knows_ascii_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    class Terminal(io.TextIOWrapper):
        def isatty(self) -> bool:
            return True

    raw = io.BytesIO()
    monkeypatch.setattr(sys, "stderr", Terminal(raw, encoding="ascii"))
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "100")
    with progressing.progress("train [1/2]", 4, 1) as step:
        step()
        step()
    sys.stderr.flush()
    told = raw.getvalue().decode("ascii")
    assert "train [1/2]" in told and "3/4" in told


def test_no_message_shows_a_password(tmp_path):
    assert str(Store("memory://user:secret@place/x")) == "memory://place/x"
    with pytest.raises(StoreError) as failure:
        Store("nosuch://user:secret@place/x")
    assert "secret" not in str(failure.value)
