"""The tables that are the interface of hbbatch, and the checks that keep them honest.

Every field carries its unit and meaning in its Arrow metadata (`unit`, `description`), so a Parquet
file explains itself. `sequence_id` is not a column of the per-sequence files: it is the hive
partition they lie in (`detections/sequence_id=0001/part-0.parquet`).
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from hbbatch.errors import DatasetError

FORMAT_VERSION: Final = 1
"""Version of the dataset layout; a dataset with a higher one is refused, never guessed at."""

_VERSION_KEY: Final = b"hbbatch_format_version"


def _field(
    name: str, kind: pa.DataType, unit: str, description: str, *, nullable: bool = False
) -> pa.Field:
    return pa.field(name, kind, nullable, {"unit": unit, "description": description})


def _table(*fields: pa.Field) -> pa.Schema:
    return pa.schema(fields, {_VERSION_KEY: str(FORMAT_VERSION).encode()})


_FLOAT, _INT, _LONG, _TEXT = pa.float64(), pa.int32(), pa.int64(), pa.string()

_FRAME = (
    _field("frame_index", _INT, "1", "frame within the sequence, from 0, in time order"),
    _field("timestamp_ns", _LONG, "ns", "time of the frame (header stamp), since the Unix epoch"),
)


def _box(prefix: str, frame: str) -> tuple[pa.Field, ...]:
    return (
        _field(f"{prefix}x", _FLOAT, "m", f"box centre, {frame} frame"),
        _field(f"{prefix}y", _FLOAT, "m", f"box centre, {frame} frame"),
        _field(f"{prefix}z", _FLOAT, "m", f"box centre, {frame} frame, up"),
        _field(f"{prefix}length", _FLOAT, "m", "extent along the heading"),
        _field(f"{prefix}width", _FLOAT, "m", "extent across the heading"),
        _field(f"{prefix}height", _FLOAT, "m", "vertical extent"),
        _field(f"{prefix}yaw", _FLOAT, "rad", f"heading about z from x, {frame} frame"),
    )


_IMAGE_BOX = tuple(
    _field(f"image_{side}", _FLOAT, "px", f"{side} edge in the camera image", nullable=True)
    for side in ("left", "top", "right", "bottom")
)

DETECTIONS: Final = _table(
    *_FRAME,
    _field("detection_id", _LONG, "1", "row number within the sequence, from 0"),
    _field("class_name", _TEXT, "", "normalised class"),
    _field("class_name_logged", _TEXT, "", "class as the source wrote it"),
    _field("score", _FLOAT, "1", "as logged: not a probability, scale depends on the detector"),
    *_box("", "sensor"),
    _field("frame_id", _TEXT, "", "name of the sensor frame the box is in"),
    *_IMAGE_BOX,
    _field("source_row", _LONG, "1", "line (text) or message (log) it was read from, from 0"),
)
"""One row a detected box, as logged, in the sensor frame. Sorted by frame_index, detection_id."""

POSES: Final = _table(
    *_FRAME,
    _field("log_time_ns", _LONG, "ns", "when the recorder received the frame", nullable=True),
    *(_field(f"translation_{a}", _FLOAT, "m", "world_from_sensor translation") for a in "xyz"),
    *(_field(f"rotation_{a}", _FLOAT, "1", "world_from_sensor unit quaternion") for a in "xyzw"),
    _field("origin", _TEXT, "", "how the pose was obtained: logged, interpolated or identity"),
    _field("frame_id", _TEXT, "", "name of the sensor frame"),
)
"""One row a frame of the sequence, those without detections included. Sorted by frame_index."""

TRACKS: Final = _table(
    *_FRAME,
    _field("track_id", _LONG, "1", "identity within the sequence, from 1"),
    _field("class_name", _TEXT, "", "normalised class of the track"),
    _field("state", _TEXT, "", "detected, coasted (predicted), interpolated or extrapolated"),
    _field("score", _FLOAT, "1", "score of the matched detection", nullable=True),
    _field("track_score", _FLOAT, "1", "mean score of the track's detections (online: so far)"),
    _field("confidence", _FLOAT, "1", "probability of the box to be right", nullable=True),
    *_box("", "world"),
    *_box("sensor_", "sensor"),
    *(_field(f"velocity_{a}", _FLOAT, "m/s", f"{a} of the velocity, world frame") for a in "xyz"),
    _field("detection_id", _LONG, "1", "matched detection, null if none", nullable=True),
)
"""One row a track and frame. Sorted by frame_index, track_id."""

LABELS: Final = _table(
    *_FRAME,
    _field("object_id", _LONG, "1", "identity within the sequence; -1 marks a region to ignore"),
    _field("class_name", _TEXT, "", "normalised class, or dont_care"),
    _field("class_name_logged", _TEXT, "", "class as the source wrote it"),
    *(pa.field(f.name, f.type, True, f.metadata) for f in _box("", "sensor")),
    _field("frame_id", _TEXT, "", "name of the sensor frame the box is in"),
    *_IMAGE_BOX,
    _field("truncation", _FLOAT, "1", "KITTI truncation level; -1 unknown"),
    _field("occlusion", _INT, "1", "KITTI occlusion level; -1 unknown"),
)
"""One row a labelled object and frame, in the sensor frame; boxes are null in ignore regions."""

CATALOG: Final = _table(
    _field("sequence_id", _TEXT, "", "unique name of the sequence in the dataset"),
    _field("source", _TEXT, "", "file or folder it was ingested from"),
    _field("source_format", _TEXT, "", "format found in the source"),
    _field("source_hash", _TEXT, "", "hash of the source's content and of the ingest options"),
    _field("content_hash", _TEXT, "", "hash of the tables that tracking reads"),
    _field("frames", _LONG, "1", "frames in the sequence"),
    _field("detections", _LONG, "1", "detected boxes in the sequence"),
    _field("labels", _LONG, "1", "labelled boxes; 0 when there are no labels"),
    _field("duration_s", _FLOAT, "s", "last minus first frame time"),
    _field("pose_origin", _TEXT, "", "logged, interpolated or identity, the weakest of its frames"),
    _field("partial", pa.bool_(), "", "true when the source was damaged and part of it is lost"),
    _field("problems", pa.list_(_TEXT), "", "what was odd in the source, one line each"),
)
"""One row a sequence of the dataset."""

TIMING: Final = _table(
    _field("sequence_id", _TEXT, "", "sequence"),
    _field("frames", _LONG, "1", "frames stepped"),
    _field("detections", _LONG, "1", "detections given to the tracker"),
    _field("tracks", _LONG, "1", "tracks written"),
    _field("read_s", _FLOAT, "s", "reading Parquet and moving boxes to the world frame"),
    _field("predict_s", _FLOAT, "s", "share of the group's prediction time"),
    _field("associate_s", _FLOAT, "s", "share of the group's association time"),
    _field("update_s", _FLOAT, "s", "share of the group's update time"),
    _field("manage_s", _FLOAT, "s", "share of births, deaths and bookkeeping"),
    _field("write_s", _FLOAT, "s", "refining and writing the outputs"),
    _field("wall_s", _FLOAT, "s", "sum of the above: worker seconds spent on the sequence"),
    _field("frames_per_s", _FLOAT, "1/s", "frames / wall_s: one worker, start-up not counted"),
    _field("device", _TEXT, "", "cpu or cuda"),
    _field("worker", _INT, "1", "number of the worker process"),
    _field("peak_rss_mb", _FLOAT, "MB", "highest resident memory of the worker so far"),
)
"""One row a sequence of a run; a group's time is shared out by detections."""


