"""Captures kept by their content, so that a label always leads back to what was labeled."""

from __future__ import annotations

import hashlib
import io
import json
import re
import zipfile
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from boxgrasp.errors import BoxgraspError, CaptureError, CodedWarning, StoreError
from boxgrasp.execution import Store
from boxgrasp.sensing.capture import Capture

_FORM: Final = b"boxgrasp capture 1"  # of what is hashed; another number for another form
# Arrays of a capture in the order in which they are hashed.
_ARRAYS: Final = (
    *("depth", "intrinsics", "T_base_camera", "rgb", "mask", "target_pixel", "robot_mask"),
    *("points", "colors", "cloud_frame"),
)
_WARNINGS: Final = "warnings"  # of the reader; not hashed, since they tell of the file
_SHA256: Final = re.compile(r"[0-9a-f]{64}")


class CaptureStore:
    """Captures under the hash of their arrays: `captures/ab/abcd....npz`.

    Args:
        store: a folder or an fsspec URL, beside the database.
    """

    def __init__(self, store: Store) -> None:
        self.store = store

    def add(self, capture: Capture) -> str:
        """Keep a capture; one that is there is not written again.

        Args:
            capture: any.

        Returns:
            SHA-256 of its content, hexadecimal.

        Raises:
            StoreError: it cannot be written.
        """
        arrays = _arrays_of(capture)
        sha256 = _sha256(arrays)
        name = _name(sha256)
        if not self.store.exists(name):
            out = io.BytesIO()
            told = [[warning.code, warning.message] for warning in capture.warnings]
            arrays[_WARNINGS] = np.frombuffer(json.dumps(told).encode(), np.uint8)
            np.savez_compressed(out, **arrays)  # type: ignore[arg-type]
            self.store.write(name, out.getvalue())
        return sha256

    def read(self, sha256: str) -> Capture:
        """A capture that was kept.

        Args:
            sha256: what `add` gave.

        Returns:
            The same capture.

        Raises:
            CaptureError: no hash, or what is kept under it is damaged.
            StoreError: nothing is kept under it, or it cannot be read.
        """
        if not _SHA256.fullmatch(sha256):
            raise CaptureError(f"{sha256!r:.80} is no capture's hash; valid: 64 hexadecimal digits")
        name = _name(sha256)
        if not self.store.exists(name):
            raise StoreError(
                f"{self.store} keeps no capture {sha256[:12]}; valid: the place that was beside "
                "the database when it was labeled"
            )
        try:
            with np.load(io.BytesIO(self.store.read(name)), allow_pickle=False) as archive:
                arrays = {key: archive[key] for key in archive.files}
            told = bytes(arrays.pop(_WARNINGS, np.frombuffer(b"[]", np.uint8)))
            whole = _sha256(arrays) == sha256
            warnings = [CodedWarning(str(code), str(said)) for code, said in json.loads(told)]
            if whole:
                return _capture_of(arrays).with_warnings(*warnings)
        except (ValueError, KeyError, TypeError, EOFError, zipfile.BadZipFile, CaptureError):
            pass
        raise CaptureError(
            f"{self.store}/{name} is damaged: its content is not what its name says; valid: the "
            "file as boxgrasp wrote it"
        )


def capture_sha256(capture: Capture) -> str:
    """What tells a capture from every other one: of its arrays, not of the file that held them.

    Args:
        capture: any.

    Returns:
        SHA-256, hexadecimal.
    """
    return _sha256(_arrays_of(capture))


def _name(sha256: str) -> str:
    return f"captures/{sha256[:2]}/{sha256}.npz"


def _arrays_of(capture: Capture) -> dict[str, NDArray[Any]]:
    """Its arrays by name, images and organized clouds in their shape."""
    found = {key: getattr(capture, key) for key in _ARRAYS}
    if capture.points is None:
        del found["cloud_frame"]
    elif capture.cloud_shape is not None:
        for key in ("points", "colors"):
            if found[key] is not None:
                found[key] = found[key].reshape(*capture.cloud_shape, 3)
    return {key: np.asarray(value) for key, value in found.items() if value is not None}


def _sha256(arrays: dict[str, NDArray[Any]]) -> str:
    said = hashlib.sha256(_FORM)
    if not set(arrays) <= set(_ARRAYS):
        raise KeyError(str(sorted(set(arrays) - set(_ARRAYS))))
    for key in _ARRAYS:
        if key in arrays:
            value = arrays[key]
            value = value.astype(value.dtype.newbyteorder("<"), order="C", copy=False)
            said.update(f"\n{key} {value.dtype.str} {value.shape}\n".encode())
            said.update(value.tobytes())
    return said.hexdigest()


def _capture_of(arrays: dict[str, NDArray[Any]]) -> Capture:
    if "points" in arrays:
        frame = str(arrays.pop("cloud_frame"))
        if frame not in ("optical", "base"):
            raise BoxgraspError(frame)
        return Capture.from_cloud(arrays.pop("points"), cloud_frame=frame, **arrays)  # type: ignore[arg-type]
    return Capture(**arrays)  # type: ignore[arg-type]
