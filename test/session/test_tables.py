"""The CSV tables of a session: readable at any moment, cut back on resume, never half a row in the middle."""

from __future__ import annotations

import math
import os
import subprocess
import sys
from dataclasses import dataclass, fields

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from embodied_active_learning.errors import CorruptFileError, SessionError
from embodied_active_learning.model.learner import UpdateReport
from embodied_active_learning.session.tables import COLUMNS, Table, read_table

NAMES = ("step", "value")


def write(path, rows):
    with Table(path, NAMES) as table:
        for step, value in rows:
            table.append({"step": step, "value": value})


def test_table_columns_are_stable():
    assert COLUMNS["exploration"][:6] == ("step", "time", "x", "y", "theta", "ergodic_measure")
    assert COLUMNS["training"][:3] == ("update", "observations", "loss")
    assert COLUMNS["evaluation"][3:6] == ("mse_own", "mse_shuffled", "mse_none")


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


@pytest.mark.parametrize("line", ["1", "1,2,3", "1,two", '1,"2'])
def test_damaged_line_is_named(tmp_path, line):
    path = tmp_path / "t.csv"
    path.write_text(f"step,value\n0,1\n{line}\n2,3\n")
    with pytest.raises(CorruptFileError, match=r"t.csv: line 3"):
        read_table(path, NAMES)


def test_table_of_other_columns_is_rejected_untouched(tmp_path):
    path = tmp_path / "t.csv"
    path.write_text("a,b\n1,2\n")
    for attempt in (Table, read_table):
        with pytest.raises(CorruptFileError, match=r"t.csv: the header is \['a', 'b'\], expected \['step', 'value'\]"):
            attempt(path, NAMES)
    assert path.read_text() == "a,b\n1,2\n"


@pytest.mark.parametrize("header", ["value,step", "step", "step,other", "step,value,more", "", "step,", "st"])
def test_reordered_or_foreign_header_is_rejected(tmp_path, header):
    path = tmp_path / "t.csv"
    path.write_text(f"{header}\n1,2\n")
    for attempt in (Table, read_table):
        with pytest.raises(CorruptFileError, match=r"t\.csv: the header is"):
            attempt(path, NAMES)
    assert path.read_text() == f"{header}\n1,2\n"


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


def test_rows_are_complete_after_full_disk(tmp_path):
    path = tmp_path / "t.csv"
    script = f"""
import resource, signal
from embodied_active_learning.errors import SessionError
from embodied_active_learning.session.tables import Table
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
table = Table({str(path)!r}, {NAMES})
table.append({{"step": 0, "value": 1.0}})
resource.setrlimit(resource.RLIMIT_FSIZE, ({len("step,value|0,1.0|")} + 3, resource.RLIM_INFINITY))
try:
    table.append({{"step": 1, "value": 2.0}})
except SessionError as error:
    assert "free disk space" in str(error), error
else:
    raise AssertionError("the disk was full")
resource.setrlimit(resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
table.append({{"step": 2, "value": 3.0}})
"""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    subprocess.run([sys.executable, "-c", script], check=True, timeout=60, env=environment)
    assert path.read_text() == "step,value\n0,1.0\n2,3.0\n"


@settings(max_examples=30)
@given(values=st.lists(st.floats(), max_size=8))
def test_any_numbers_round_trip(tmp_path_factory, values):
    path = tmp_path_factory.mktemp("table") / "t.csv"
    write(path, enumerate(values))
    found = read_table(path, NAMES)["value"].tolist()
    assert len(found) == len(values)
    assert all(a == b or (math.isnan(a) and math.isnan(b)) for a, b in zip(found, values))