def format_version(schema: pa.Schema) -> int:
    """The layout version a table was written with; 0 when it carries none."""
    return int((schema.metadata or {}).get(_VERSION_KEY, b"0"))


def only(schema: pa.Schema, columns: Iterable[str]) -> pa.Schema:
    """The schema of some of a table's columns."""
    return pa.schema([schema.field(name) for name in columns], schema.metadata)


def coded(schema: pa.Schema) -> pa.Schema:
    """A schema with its texts as dictionaries, for tables on their way to a file."""
    kind = pa.dictionary(pa.int32(), _TEXT)
    fields = [field.with_type(kind) if field.type == _TEXT else field for field in schema]
    return pa.schema(fields, schema.metadata)


def codes(texts: pa.ChunkedArray) -> tuple[NDArray[np.int64], list[str]]:
    """A column of texts as numbers `(n,)`, and the texts that they stand for."""
    coded = texts.combine_chunks().dictionary_encode()
    return coded.indices.to_numpy().astype(np.int64), coded.dictionary.to_pylist()


def conform(table: pa.Table, schema: pa.Schema, what: str) -> pa.Table:
    """The table with exactly the columns, types and metadata of a schema.

    Args:
        table: any table; extra columns are dropped, absent nullable ones are filled with null.
        schema: one of this module's schemas.
        what: how to name the table in an error ("detections of sequence 0001").

    Raises:
        DatasetError: a column is missing, has another type, or holds nulls it may not hold.
    """
    version = format_version(table.schema)
    if version > FORMAT_VERSION:
        raise DatasetError(
            f"{what}: written by a newer hbbatch (format {version}, this one reads up to "
            f"{FORMAT_VERSION}). Upgrade hbbatch."
        )
    there = dict(zip(table.column_names, table.columns, strict=True))
    columns = []
    for field in schema:
        column = there.get(field.name)
        if column is not None:
            columns.append(_conform_column(column, field, what))
        elif field.nullable:
            columns.append(pa.chunked_array([pa.nulls(table.num_rows, field.type)]))
        else:
            raise DatasetError(
                f"{what}: column {field.name!r} is missing. It holds: {', '.join(there)}."
            )
    return pa.Table.from_arrays(columns, schema=schema)


def _conform_column(column: pa.ChunkedArray, field: pa.Field, what: str) -> pa.ChunkedArray:
    try:
        column = column if column.type == field.type else column.cast(field.type)
    except (pa.ArrowInvalid, pa.ArrowNotImplementedError) as error:
        raise DatasetError(
            f"{what}: column {field.name!r} is {column.type}, expected {field.type} ({error})."
        ) from error
    if not field.nullable and column.null_count:
        raise DatasetError(
            f"{what}: column {field.name!r} holds {column.null_count} nulls, it may hold none."
        )
    return column
