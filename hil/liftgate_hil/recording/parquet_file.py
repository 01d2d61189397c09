"""Parquet by pyarrow: a column a signal with its unit, a row group at a time, so that memory does not grow."""

from __future__ import annotations

from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.mcap_layout import ABOUT_PARQUET, START_PARQUET
from liftgate_hil.recording.content import Batch, Content

_GROUP = 65_536  # rows


class ParquetRecorder:
    """See Recorder."""

    def __init__(self, stream: BinaryIO, content: Content) -> None:
        import pyarrow
        from pyarrow import parquet

        self._arrow = pyarrow
        self._stream = stream
        self._content = content
        whole = [name for name in content.columns if content.row[name].is_whole]
        self._schema = pyarrow.schema(
            [
                pyarrow.field(
                    name,
                    pyarrow.int64() if name in whole else pyarrow.float64(),
                    metadata={"unit": content.unit_of(name)},
                )
                for name in content.columns
            ],
            metadata={
                "title": content.title,
                **({ABOUT_PARQUET: content.about} if content.about else {}),
            },
        )
        # A dictionary pays where values come again.
        self._writer: Any = parquet.ParquetWriter(stream, self._schema, use_dictionary=whole)
        self._batch = Batch(_GROUP)
        self._epoch_ns = 0

    @property
    def written(self) -> int:
        """See Recorder."""
        return self._stream.tell() + self._batch.nbytes

    def begin(self, epoch_ns: int) -> None:
        """See Recorder."""
        self._epoch_ns = epoch_ns

    def write_rows(self, rows: NDArray[np.float64]) -> None:
        """See Recorder."""
        self._write(self._batch.add(rows))

    def write_frames(self, frames: Any) -> None:
        """See Recorder."""

    def flush(self) -> None:
        """See Recorder."""
        self._stream.flush()

    def close(self) -> None:
        """See Recorder."""
        self._write(self._batch.take())
        if self._epoch_ns:
            self._writer.add_key_value_metadata({START_PARQUET: str(self._epoch_ns)})
        if remark := self._content.remark():
            self._writer.add_key_value_metadata({"remark": remark})
        self._writer.close()
        self._stream.close()

    def _write(self, rows: NDArray[np.float64] | None) -> None:
        if rows is None:
            return
        wanted = zip(self._content.columns, self._content.places, strict=True)
        columns = [self._column(rows[:, place], name) for name, place in wanted]
        batch = self._arrow.record_batch(columns, schema=self._schema)
        self._writer.write_batch(batch, row_group_size=len(rows))

    def _column(self, values: NDArray[np.float64], name: str) -> Any:
        if not self._content.row[name].is_whole:
            return self._arrow.array(np.ascontiguousarray(values))
        there = np.isfinite(values)  # not so of a plant that has diverged
        return self._arrow.array(np.where(there, values, 0.0).astype(np.int64), mask=~there)
