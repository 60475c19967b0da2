"""The CSV tables of a session: readable at any moment, cut back on resume, never half a row in the middle."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from embodied_active_learning.errors import CorruptFileError, SessionError
from embodied_active_learning.model.learner import UpdateReport
from embodied_active_learning.session.tables import COLUMNS, Table, read_table

NAMES = ("step", "value")


def write(path, rows):
    with Table(path, NAMES) as table:
        for step, value in rows:
            table.append({"step": step, "value": value})


def test_training_table_has_all_fields_of_a_report():
    assert COLUMNS["training"] == tuple(field.name for field in fields(UpdateReport))
    assert "seconds" not in COLUMNS["training"]  # it would make the tables of two equal runs differ


def test_appended_row_is_readable_immediately(tmp_path):
    path = tmp_path / "t.csv"
    with Table(path, NAMES) as table:
        for step in range(3):
            table.append({"step": step, "value": step / 3})
            assert read_table(path, NAMES)["value"].tolist() == [number / 3 for number in range(step + 1)]
    assert path.read_text().splitlines()[:2] == ["step,value", "0,0.0"]


def test_missing_value_of_row_is_nan(tmp_path):
    @dataclass
    class Row:
        step: int

    with Table(tmp_path / "t.csv", NAMES) as table:
        table.append(Row(step=np.int64(4)))
        table.append({"step": np.float32(0.5), "value": None})
    found = read_table(tmp_path / "t.csv", NAMES)
    assert found["step"].tolist() == [4.0, 0.5]
    assert np.isnan(found["value"]).all()


def test_unknown_column_is_rejected(tmp_path):
    with Table(tmp_path / "t.csv", NAMES) as table, pytest.raises(
        SessionError, match="no column valeu: the columns are step"
    ):
        table.append({"valeu": 1})


def test_missing_table_has_no_rows(tmp_path):
    (tmp_path / "empty.csv").write_text("")
    for name in ("missing.csv", "empty.csv"):
        found = read_table(tmp_path / name, NAMES)
        assert [found["step"].shape, found["value"].shape] == [(0,), (0,)]


def test_truncated_line_is_ignored_and_overwritten(tmp_path):
    path = tmp_path / "t.csv"
    write(path, [(0, 0.25), (1, 0.5)])
    content = path.read_bytes()
    header = content.index(b"\n") + 1
    second = content.index(b"\n", header) + 1
    for length in range(len(content)):
        path.write_bytes(content[:length])
        whole = 0 if length < second else 1
        assert len(read_table(path, NAMES)["step"]) == whole
        write(path, [(number, 0.25 * (number + 1)) for number in range(whole, 2)])
        assert path.read_bytes() == content


DAMAGED = ["1", "1,2,3", "1,two", '1,"2', "1,1_0", "1, 1", "1,0x1", "1,1e", "1,infinity", "1,+1", "1,\u0661"]


@pytest.mark.parametrize("line", DAMAGED)
def test_damaged_line_is_named_and_left_unchanged(tmp_path, line):
    """Numbers in other notations than Python's are damage."""
    path = tmp_path / "t.csv"
    content = f"step,value\n0,1\n{line}\n2,3\n"
    path.write_text(content)
    for attempt in (Table, read_table):
        with pytest.raises(CorruptFileError, match=r"t.csv: line 3 is .*: delete it"):
            attempt(path, NAMES)
    assert path.read_text() == content


def test_table_of_other_columns_is_rejected_untouched(tmp_path):
    path = tmp_path / "t.csv"
    path.write_text("a,b\n1,2\n")
    for attempt in (Table, read_table):
        with pytest.raises(CorruptFileError, match=r"t.csv: the header is \['a', 'b'\], expected \['step', 'value'\]"):
            attempt(path, NAMES)
    assert path.read_text() == "a,b\n1,2\n"


HEADERS = ("value,step", "value", "step,other", "step,value,more", "", "step,", "st")


@pytest.mark.parametrize("content", [*(f"{header}\n1,2\n" for header in HEADERS), "no line"])
def test_reordered_or_foreign_header_is_rejected(tmp_path, content):
    path = tmp_path / "t.csv"
    path.write_text(content)
    for attempt in (Table, read_table):
        with pytest.raises(CorruptFileError, match=r"t\.csv: the header is"):
            attempt(path, NAMES)
    assert path.read_text() == content


def test_column_that_an_earlier_version_did_not_write_is_nan(tmp_path):
    path = tmp_path / "t.csv"
    path.write_text("step\n0\n1\n2")
    assert np.isnan(read_table(path, NAMES)["value"]).all()
    with Table(path, NAMES) as table:
        table.append({"step": 2, "value": 0.5})
    assert path.read_text() == "step,value\n0,\n1,\n2,0.5\n"


def test_resume_truncates_table(tmp_path):
    path = tmp_path / "t.csv"
    write(path, [(step, step / 7) for step in range(10)])
    with Table(path, NAMES) as table:
        table.truncate_after("step", 4)
        table.append({"step": 5, "value": 9.0})
    found = read_table(path, NAMES)
    assert found["step"].tolist() == [0, 1, 2, 3, 4, 5]
    assert found["value"].tolist() == [*[step / 7 for step in range(5)], 9.0]


def test_second_table_writer_is_rejected(tmp_path):
    path = tmp_path / "t.csv"
    with Table(path, NAMES) as table:
        table.truncate_after("step", 0)
        with pytest.raises(SessionError, match="being written by another process"):
            Table(path, NAMES)
    Table(path, NAMES).close()


@given(values=st.lists(st.floats(), max_size=8))
def test_any_numbers_round_trip(tmp_path_factory, values):
    path = tmp_path_factory.mktemp("table") / "t.csv"
    write(path, enumerate(values))
    found = read_table(path, NAMES)["value"].tolist()
    assert len(found) == len(values)
    assert all(a == b or (math.isnan(a) and math.isnan(b)) for a, b in zip(found, values))
