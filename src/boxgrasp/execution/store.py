"""A place for results: a folder, or any fsspec URL (`s3://`, `memory://`, ...)."""

from __future__ import annotations

import contextlib
import os
import re
from pathlib import Path
from typing import Any
from urllib.request import url2pathname

from boxgrasp.errors import MissingExtraError, StoreError

_UNFINISHED = ".unfinished-"


class Store:
    """Named bytes at a place; a name is a relative path with forward slashes.

    Args:
        place: a folder, or any fsspec URL.

    Attributes:
        place: as given.

    Raises:
        StoreError: the place cannot be used.
        MissingExtraError: a URL, without fsspec.
    """

    place: str

    def __init__(self, place: str | os.PathLike[str]) -> None:
        self.place = os.fspath(place)
        if not self.place:
            raise StoreError("no place given; valid: a folder or an fsspec URL")
        self._remote: Any = None
        self._root = self.place
        if self.place.startswith("file://"):
            self._root = url2pathname(self.place.removeprefix("file://"))
        elif "://" in self.place:
            self._remote, self._root = _file_system(self.place)

    @property
    def folder(self) -> str | None:
        """The folder on this machine; None for a URL."""
        return None if self._remote is not None else self._root

    def __str__(self) -> str:
        return _without_password(self.place.rstrip("/"))

    def exists(self, name: str) -> bool:
        """Whether something is kept under a name.

        Args:
            name: relative path.

        Returns:
            Whether it is.

        Raises:
            StoreError: the place cannot be reached.
        """
        if self._remote is None:
            return os.path.isfile(self._path(name))
        with _told(self, name):
            self._remote.invalidate_cache()  # a listing kept from before the last run is stale
            try:  # not `isfile`, to which what cannot be reached is not there
                return bool(self._remote.info(self._path(name))["type"] == "file")
            except (FileNotFoundError, NotADirectoryError):
                return False

    def read(self, name: str) -> bytes:
        """What is kept under a name.

        Args:
            name: relative path.

        Returns:
            Its bytes.

        Raises:
            StoreError: nothing is, or it cannot be read.
        """
        with _told(self, name):
            if self._remote is None:
                return Path(self._path(name)).read_bytes()
            return bytes(self._remote.cat_file(self._path(name)))

    def write(self, name: str, data: bytes) -> None:
        """Keep bytes under a name, wholly or not at all.

        Args:
            name: relative path.
            data: the bytes.

        Raises:
            StoreError: they cannot be written.
        """
        path = self._path(name)
        with _told(self, name):
            if self._remote is not None:
                self._put(path, data)
                return
            folder, last = os.path.split(path)
            os.makedirs(folder or ".", exist_ok=True)
            unfinished = os.path.join(folder, f"{_UNFINISHED}{os.getpid()}-{last}")
            try:
                with open(unfinished, "wb") as file:
                    file.write(data)
                    file.flush()
                    os.fsync(file.fileno())
                os.replace(unfinished, path)
            except BaseException:
                with contextlib.suppress(FileNotFoundError):
                    os.unlink(unfinished)
                raise

    def _put(self, path: str, data: bytes) -> None:
        try:
            self._remote.pipe_file(path, data)
        except FileNotFoundError:  # a file system that wants its folders made
            self._remote.makedirs(path.rsplit("/", 1)[0], exist_ok=True)
            self._remote.pipe_file(path, data)

    def _path(self, name: str) -> str:
        return f"{self._root.rstrip('/')}/{name}" if self._root else name


class _told:  # noqa: N801 - reads as a verb where it is used
    """Turns what a file system raises into one line."""

    def __init__(self, store: Store, name: str) -> None:
        self.where = f"{store}/{name}"

    def __enter__(self) -> None:
        return None

    def __exit__(self, kind: Any, error: BaseException | None, trace: Any) -> None:
        if isinstance(error, Exception) and not isinstance(error, StoreError):
            text = getattr(error, "strerror", None) or " ".join(str(error).split())
            what = text or type(error).__name__
            raise StoreError(f"{self.where}: {what}; valid: a place to read and write") from None


def _without_password(text: str) -> str:
    """A URL as it may be printed."""
    return re.sub(r"//[^/@\s]*@", "//", text)


def _file_system(url: str) -> tuple[Any, str]:
    try:
        import fsspec
    except ImportError:
        raise MissingExtraError(
            f"{url} needs fsspec; install with: pip install 'boxgrasp[train]'"
        ) from None
    try:
        system, path = fsspec.core.url_to_fs(url)
    except (ValueError, ImportError, OSError) as error:
        said = f"{_without_password(url)}: {type(error).__name__}: {_without_password(str(error))}"
        raise StoreError(f"{said}; valid: a folder or an fsspec URL") from None
    return system, str(path)
