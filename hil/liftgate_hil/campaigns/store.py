"""Store of a campaign's results: one Parquet file per batch, named by the hash of its variants.

A file is written beside its place and renamed, so that it is there whole or not at all, and a batch that two
processes have evaluated is there once. Campaigns may share a store: the names of their temporary files tell whose
they are.
"""

from __future__ import annotations

import contextlib
import io
import os
import uuid
from collections.abc import Collection
from pathlib import Path
from typing import TYPE_CHECKING, Any

from liftgate_compiler.files import remove_leftovers, write_whole
from liftgate_hil.errors import ConfigError, LiftgateError, words_of

if TYPE_CHECKING:
    import pyarrow as pa

SUFFIX = ".parquet"
KEPT = "what is in the store is kept: go on with --resume"  # end of a message


class StoreError(LiftgateError):
    """Raised where results cannot be written or read: a full disk, a folder that vanished."""


def reason_of(error: Exception) -> str:
    """Return an error's message; of an OSError only the system's (strerror), as libraries wrap it in their own."""
    if isinstance(error, OSError) and error.errno:
        return os.strerror(error.errno)
    return words_of(error)


def packed(table: pa.Table) -> bytes:
    """Return a batch's table as the bytes of a Parquet file."""
    import pyarrow.parquet as pq

    buffer = io.BytesIO()
    pq.write_table(table, buffer, compression="zstd", write_page_checksum=True)
    return buffer.getvalue()


def unpacked(content: bytes) -> pa.Table | None:
    """Return the table from the bytes of a Parquet file; None: they are damaged."""
    import pyarrow.parquet as pq

    try:
        return pq.read_table(io.BytesIO(content), page_checksum_verification=True)
    except Exception:  # whatever a damaged file makes of the reader
        return None


class Store:
    """Folder of batch files, on this machine or at an fsspec address. It is picklable.

    `owner` is the token of the campaign that writes to it: `Folder.token`.
    """

    def __init__(self, address: str, owner: str = "") -> None:
        self.address, self._owner = address, owner
        self._is_remote = "://" in address

    def create(self) -> None:
        """Create the folder, if it is not there. Raises ConfigError where that fails."""
        try:
            if self._is_remote:
                fs, path = self._remote()
                fs.makedirs(path, exist_ok=True)
            else:
                Path(self.address).mkdir(parents=True, exist_ok=True)
        except Exception as error:  # of any file system's driver
            raise ConfigError(
                f"`store` {self.address}: {reason_of(error)}; allowed: a folder to write to"
            ) from error

    def mark(self) -> str:
        """Write a marker file by which other machines see whether they share the store; return its name."""
        name = _beside("campaign", self._owner)
        self._write(name, b"")
        return name

    def unmark(self, name: str) -> None:
        """Remove the marker file of `mark`."""
        with contextlib.suppress(Exception):
            self._remove(name)

    def is_shared(self, mark: str) -> bool:
        """Whether this process sees a marker file of `mark`, and so shares the store."""
        try:
            if self._is_remote:
                fs, path = self._remote()
                return bool(fs.exists(f"{path}/{mark}"))
            return (Path(self.address) / mark).exists()
        except Exception:
            return False

    def put(self, name: str, table: pa.Table) -> None:
        """Write the table of a batch. Raises StoreError."""
        self._write(name + SUFFIX, packed(table))

    def get(self, name: str) -> pa.Table | None:
        """Return the table of a batch; None: it is not there, or its file is damaged. Raises StoreError."""
        try:
            if self._is_remote:
                fs, path = self._remote()
                content = bytes(fs.cat_file(f"{path}/{name}{SUFFIX}"))
            else:
                content = (Path(self.address) / f"{name}{SUFFIX}").read_bytes()
        except FileNotFoundError:
            return None
        except Exception as error:
            raise StoreError(f"{self.address}: {reason_of(error)}") from error
        return unpacked(content)

    def names(self) -> set[str]:
        """Return the names of all stored batches. Raises StoreError."""
        try:
            found = self._files()
        except Exception as error:
            raise StoreError(f"{self.address}: {reason_of(error)}") from error
        return {each.removesuffix(SUFFIX) for each in found if each.endswith(SUFFIX) and not each.startswith(".")}

    def tidy(self, owners: Collection[str]) -> None:
        """Remove temporary files left by killed processes, of ended campaigns with the tokens `owners`."""
        if not self._is_remote:
            remove_leftovers(Path(self.address))  # by their locks
        with contextlib.suppress(Exception):
            for each in self._files():
                if _is_beside(each, owners):
                    with contextlib.suppress(Exception):
                        self._remove(each)

    def _remote(self) -> tuple[Any, str]:
        try:
            from fsspec.core import url_to_fs
        except ImportError:
            raise ConfigError(
                f"`store` {self.address}: allowed: a folder; an address needs liftgate-hil[cluster]"
            ) from None
        return url_to_fs(self.address)  # type: ignore[no-any-return]

    def _files(self) -> list[str]:
        if self._is_remote:
            fs, path = self._remote()
            fs.invalidate_cache(path)  # other machines write there too
            return [each.rsplit("/", 1)[-1] for each in fs.ls(path, detail=False)]
        return [each.name for each in Path(self.address).iterdir()]

    def _remove(self, name: str) -> None:
        if self._is_remote:
            fs, path = self._remote()
            fs.rm(f"{path}/{name}")
        else:
            (Path(self.address) / name).unlink()

    def _write(self, name: str, content: bytes) -> None:
        """Write a file of the store atomically: a temporary file, then renamed. Raises StoreError."""
        try:
            if self._is_remote:
                (fs, path), beside = self._remote(), _beside(name, self._owner)
                fs.pipe_file(f"{path}/{beside}", content)
                fs.mv(f"{path}/{beside}", f"{path}/{name}")
            else:
                write_whole(Path(self.address) / name, content)
        except Exception as error:
            raise StoreError(f"{self.address}: {reason_of(error)}") from error


def _beside(name: str, owner: str) -> str:
    """Return the name of a temporary file that contains its owner's token, which has no dots."""
    return f".{name}.{owner}.{uuid.uuid4().hex}"


def _is_beside(name: str, owners: Collection[str]) -> bool:
    """Whether a file name is one of `_beside`, for one of these owners."""
    parts = name.split(".")
    return len(parts) > 3 and not parts[0] and parts[-2] in owners
