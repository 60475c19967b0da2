"""Names in requests: none leads out of the folder of the sessions, and each error states the rule."""

from __future__ import annotations

import re
from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from embodied_active_learning.config import Config
from embodied_active_learning.errors import EmbodiedActiveLearningError, SessionError
from embodied_active_learning.naming import MAX_NAME_LENGTH, check_name
from embodied_active_learning.pipeline.identification import IdentificationRun, check_results, read_sets
from embodied_active_learning.pipeline.resolve import resolve_config
from embodied_active_learning.ros.launch_arguments import parse_overrides
from embodied_active_learning.session.fingerprint_sets import MAX_SESSIONS
from embodied_active_learning.session.fingerprints import load_fingerprints
from embodied_active_learning.session.identifications import identification_folder, load_identification
from embodied_active_learning.session.session import check_session, find_session
from sample_session import NAME, configuration, make_sample

ILLEGAL = [
    "", ".", "..", "...", "../../etc/x", "/etc/passwd", "a/b", "a/../b", "-x", "--help", "_a", ".hidden", "a.b", "A",
    "a b", "a\n", "\na", "a\x00b", "\x00", "ä", "\u0430", "a\u202eb",
    "~", "~root", "$HOME", "a;b", "a*", "con:", "a\\b",
    "x" * 65, "x" * 10_000, "../" * 3000,
]  # fmt: skip
RULE = r"give 1 to 64 of a-z, 0-9, '_' and '-', beginning with a letter or a digit"


@pytest.fixture(scope="module")
def root(tmp_path_factory):
    root = tmp_path_factory.mktemp("home") / "root"
    make_sample(root)
    return root


def everything_below(folder):
    return sorted(str(path) for path in folder.rglob("*"))


def uses_of(root, name):
    """Return every function that turns a given name into a path."""
    path = root / NAME
    return {
        "sessions": lambda: read_sets(root, [NAME, name]),
        "replay": lambda: find_session(root, name, "replay"),
        "results": lambda: check_results(path, name, overwrite=True),
        "folder": lambda: identification_folder(path, name),
        "decisions": lambda: load_identification(path, name),
        "session": lambda: check_session(replace_name(root, name)),
    }


def replace_name(root, name):
    config = configuration(root)
    return replace(config, session=replace(config.session, name=name))


@pytest.mark.parametrize("use", ["sessions", "replay", "results", "folder", "decisions", "session"])
def test_invalid_name_is_rejected_by_every_use(root, use):
    before = everything_below(root.parent)
    with pytest.raises(SessionError, match=RULE):
        uses_of(root, "../../etc/x")[use]()
    assert everything_below(root.parent) == before


@pytest.mark.parametrize("name", ILLEGAL, ids=lambda name: ascii(name[:20]))
def test_invalid_name_is_rejected_with_the_rule(name):
    with pytest.raises(SessionError, match=RULE) as refused:
        check_name(name)
    assert len(str(refused.value)) < 400


@given(st.text(max_size=70))
@settings(derandomize=True)
def test_name_is_valid_exactly_by_the_rule(name):
    if re.fullmatch(r"[a-z0-9][a-z0-9_-]{0,63}", name) and name.isascii():
        assert check_name(name) == name
    else:
        with pytest.raises(SessionError, match=RULE):
            check_name(name)


@pytest.mark.parametrize("name", [None, 3, b"a", ["a"], True])
def test_name_must_be_text(name):
    with pytest.raises(SessionError, match=RULE):
        check_name(name)


def test_unknown_session_lists_known_ones(root):
    for attempt in (lambda: find_session(root, "other", "replay"), lambda: read_sets(root, ["other"])):
        with pytest.raises(SessionError, match=rf"is 'other', but .* no such session in {root}: known are {NAME}$"):
            attempt()


def test_number_of_sessions_is_limited(root):
    with pytest.raises(SessionError, match="no sessions given"):
        read_sets(root, [])
    with pytest.raises(SessionError, match=f"{MAX_SESSIONS + 1} given, at most {MAX_SESSIONS} allowed"):
        read_sets(root, [f"s{number}" for number in range(MAX_SESSIONS + 1)])
    assert len(read_sets(root, [NAME] * 100)) == 1


