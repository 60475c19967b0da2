"""TensorBoard events of a session."""

import sys

import pytest

from embodied_active_learning.errors import MissingPackageError
from embodied_active_learning.session.events import main, write_events
from embodied_active_learning.session.session import Session
from sample_session import configuration


class Writer:
    """Keeps what a SummaryWriter would write."""

    def __init__(self):
        self.scalars = []

    def add_scalar(self, name, value, at):
        self.scalars.append((name, value, at))


@pytest.fixture
def session(tmp_path):
    with Session.open_for_writing(configuration(tmp_path)) as made:
        yield made


def test_each_finite_value_of_a_growing_table_is_written_once(session):
    writer, written = Writer(), {}
    with session.open_table("training") as table:
        table.append({"update": 3, "loss": 0.5, "kl": float("nan")})
        write_events(session, writer, written)
        table.append({"update": 6, "loss": 0.25})
        write_events(session, writer, written)
    assert writer.scalars == [("training/loss", 0.5, 3), ("training/loss", 0.25, 6)]


def test_missing_tensorboardx_is_named(session, monkeypatch):
    monkeypatch.setitem(sys.modules, "tensorboardX", None)
    with pytest.raises(MissingPackageError, match="pip install tensorboardX"):
        main(session.paths.path)
