"""Row groups of a parquet file whose writer was killed before the footer was written.

A parquet file lists the locations of its columns only in its footer, which is written last; without a footer no reader
opens the file. But everything before the footer is complete: each column of a row group is one run of pages, and each
page begins with a header that has its length and number of values. This module therefore counts pages, in the order of
the columns, and creates a footer. The schema, and the format of each column's entry, come from a one-row file that is
written with the same settings.

Format: github.com/apache/parquet-format, README.md and parquet.thrift (headers and footer are structures of Thrift's
compact protocol).
"""

import io
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

_MAGIC = b"PAR1"
_TRUE, _FALSE, _BYTE, _I16, _I32, _I64, _DOUBLE, _BINARY, _LIST, _SET, _MAP, _STRUCT = range(1, 13)
_DATA_PAGE, _DICTIONARY_PAGE, _DATA_PAGE_V2 = 0, 2, 3
# page type → (field number of this type's header in PageHeader, field number of the encoding in this type's header)
_PAGE_HEADERS = {_DATA_PAGE: (5, 2), _DICTIONARY_PAGE: (7, 2), _DATA_PAGE_V2: (8, 4)}
_RLE = 3

Struct = dict[int, tuple[int, Any]]
"""Field number → (Thrift type, value). The value of a list is (type of its elements, elements)."""


class _Reader:
    """Decoder of Thrift's compact protocol. Raises IndexError at the end of the data, ValueError on invalid data."""

    def __init__(self, data: bytes, at: int = 0):
        self.data, self.at = data, at

    def varint(self) -> int:
        value = shift = 0
        while True:
            byte = self.data[self.at]
            self.at += 1
            value |= (byte & 0x7F) << shift
            shift += 7
            if byte < 0x80:
                return value

    def integer(self) -> int:
        value = self.varint()
        return (value >> 1) ^ -(value & 1)

    def take(self, size: int) -> bytes:
        if self.at + size > len(self.data):
            raise IndexError("beyond the end")
        self.at += size
        return self.data[self.at - size : self.at]

    def value(self, kind: int) -> Any:
        if kind in (_TRUE, _FALSE):  # the type is the value itself
            return kind
        if kind == _BYTE:
            return self.take(1)
        if kind in (_I16, _I32, _I64):
            return self.integer()
        if kind == _DOUBLE:
            return self.take(8)
        if kind == _BINARY:
            return self.take(self.varint())
        if kind in (_LIST, _SET):
            head = self.take(1)[0]
            size = head >> 4 if head < 0xF0 else self.varint()
            inner = head & 0xF
            if inner in (_TRUE, _FALSE):  # in a list, each boolean is a byte
                return inner, [self.take(1)[0] for _ in range(size)]
            return inner, [self.value(inner) for _ in range(size)]
        if kind == _STRUCT:
            return self.struct()
        raise ValueError(f"no parquet structure has a field of Thrift type {kind}")

    def struct(self) -> Struct:
        fields: Struct = {}
        number = 0
        while head := self.take(1)[0]:
            number = number + (head >> 4) if head >> 4 else self.integer()
            fields[number] = (head & 0xF, self.value(head & 0xF))
        return fields


def _varint(value: int) -> bytes:
    out = bytearray()
    while value >= 0x80:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    out.append(value)
    return bytes(out)


def _encode(kind: int, value: Any) -> bytes:
    """Encode a value in Thrift's compact protocol; inverse of `_Reader.value`."""
    if kind in (_TRUE, _FALSE):
        return b""
    if kind in (_BYTE, _DOUBLE):
        return bytes(value)
    if kind in (_I16, _I32, _I64):
        return _varint(value << 1 if value >= 0 else (-value << 1) - 1)
    if kind == _BINARY:
        return _varint(len(value)) + value
    if kind in (_LIST, _SET):
        inner, items = value
        head = bytes([len(items) << 4 | inner]) if len(items) < 15 else bytes([0xF0 | inner]) + _varint(len(items))
        return head + (bytes(items) if inner in (_TRUE, _FALSE) else b"".join(_encode(inner, i) for i in items))
    out, last = bytearray(), 0
    for number, (inner, item) in sorted(value.items()):
        delta = number - last
        out += bytes([delta << 4 | inner]) if 0 < delta < 16 else bytes([inner]) + _encode(_I16, number)
        out += _encode(inner, item)
        last = number
    return bytes(out) + b"\0"


@dataclass(frozen=True)
class _Page:
    start: int
    end: int
    uncompressed: int  # uncompressed size of the page with its header, bytes
    dictionary: bool
    encoding: int
    values: int


