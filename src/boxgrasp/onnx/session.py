"""ONNX files that carry a record of how they were made: told damaged from whole, and run."""

from __future__ import annotations

import ctypes
import hashlib
import os
import threading
from collections.abc import Callable, Collection, Mapping, Sequence
from os import PathLike, fspath
from pathlib import Path
from typing import Any, TypeVar
from weakref import WeakSet

from boxgrasp.errors import MissingExtraError, ModelError
from boxgrasp.forks import drop_in_child, held_at_fork
from boxgrasp.onnx import guard

# Keys of the ONNX file's metadata: the record, and the digest of graph and record.
RECORD_KEY, DIGEST_KEY = "boxgrasp", "boxgrasp_sha256"

T = TypeVar("T")


def load_file(source: str | PathLike[str], load: Callable[[bytes], T]) -> T:
    """What a file holds; whatever is wrong with it is said with its path.

    Args:
        source: the file's path.
        load: called with its bytes.

    Returns:
        What `load` returns.

    Raises:
        ModelError: unreadable, or as `load` says.
        MissingExtraError: as `load` says.
    """
    try:
        data = Path(source).read_bytes()
    except OSError as error:
        raise ModelError(f"{fspath(source)}: {error.strerror or error}") from None
    except ValueError as error:  # a name with a zero byte
        raise ModelError(f"{fspath(source)!r}: {error}") from None
    try:
        return load(data)
    except ModelError as error:
        raise ModelError(f"{fspath(source)}: {error}") from None


def digest(graph: bytes, record: bytes) -> str:
    """What tells that a file is damaged; it does not tell intent.

    Args:
        graph: as it is stored.
        record: as it is stored.

    Returns:
        SHA-256 of both, hexadecimal.
    """
    return hashlib.sha256(hashlib.sha256(graph).digest() + record).hexdigest()


def record_of(data: bytes) -> tuple[bytes, bool]:
    """The record inside an ONNX file.

    Args:
        data: the file's bytes.

    Returns:
        The record as it is stored, and whether graph and record match their digest.

    Raises:
        ModelError: not an ONNX file, or one without a record.
    """
    file = guard.parse(data)
    if RECORD_KEY not in file.metadata:
        raise ModelError("the ONNX file holds no record; valid: a model that boxgrasp trained")
    text = file.metadata[RECORD_KEY]
    return text, file.metadata.get(DIGEST_KEY) == digest(file.graph, text).encode()


class Session:
    """Runs a graph; safe from several threads, and in a forked child."""

    def __init__(self, start: Callable[[], Any]) -> None:
        """Start it.

        Args:
            start: makes an `onnxruntime.InferenceSession`, here and in every child.
        """
        self._start = start
        self._running: Any = start()
        _sessions.add(self)

    def run(self, outputs: Sequence[str], inputs: Mapping[str, Any]) -> list[Any]:
        """What the graph makes of its inputs.

        Args:
            outputs: names.
            inputs: arrays by name.

        Returns:
            An array for each output.
        """
        running = self._running
        if running is None:
            running = self._running = self._start()
        answer: list[Any] = running.run(outputs, inputs)
        return answer

    def forget(self) -> None:
        """Start anew with the next run; the old one would wait for threads that are not there."""
        if self._running is not None:
            ctypes.pythonapi.Py_IncRef(ctypes.py_object(self._running))  # never to be destroyed
            self._running = None


_sessions: WeakSet[Session] = WeakSet()
_starting = held_at_fork(threading.Lock())  # onnxruntime's own locks cannot be reached


def _forget_sessions() -> None:
    for session in list(_sessions):
        session.forget()


drop_in_child(_forget_sessions)


def _onnxruntime() -> Any:
    # From 1.29 on it tells its maker of every session, over the network and by a thread that keeps
    # a forked child from ending; the variable is read at its import, on Windows it has no effect.
    silent = os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1") == "1"
    try:
        import onnxruntime
    except ImportError:
        raise MissingExtraError(
            "trained models need onnxruntime; install with: pip install onnxruntime"
        ) from None
    if silent:
        onnxruntime.disable_telemetry_events()
    return onnxruntime


def open_session(data: bytes, operators: Collection[str], threads: int = 1) -> Session:
    """What runs a graph; no code of the file is run and no other file opened.

    Args:
        data: the file's bytes.
        operators: of the standard set, that it may hold.
        threads: that share the work of one call.

    Returns:
        The session.

    Raises:
        ModelError: the file holds more than plain arithmetic, or onnxruntime refuses it.
        MissingExtraError: onnxruntime is not installed.
    """
    guard.validate_plain(data, operators)
    ort = _onnxruntime()
    options = ort.SessionOptions()
    options.intra_op_num_threads, options.inter_op_num_threads = threads, 1
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")  # others need cores
    options.use_deterministic_compute = True
    options.log_severity_level = 4

    def start() -> Any:
        with _starting:
            return ort.InferenceSession(data, options, providers=["CPUExecutionProvider"])

    try:
        return Session(start)
    except Exception as error:  # onnxruntime's own errors share no other root
        said = " ".join(str(error).split())
        raise ModelError(f"onnxruntime refuses the graph: {said[:200]}") from None
