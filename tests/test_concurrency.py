"""The same answers in forked children, spawned processes, threads and asyncio; a hang fails."""

from __future__ import annotations

import asyncio
import multiprocessing
import os
import select
import signal
import subprocess
import sys
import textwrap
import threading
import time
import traceback
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest
from helpers import answer_text, drawn, drawn_answer, seen
from numba.core.compiler_lock import global_compiler_lock

from boxgrasp import GraspSelector
from boxgrasp.execution import local_workers
from boxgrasp.forks import cached_property
from boxgrasp.io.frames import TransformBuffer
from boxgrasp.kernels import _threads
from boxgrasp.onnx import session
from boxgrasp.perception.segmentation.network import network_of

SEEDS = (0, 1, 2, 3)
HANG_S = 60  # far more than a child takes where the machine is busy

forks = pytest.mark.skipif(not hasattr(os, "fork"), reason="this system has no fork")
# Python 3.12 and newer warn of what is tested here: a fork while there are other threads.
pytestmark = pytest.mark.filterwarnings("ignore:.*multi-threaded.*fork:DeprecationWarning")


@pytest.fixture(scope="module")
def alone() -> dict[int, str]:
    """The answers, one after the other; they leave a pool, sessions and caches behind."""
    return {seed: drawn_answer(seed) for seed in SEEDS}


def in_child(work: Callable[[], str], wait_s: float = HANG_S) -> str:
    """What a bare fork makes of the work."""
    here, there = os.pipe()
    child = os.fork()
    if child == 0:
        try:
            said = work()
        except BaseException:
            said = traceback.format_exc()
        with open(there, "w", encoding="utf-8") as stream:
            stream.write(said)
        os._exit(0)
    os.close(there)
    said = b""
    end = time.monotonic() + wait_s
    try:
        with open(here, "rb", buffering=0) as stream:
            while select.select([here], [], [], max(0.0, end - time.monotonic()))[0]:
                part = stream.read(1 << 16)
                if not part:
                    return said.decode()
                said += part
        pytest.fail(f"the child hangs; before, it said {said[:200]!r}")
    finally:
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)


@contextmanager
def in_background(*works: Callable[[], object]) -> Iterator[None]:
    """Within, threads do the works again and again."""
    stop = threading.Event()

    def again(work: Callable[[], object]) -> None:
        while not stop.is_set():
            work()

    threads = [threading.Thread(target=again, args=(work,)) for work in works]
    for thread in threads:
        thread.start()
    try:
        yield
    finally:
        stop.set()
        for thread in threads:
            thread.join(HANG_S)


@forks
def test_a_hang_is_told() -> None:
    with pytest.raises(pytest.fail.Exception, match="hangs"):
        in_child(lambda: str(time.sleep(30)), 0.2)


@forks
def test_a_forked_child_selects(alone: dict[int, str]) -> None:
    assert network_of(None)._session._running is not None, "the parent holds a session"
    assert in_child(lambda: drawn_answer(0)) == alone[0]
    grandchild = in_child(lambda: in_child(lambda: drawn_answer(1), HANG_S / 2))
    assert grandchild == alone[1]
    assert drawn_answer(2) == alone[2], "the parent goes on as before"


@forks
def test_a_child_has_threads_of_its_own() -> None:
    def count() -> str:
        filled = np.zeros(90_000)
        names = set()

        def fill(first: int, last: int) -> None:
            filled[first:last] = 1
            names.add(threading.current_thread().name.split("_")[0])
            time.sleep(0.01)

        limit = _threads._limit.set(3)
        _threads.run_chunks(fill, len(filled))
        _threads._limit.reset(limit)
        return f"{filled.sum():.0f} {sorted(names)}"

    assert count() == "90000 ['MainThread', 'boxgrasp']"
    assert in_child(count) == "90000 ['MainThread', 'boxgrasp']"


@forks
def test_a_pool_of_forked_processes_selects(alone: dict[int, str]) -> None:
    with multiprocessing.get_context("fork").Pool(2) as pool:
        assert pool.map_async(drawn_answer, SEEDS).get(HANG_S) == list(alone.values())


@forks
def test_forks_while_other_threads_select(alone: dict[int, str]) -> None:
    works = [lambda seed=seed: drawn_answer(seed) for seed in (2, 3)]
    with in_background(*works):
        for _ in range(3):
            assert in_child(lambda: drawn_answer(0)) == alone[0]