def _page(data: bytes, at: int) -> _Page:
    """Return the page that begins at `at`. Raises IndexError, KeyError or ValueError: there is no complete page."""
    reader = _Reader(data, at)
    header = reader.struct()
    kind = header[1][1]
    field, encoding = _PAGE_HEADERS[kind]
    inner = header[field][1]
    uncompressed, end = header[2][1] + reader.at - at, reader.at + header[3][1]
    if not reader.at <= end <= len(data) or uncompressed <= 0 or inner[1][1] < 0:
        raise ValueError("not a page header")
    return _Page(at, end, uncompressed, kind == _DICTIONARY_PAGE, inner[encoding][1], inner[1][1])


def _chunk(data: bytes, at: int, values: int | None) -> list[_Page]:
    """Return the pages of one column: from `at` until they hold `values` values; None: until the next dictionary.

    Raises the exceptions of `_page` if pages are missing.
    """
    pages: list[_Page] = []
    found = 0
    while values is None or found < values:
        try:
            page = _page(data, pages[-1].end if pages else at)
        except (IndexError, KeyError, TypeError):
            if values is None and found:  # end of the data, after a table's only column
                break
            raise
        if page.dictionary and pages:
            if values is None and found:
                break
            raise ValueError("a column ends early")
        pages.append(page)
        found += 0 if page.dictionary else page.values
    return pages


def _row_group(data: bytes, at: int, template: Struct, per_row: list[int]) -> tuple[Struct, int]:
    """Return the footer entry and the end of the row group that begins at `at`. Raises the exceptions of `_page`."""
    start = at
    columns: list[Struct] = []
    rows: int | None = None
    for chunk, count in zip(template[1][1][1], per_row, strict=True):
        pages = _chunk(data, at, None if rows is None else rows * count)
        values = sum(page.values for page in pages if not page.dictionary)
        rows = values // count if rows is None else rows
        if values != rows * count:
            raise ValueError("columns of different lengths")
        at = pages[-1].end
        first = next(page.start for page in pages if not page.dictionary)
        column: Struct = {n: chunk[3][1][n] for n in (1, 3, 4)} | {
            2: (_LIST, (_I32, sorted({_RLE, *(page.encoding for page in pages)}))),
            5: (_I64, values),
            6: (_I64, sum(page.uncompressed for page in pages)),
            7: (_I64, at - pages[0].start),
            9: (_I64, first),
        }
        if pages[0].dictionary:
            column[11] = (_I64, pages[0].start)
        columns.append(column)
    size = sum(column[6][1] for column in columns)
    entries = [{2: (_I64, 0), 3: (_STRUCT, column)} for column in columns]
    return {1: (_LIST, (_STRUCT, entries)), 2: (_I64, size), 3: (_I64, rows), 5: (_I64, start)}, at


def _footer(data: bytes) -> Struct:
    (size,) = struct.unpack("<I", data[-8:-4])
    return _Reader(data, len(data) - 8 - size).struct()


def salvage(path: Path, example: pa.Table, columns: list[str] | None = None) -> list[pa.Table]:
    """Return the row groups that a killed `pyarrow.parquet.ParquetWriter` has written completely.

    Args:
        path: file without footer (the footer of a complete file is ignored).
        example: one row with the file's schema, with lists as long as in the file. The row is written with LeRobot's
            settings: snappy, dictionaries.
        columns: columns to read; all by default.

    Returns:
        One table per row group, up to the first truncated or damaged group.
    """
    data = path.read_bytes()
    if data[:4] != _MAGIC:
        return []
    sink = io.BytesIO()
    with pq.ParquetWriter(sink, example.schema, compression="snappy", use_dictionary=True) as writer:
        writer.write_table(example)
    footer = _footer(sink.getvalue())
    template = footer[4][1][1][0]
    per_row = [chunk[3][1][5][1] for chunk in template[1][1][1]]
    groups, at = [], len(_MAGIC)
    while True:
        try:
            group, at = _row_group(data, at, template, per_row)
        except (IndexError, KeyError, TypeError, ValueError, RecursionError):
            break  # end of the data, or the group that the killed writer left incomplete
        groups.append(group)
    footer[3] = (_I64, sum(group[3][1] for group in groups))
    footer[4] = (_LIST, (_STRUCT, groups))
    end = _encode(_STRUCT, footer)
    source = pa.BufferReader(data[:at] + end + struct.pack("<I", len(end)) + _MAGIC)
    tables: list[pa.Table] = []
    file = pq.ParquetFile(source)
    for number in range(len(groups)):
        try:
            tables.append(file.read_row_group(number, columns=columns))
        except (pa.ArrowException, OSError):
            break
    return tables
