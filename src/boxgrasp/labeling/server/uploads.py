"""What a request to select brings: a capture, a target and settings, read by the package's readers.

Nothing of it is written to a disk; the layer before the app bounds the body.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from io import BytesIO
from typing import Any, Final

from starlette.datastructures import FormData, UploadFile
from starlette.formparsers import MultiPartException, MultiPartParser
from starlette.requests import Request

from boxgrasp.errors import CaptureError, MissingExtraError, TargetError
from boxgrasp.io.folder import FolderParts, capture_of_parts
from boxgrasp.io.images import png_size
from boxgrasp.io.npz import load_npz
from boxgrasp.io.pose import pose_of
from boxgrasp.io.refusals import refusals_of
from boxgrasp.labeling.server.security import UploadLimits
from boxgrasp.perception.target import Target
from boxgrasp.sensing.capture import Capture

FILES: Final = ("capture", "depth", "color", "mask", "robot_mask")
_OF_DEPTH: Final = ("intrinsics", "T_base_camera", "depth_scale")
TARGETS: Final = ("pixel", "object", "point", "box")
SETTINGS: Final = ("ranker", "faces", "checked")
_ARCHIVES: Final = ("application/octet-stream", "application/zip", "application/x-npz")
_MULTIPART: Final = "multipart/form-data"


class RequestError(Exception):
    """A request that gets no answer.

    Attributes:
        status: of HTTP: 400 unreadable, 413 too large, 415 another type, 422 no answer possible,
            503 busy.
    """

    def __init__(self, status: int, line: str) -> None:
        super().__init__(status, line)
        self.status = status
        self.line = line

    def __str__(self) -> str:
        return self.line


@dataclass(frozen=True)
class Settings:
    """What a request wants otherwise than the server's configuration; None where it does not say.

    Attributes:
        ranker: name of what orders the candidates.
        faces: that may be chosen.
        checked: False for the ranker's first candidate, whatever the checks say.
    """

    ranker: str | None = None
    faces: tuple[str, ...] | None = None
    checked: bool | None = None


@dataclass(frozen=True, eq=False)
class Upload:
    """A request as it came, not yet read.

    Attributes:
        files: bytes by their names in `FILES`.
        texts: every field that is none.
        limits: how much a capture may hold.
    """

    files: Mapping[str, bytes]
    texts: Mapping[str, str]
    limits: UploadLimits

    def capture(self) -> Capture:
        """The view that it brings.

        Returns:
            The capture; a mask beside a depth image is the capture's own.

        Raises:
            RequestError: damaged, missing, or no usable view.
        """
        try:
            if "capture" in self.files:
                archive = BytesIO(self.files["capture"])
                with refusals_of("capture"):
                    capture = load_npz(archive, self.limits.unpacked_bytes)
                self._validate_size(*(capture.shape or (0, 0)))
                return capture
            with refusals_of("depth"):
                width, height = png_size(BytesIO(self.files["depth"]))
            self._validate_size(height, width)
            with refusals_of("depth"):
                return capture_of_parts(self._parts((width, height)))
        except (CaptureError, MissingExtraError) as error:
            raise RequestError(400, str(error)) from None

    def _parts(self, size: tuple[int, int]) -> FolderParts:
        told: dict[str, Any] = {}
        if self._has("depth_scale"):
            told["depth_scale"] = _json(self.texts["depth_scale"], "depth_scale")
        if self._has("T_base_camera"):
            told["T_base_camera"] = pose_of(_json(self.texts["T_base_camera"], "T_base_camera"))
        camera = _camera(_json(self.texts["intrinsics"], "intrinsics"), size)
        images = {
            name: BytesIO(self.files[name])
            for name in ("color", "mask", "robot_mask")
            if name in self.files
        }
        return FolderParts(BytesIO(self.files["depth"]), camera, told, **images)

    def _validate_size(self, height: int, width: int) -> None:
        if width * height > self.limits.pixels:
            raise RequestError(
                413, f"depth has {width} x {height} pixels; valid: at most {self.limits.pixels}"
            )

    def target(self) -> Target | None:
        """The object that is wanted.

        Returns:
            The target; None for the capture's own mask or pixel.

        Raises:
            RequestError: not numbers, or more than one is given.
        """
        given = {
            name: read(self.texts[name], name) for name, read in _READ.items() if self._has(name)
        }
        try:
            return Target(**given) if given else None
        except TargetError as error:
            raise RequestError(400, str(error)) from None

    def settings(self) -> Settings:
        """What it wants otherwise than the server's configuration.

        Returns:
            The settings, the ranker and faces not yet judged.

        Raises:
            RequestError: `checked` is neither true nor false.
        """
        checked = self.texts.get("checked") if self._has("checked") else None
        if checked not in (None, "true", "false"):
            raise RequestError(400, f"checked is {checked!r:.40}; valid: true, false")
        faces = (face.strip() for face in self.texts.get("faces", "").split(","))
        return Settings(
            ranker=self.texts["ranker"] if self._has("ranker") else None,
            faces=tuple(face for face in faces if face) if self._has("faces") else None,
            checked=None if checked is None else checked == "true",
        )

    def text(self, name: str) -> str:
        """A field that is text.

        Args:
            name: of the field.

        Returns:
            What it holds; nothing where it is not given.
        """
        return self.texts.get(name, "")

    def _has(self, name: str) -> bool:
        return self.texts.get(name, "") != ""


async def read_upload(request: Request, limits: UploadLimits, more: tuple[str, ...] = ()) -> Upload:
    """Take a request's body, all of it, and its parameters.

    Args:
        request: whose body nobody has read.
        limits: how much it may hold.
        more: names of further parameters.

    Returns:
        The upload.

    Raises:
        RequestError: another type, an unknown or doubled name, too many parts, or no capture.
    """
    kind = request.headers.get("content-type", "").partition(";")[0].strip().lower()
    known = (*TARGETS, *SETTINGS, *more)
    texts: dict[str, str] = {}
    files: dict[str, bytes] = {}
    for name, value in request.query_params.multi_items():
        if name != "token":
            _take(texts, name, value, known)
    if kind in _ARCHIVES:
        files["capture"] = await request.body()
    elif kind == _MULTIPART:
        for name, part in (await _form(request, limits)).multi_items():
            if isinstance(part, UploadFile) and name in FILES:
                _take(files, name, await part.read(), FILES)
            else:
                text = await _text(part, name, limits)
                _take(texts, name, text, (*known, *_OF_DEPTH))
    else:
        raise RequestError(
            415,
            f"Content-Type is {repr(kind)[:60] if kind else 'missing'}; valid: "
            f"{_ARCHIVES[0]} (an .npz), "
            f"{_MULTIPART}",
        )
    _validate_parts(files, texts)
    return Upload(files, texts, limits)


def _validate_parts(files: Mapping[str, bytes], texts: Mapping[str, str]) -> None:
    """Refuse what makes no capture, or two.

    Raises:
        RequestError: it does.
    """
    beside = [name for name in (*FILES[1:], *_OF_DEPTH) if name in files or name in texts]
    if "capture" in files:
        if beside:
            raise RequestError(400, f"capture and {beside[0]} are given; valid: one of them")
        return
    for name, held in (("depth", files), ("intrinsics", texts)):
        if name not in held:
            raise RequestError(
                400,
                f"{name} is missing; valid: a file `capture` (.npz), or a file `depth` (16-bit "
                "PNG) with `intrinsics`",
            )


def _take(held: dict[str, Any], name: str, value: Any, known: tuple[str, ...]) -> None:
    """Keep a part under its name.

    Raises:
        RequestError: unknown, or there already.
    """
    if name not in known:
        raise RequestError(400, f"unknown name {name!r:.40}; valid: {', '.join(known)}")
    if name in held:
        raise RequestError(400, f"{name} is given twice; valid: once")
    held[name] = value


async def _form(request: Request, limits: UploadLimits) -> FormData:
    parser = MultiPartParser(
        request.headers,
        request.stream(),
        max_files=limits.parts,
        max_fields=limits.parts,
        max_part_size=limits.field_bytes,
    )
    parser.spool_max_size = limits.body_bytes + 1  # in memory, which the body's limit bounds
    try:
        return await parser.parse()
    except MultiPartException as error:
        over = "exceeded" in error.message or "Too many" in error.message
        line = (
            f"{error.message.rstrip('.')}; valid: multipart of at most {limits.parts} files and "
            f"{limits.parts} fields of {limits.field_bytes} bytes"
        )
        raise RequestError(413 if over else 400, line) from None


async def _text(part: UploadFile | str, name: str, limits: UploadLimits) -> str:
    """A field's text, which some programs send as a file.

    Raises:
        RequestError: a file of bytes, or too long.
    """
    if isinstance(part, str):
        return part
    data = await part.read(limits.field_bytes + 1)
    if len(data) > limits.field_bytes:
        raise RequestError(413, f"{name!r:.40} is over {limits.field_bytes} bytes; valid: a field")
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError:
        raise RequestError(400, f"{name!r:.40} holds bytes; valid: text") from None


def _json(text: str, name: str) -> Any:
    try:
        return json.loads(text)
    except (ValueError, RecursionError) as error:
        raise CaptureError(f"{name} is no JSON: {error}") from None


def _camera(found: Any, size: tuple[int, int]) -> dict[str, Any]:
    """The object of a folder's intrinsics.json, also of rows of 3.

    Raises:
        CaptureError: neither.
    """
    if isinstance(found, dict):
        return found
    valid = "valid: fx, fy, cx, cy, width, height, or 3 rows of 3, fx 0 cx, 0 fy cy, 0 0 1"
    rows = found if isinstance(found, list) else []
    flat = [value for row in rows if isinstance(row, list) for value in row]
    if len(rows) != 3 or len(flat) != 9 or [len(row) for row in rows] != [3, 3, 3]:
        raise CaptureError(f"intrinsics is {found!r:.60}; {valid}")
    if [flat[k] for k in (1, 3, 6, 7, 8)] != [0, 0, 0, 0, 1]:
        raise CaptureError(f"intrinsics has rows {found!r:.60}; {valid}")
    named = {"fx": flat[0], "fy": flat[4], "cx": flat[2], "cy": flat[5]}
    return {**named, "width": size[0], "height": size[1]}


def _numbers(count: int, valid: str, kind: type[int] | type[float]) -> Callable[[str, str], Any]:
    """A reader of numbers with commas between them."""

    def read(text: str, name: str) -> Any:
        try:
            found = tuple(kind(part) for part in text.split(","))
            if len(found) == count and all(map(math.isfinite, found)):
                return found if count > 1 else found[0]
        except (ValueError, OverflowError):
            pass
        raise RequestError(400, f"{name} is {text!r:.40}; valid: {valid}")

    return read


_READ: Final[Mapping[str, Callable[[str, str], Any]]] = {
    "pixel": _numbers(2, "u,v, whole pixels", int),
    "object": _numbers(1, "a whole number, from 1", int),
    "point": _numbers(3, "x,y,z in meters, base frame", float),
    "box": _numbers(4, "u0,v0,u1,v1, pixels", float),
}