@forks
@pytest.mark.parametrize("name", ["compiler", "session", "transforms"])
def test_a_lock_that_another_thread_holds_is_free_in_the_child(name: str) -> None:
    buffer = TransformBuffer()
    lock: Any = {
        "compiler": global_compiler_lock,
        "session": session._starting,
        "transforms": buffer._changed,
    }[name]
    taken = threading.Event()

    def hold() -> None:
        with lock:
            taken.set()
            time.sleep(0.2)

    def use() -> str:
        with lock:
            return "free"

    thread = threading.Thread(target=hold)
    thread.start()
    taken.wait()
    assert in_child(use) == "free"
    thread.join()
    assert use() == "free"


class Slow:
    """Has a value that takes a while."""

    begun, end = threading.Event(), threading.Event()

    @cached_property
    def value(self) -> int:
        """Known once; the first to ask waits."""
        if not self.begun.is_set():
            self.begun.set()
            self.end.wait(HANG_S)
        return 3


@forks
def test_a_value_that_another_thread_is_finding_is_found_by_the_child() -> None:
    thread = threading.Thread(target=lambda: Slow().value)
    thread.start()
    Slow.begun.wait()
    assert in_child(lambda: str(Slow().value)) == "3"
    Slow.end.set()
    thread.join()
    slow = Slow()
    assert slow.value == 3 and vars(slow) == {"value": 3}


@forks
def test_workers_stay_with_the_process_that_started_them() -> None:
    with local_workers(2) as workers:
        before = dict(workers.run(process_of, range(4)))

        def use() -> str:
            here = dict(workers.run(process_of, range(1)))
            workers.close()
            return str(set(here.values()) & set(before.values()))

        assert in_child(use) == "set()"
        assert set(dict(workers.run(process_of, range(4))).values()) <= set(before.values())


def process_of(_task: int) -> int:
    """The process of a task."""
    return os.getpid()


@forks
def test_a_child_that_ends_as_an_interpreter_does_ends() -> None:
    """Not by `os._exit`: what the parent held is destroyed, or would wait for lost threads."""
    code = f"""
    import os, sys, time
    from boxgrasp import GraspSelector
    from boxgrasp.simulate import demo_capture
    view, selector = demo_capture(), GraspSelector()
    selector.select(view)
    for selects in (False, True):
        child = os.fork()
        if child == 0:
            if selects:
                selector.select(view)
            sys.exit(7)
        end = time.monotonic() + {HANG_S}
        while (said := os.waitpid(child, os.WNOHANG)) == (0, 0):
            if time.monotonic() > end:
                os.kill(child, 9)
                sys.exit("the child hangs")
            time.sleep(0.01)
        print(os.waitstatus_to_exitcode(said[1]), flush=True)  # or children copy it
    """
    command = [sys.executable, "-c", textwrap.dedent(code)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=4 * HANG_S)
    assert (done.returncode, done.stdout) == (0, "7\n7\n"), done.stderr


def test_a_spawned_process_selects(alone: dict[int, str]) -> None:
    spawn = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(1, mp_context=spawn) as pool:
        assert pool.submit(drawn_answer, 0).result(2 * HANG_S) == alone[0]


def test_many_threads_select_at_once(alone: dict[int, str]) -> None:
    selector = GraspSelector()
    start = threading.Barrier(8)

    def ask(k: int) -> str:
        view = seen(drawn(SEEDS[k % 4]), SEEDS[k % 4])
        start.wait(HANG_S)
        return answer_text(selector.select(view))

    with ThreadPoolExecutor(8) as pool:
        said = list(pool.map(ask, range(8), timeout=2 * HANG_S))
    assert said == [alone[SEEDS[k % 4]] for k in range(8)]


def test_coroutines_select_while_the_loop_goes_on(alone: dict[int, str]) -> None:
    async def ask() -> tuple[list[str], int]:
        loop = asyncio.get_running_loop()
        turns = 0

        async def tick() -> None:
            nonlocal turns
            while True:
                await asyncio.sleep(0.01)
                turns += 1

        ticking = asyncio.ensure_future(tick())
        with ThreadPoolExecutor(2) as pool:
            said = await asyncio.gather(
                *(asyncio.to_thread(drawn_answer, seed) for seed in SEEDS[:2]),
                *(loop.run_in_executor(pool, drawn_answer, seed) for seed in SEEDS[2:]),
            )
        ticking.cancel()
        return said, turns

    said, turns = asyncio.run(asyncio.wait_for(ask(), 2 * HANG_S))
    assert said == list(alone.values())
    assert turns > 3, "the loop was held up"
