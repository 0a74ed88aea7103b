"""Row groups of a Parquet file whose writer was killed before it wrote the footer."""

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lerobot_robot_yam.face.datasets.repair.parquet_salvage import salvage


def rows(count, start=0):
    """A table as LeRobot writes one per episode; distinct values, so that columns are too big for a dictionary."""
    random = np.random.default_rng(start)
    return pa.table(
        {
            "action": pa.FixedSizeListArray.from_arrays(pa.array(random.normal(size=count * 7), pa.float32()), 7),
            "task": pa.array([f"task {n % 3}" for n in range(count)]),
            "done": pa.array([n % 5 == 0 for n in range(count)]),
            "frame": pa.array(range(start, start + count), pa.int64()),
        }
    )


def written(path, tables, close):
    """The bytes on disk of a writer that was closed, or not."""
    with pq.ParquetWriter(path, tables[0].schema, compression="snappy", use_dictionary=True) as writer:
        for table in tables:
            writer.write_table(table)
        if not close:
            return path.read_bytes()
    return path.read_bytes()


@pytest.mark.parametrize("close", [False, True])
@pytest.mark.parametrize("counts", [(1,), (3, 400, 2), (60_000, 5)])
def test_salvage_reads_every_row_group(counts, close, tmp_path):
    tables = [rows(count, start) for start, count in enumerate(counts)]
    (tmp_path / "killed").write_bytes(written(tmp_path / "file", tables, close))
    found = salvage(tmp_path / "killed", rows(1))
    assert len(found) == len(tables) and all(a.equals(b) for a, b in zip(found, tables, strict=True))
    (column,) = salvage(tmp_path / "killed", rows(1), ["frame"])[:1]
    assert column.column_names == ["frame"]


@settings(max_examples=60, deadline=None)
@given(end=st.integers(0, 2**20), damage=st.lists(st.tuples(st.integers(0, 2**20), st.integers(0, 255)), max_size=3))
def test_salvage_never_invents_rows(tmp_path_factory, end, damage):
    """Cut off anywhere, what comes back is a beginning of what was written; damaged, it may only not crash."""
    directory = tmp_path_factory.mktemp("salvage", numbered=True)
    tables = [rows(20), rows(30, 1), rows(10, 2)]
    content = bytearray(written(directory / "file", tables, close=False)[: end % 4000])
    for place, value in damage:
        if content:
            content[place % len(content)] = value
    (directory / "killed").write_bytes(content)
    found = salvage(directory / "killed", rows(1))
    assert len(found) <= len(tables)
    if not damage:
        assert all(a.equals(b) for a, b in zip(found, tables, strict=False))