def test_session_link_out_of_root_is_not_read(root, tmp_path):
    make_sample(tmp_path)
    (root / "away").symlink_to(tmp_path / NAME)
    try:
        for attempt in (lambda: find_session(root, "away"), lambda: read_sets(root, ["away"])):
            with pytest.raises(SessionError, match=rf"away leads out of {root}, to {tmp_path / NAME}"):
                attempt()
        with pytest.raises(SessionError, match="away is a symbolic link"):
            check_session(configuration(root, name="away", resume=True))
    finally:
        (root / "away").unlink()


@pytest.mark.parametrize("target", ["away", ".", "missing"])
def test_circular_or_dangling_link_is_rejected(root, target):
    (root / "away").symlink_to(root / target)
    try:
        with pytest.raises(EmbodiedActiveLearningError, match=r"away|config.yaml is missing"):
            read_sets(root, ["away"])
    finally:
        (root / "away").unlink()


def test_link_within_root_is_accepted(root, tmp_path):
    (root / "latest").symlink_to(NAME)
    (tmp_path / "root").symlink_to(root)
    try:
        assert find_session(root, "latest").samefile(root / NAME)
        assert read_sets(tmp_path / "root", [NAME])[0].session == NAME
    finally:
        (root / "latest").unlink()


def test_results_are_replaced_only_on_request(root):
    config = configuration(root)
    found = [load_fingerprints(root / NAME)]
    decisions = root / NAME / "identification" / "first" / "decisions.yaml"
    before = decisions.read_bytes()
    with pytest.raises(SessionError, match=r"results exist in .*/first: choose another name, or set overwrite"):
        IdentificationRun(root / NAME, found, "first", 0, config.identification)
    assert decisions.read_bytes() == before
    run = IdentificationRun(root / NAME, found, "first", 0, config.identification, overwrite=True)
    run.close()
    IdentificationRun(root / NAME, found, "second", 0, config.identification).close()


def test_incomplete_results_are_replaced(root):
    folder = root / NAME / "identification" / "half"
    folder.mkdir()
    (folder / "beliefs.safetensors").write_bytes(b"half")
    check_results(root / NAME, "half", overwrite=False)


def test_generated_names_are_valid(tmp_path):
    world = tmp_path / f"{'My Table (2) äß' * 8}.yaml"
    world.write_text("objects: {}\n")
    given_ = {
        "session/root": tmp_path, "simulation/world": world, "exploration/seed": 2**31 - 1,
        "exploration/explorer": "uniform_ergodic",
    }  # fmt: skip
    name = resolve_config("demo", parse_overrides([f"{key}={value}" for key, value in given_.items()])).session.name
    assert check_name(name).startswith("my-table-2")
    assert len(name) <= MAX_NAME_LENGTH


@pytest.mark.parametrize("root", ["~nobody-of-that-name/x", "a\x00b"])
def test_invalid_root_is_rejected(root):
    config = Config.from_dict({"session": {"root": root, "name": "a"}})
    with pytest.raises(SessionError, match="session/root is"):
        check_session(config)


@pytest.mark.parametrize("root", ["/dev/null/x", "/proc/self/x", "/" + "x" * 300, "/" + "x/" * 3000])
def test_unwritable_root_is_rejected(root):
    with pytest.raises(SessionError, match=r"session/root|cannot be"):
        check_session(Config.from_dict({"session": {"root": root, "name": "a"}}))


@pytest.mark.parametrize(
    "world", ["a\x00b.yaml", "/" + "x" * 5000 + ".yaml", "~nobody/x.yaml", "/dev/zero.yaml", ".yaml"]
)
def test_invalid_world_or_profile_path_is_rejected(tmp_path, world):
    for profile, overrides in (("demo", [f"simulation/world={world}"]), (world, [])):
        with pytest.raises(EmbodiedActiveLearningError):
            resolve_config(profile, parse_overrides([f"session/root={tmp_path}", "session/name=a", *overrides]))
