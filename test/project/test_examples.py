"""The scripts in examples/ run, on a tiny world."""

import importlib.util
from pathlib import Path

import pytest

import embodied_active_learning as eal
from embodied_active_learning.errors import ConfigError
from tiny import TINY

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"


def load(name):
    specification = importlib.util.spec_from_file_location(name, EXAMPLES / f"{name}.py")
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    return module


@pytest.fixture(autouse=True)
def small_runs(monkeypatch, tmp_path):
    """All configurations are small, and stored in a temporary folder."""
    original = eal.load_config
    monkeypatch.setattr(
        eal,
        "load_config",
        lambda profile, **keys: original("", **{**TINY, "root": str(tmp_path), **keys}),
        raising=False,
    )


def test_learn_without_ros_prints_decisions(capsys, tmp_path):
    load("learn_without_ros").main(24, 24, str(tmp_path))
    output = capsys.readouterr().out
    assert "fingerprints: " in output
    assert "best at x" in output


def test_read_a_session_prints_its_content(capsys, tmp_path):
    session = eal.learn(eal.load_config("", name="run"))
    load("read_a_session").main(str(session.paths.path))
    output = capsys.readouterr().out
    assert "run: world" in output
    assert "24 images of 24 x 24 px" in output
    assert "latents of the last image" in output


def test_own_explorer_is_used_and_its_session_opens_without_it():
    try:
        load("own_explorer")
        session = eal.learn(eal.load_config("", explorer="lawnmower", measure="variance"))
        states = session.read_table("exploration")
        assert states["y"][-1] != states["y"][0]
    finally:
        eal.EXPLORERS.unregister("lawnmower")
        eal.INFORMATION_MEASURES.unregister("variance")
    assert eal.load_session(session.paths.path).config.exploration.explorer == "lawnmower"
    with pytest.raises(ConfigError, match="exploration/explorer is 'lawnmower': expected one of"):
        eal.load_config("", explorer="lawnmower")


@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("*.py")), ids=lambda path: path.stem)
def test_example_is_short(path):
    assert len(path.read_text(encoding="utf-8").splitlines()) < 60
