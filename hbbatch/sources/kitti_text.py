"""Lines of KITTI text files as checked columns; an error names the file and the line.

Layouts: the label and result format of the KITTI development kits (Geiger et al., CVPR 2012), and
the CSV that AB3DMOT (Weng et al., IROS 2020) made of it.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from hbbatch.boxes import FloatArray
from hbbatch.errors import SourceError
from hbbatch.sources.base import IntArray

_OBJECT: Final = (
    "type truncation occlusion alpha left top right bottom height width length x y z ry"
)


@dataclass(frozen=True)
class Layout:
    """What the columns of a line mean; `type` is text, all others are numbers."""

    header: str
    separator: str | None = None

    @property
    def columns(self) -> list[str]:
        """Names of the columns."""
        return self.header.split()


LABEL_LAYOUT: Final = Layout(f"frame id {_OBJECT}")
SEQUENCE_LAYOUT: Final = Layout(f"frame {_OBJECT} score")
FRAME_LAYOUT: Final = Layout(f"{_OBJECT} score")
CSV_LAYOUT: Final = Layout(
    "frame type left top right bottom score height width length x y z ry alpha", ","
)
CSV_CLASSES: Final = {"1": "Pedestrian", "2": "Car", "3": "Cyclist"}
OXTS_COLUMNS: Final = 30
_LARGEST_PLACE: Final = (89.9, 360.0, 1e5)
"""Latitude and longitude (degrees), altitude (m)."""

_LARGEST_MEASURED: Final = 1e9
"""Of anything else, in whatever unit."""
OXTS_FORWARD: Final = 8


@dataclass(frozen=True)
class TextRows:
    """Checked lines of one file.

    Attributes:
        path: the file.
        lines: `(n,)` line numbers from 0; blank lines are left out.
        types: the `type` of each line.
        values: each numeric column, `(n,)`, finite.
    """

    path: Path
    lines: IntArray
    types: list[str]
    values: dict[str, FloatArray]

    def stack(self, names: str) -> FloatArray:
        """Some columns side by side, `(n, columns)`."""
        return np.stack([self.values[name] for name in names.split()], axis=1)

    def whole(self, name: str, minimum: int) -> IntArray:
        """A column of whole numbers.

        Raises:
            SourceError: a value is no whole number, less than the minimum, or above 32 bits.
        """
        values = self.values[name]
        wrong = (values % 1 != 0) | (values < minimum) | (values >= 2**31)
        self.refuse(wrong, f"{name} is not a whole number from {minimum}")
        return values.astype(np.int64)

    def refuse(self, wrong: NDArray[np.bool_], what: str) -> None:
        """Raise a SourceError naming the first wrong line, if there is any."""
        if wrong.any():
            raise line_error(self.path, int(self.lines[np.argmax(wrong)]), what)


def line_error(path: Path, line: int, what: str) -> SourceError:
    """An error at a line, counted from 0."""
    return SourceError(f"{path}:{line + 1}: {what}. Repair or remove that line, then ingest again.")


def read_text(path: Path) -> str:
    """The content of a text file.

    Raises:
        SourceError: it is no text.
        OSError: it is missing or unreadable.
    """
    try:
        return path.read_text(encoding="utf-8")
    except UnicodeDecodeError as error:
        raise SourceError(
            f"{path}: is no text file (byte {error.start}). Restore it from its origin."
        ) from error


def parse_rows(path: Path, layout: Layout | None = None) -> TextRows:
    """All lines of a file.

    Args:
        path: the file.
        layout: None tells the two one-file-a-sequence layouts apart by their separator.

    Raises:
        SourceError: a line has another number of columns, or a value that is no finite number.
    """
    text = read_text(path)
    if layout is None:
        layout = CSV_LAYOUT if "," in text.partition("\n")[0] else SEQUENCE_LAYOUT
    numbered = [(n, line) for n, line in enumerate(text.splitlines()) if line.strip()]
    fields = [line.split(layout.separator) for _, line in numbered]
    lines = np.array([number for number, _ in numbered], dtype=np.int64)
    _check_widths(path, lines, fields, layout)
    kind = layout.columns.index("type")
    types = [row.pop(kind).strip() for row in fields]
    names = [name for name in layout.columns if name != "type"]
    numbers = parse_numbers(path, lines, fields, len(names))
    values = {name: numbers[:, column] for column, name in enumerate(names)}
    if layout is CSV_LAYOUT:
        types = [CSV_CLASSES.get(code, code) for code in types]
    return TextRows(path, lines, types, values)


def _check_widths(path: Path, lines: IntArray, fields: list[list[str]], layout: Layout) -> None:
    expected = len(layout.columns)
    for number, row in zip(lines, fields, strict=True):
        if len(row) != expected:
            what = f"{len(row)} columns, expected {expected} ({layout.header})"
            raise line_error(path, int(number), what)


def parse_numbers(path: Path, lines: IntArray, fields: list[list[str]], columns: int) -> FloatArray:
    """Rows of number texts, all of the same width, `(n, columns)`.

    Raises:
        SourceError: a text is no finite number.
    """
    try:
        numbers = np.array([[float(text) for text in row] for row in fields], dtype=np.float64)
    except ValueError:
        number, text = _first_unreadable(lines, fields)
        raise line_error(path, number, f"{text!r} is not a number") from None
    numbers = numbers.reshape(-1, columns)
    finite = np.isfinite(numbers)
    if not finite.all():
        row, column = np.argwhere(~finite)[0]
        raise line_error(path, int(lines[row]), f"{fields[row][column].strip()} is not a number")
    return numbers


def _first_unreadable(lines: IntArray, fields: Iterable[list[str]]) -> tuple[int, str]:
    for number, row in zip(lines, fields, strict=True):
        for text in row:
            try:
                float(text)
            except ValueError:
                return int(number), text.strip()
    raise AssertionError("called without an unreadable number")


def parse_oxts(path: Path) -> FloatArray:
    """The 30 columns of each line, `(n, 30)`.

    The first are latitude, longitude (degrees), altitude (m), roll, pitch, yaw (rad), velocity
    north and east, and `OXTS_FORWARD` (m/s).

    Raises:
        SourceError: a line has not KITTI's 30 columns, a value that is no finite number, or one
            that no receiver measures.
    """
    fields = [line.split() for line in read_text(path).splitlines() if line.strip()]
    for number, row in enumerate(fields):
        if len(row) != OXTS_COLUMNS:
            what = f"{len(row)} columns, expected {OXTS_COLUMNS} (lat lon alt roll pitch yaw …)"
            raise line_error(path, number, what)
    numbers = parse_numbers(path, np.arange(len(fields)), fields, OXTS_COLUMNS)
    limits = np.full(OXTS_COLUMNS, _LARGEST_MEASURED)
    limits[: len(_LARGEST_PLACE)] = _LARGEST_PLACE
    for row, column in np.argwhere(np.abs(numbers) > limits)[:1]:
        raise line_error(path, int(row), f"{fields[row][column]} in column {column + 1} is absurd")
    return numbers
