"""Damaged and hostile files: reading returns what was written or an error that names the file, and executes nothing."""

from __future__ import annotations

import contextlib
import json
import os
import pickle
import random
import shutil
import socket
import zipfile
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
import torch
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from embodied_active_learning.errors import (
    CorruptFileError,
    ObservationError,
    SessionError,
)
from embodied_active_learning.files import MAX_YAML_SIZE, parse_yaml
from embodied_active_learning.session.array_files import read_arrays, write_arrays
from embodied_active_learning.session.session import Session
from sample_session import KINDS, OBSERVATIONS, configuration, make_sample

FLIPS, CUTS = 25, 12  # of each file
HUGE = 10 * 2**30
RECORDS = "observations/observations.bin"
EVERY_KIND = pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.path)
TENSORS = [kind for kind in KINDS if kind.path.endswith(".safetensors")]
TENSOR_PATHS = {kind.path for kind in TENSORS}
DONORS = ("config.yaml", RECORDS, "training.csv", "model.safetensors", "user/table.png")
YAML_FILES = [kind for kind in KINDS if kind.path.endswith(".yaml")]


@pytest.fixture(scope="module")
def sample(tmp_path_factory):
    return make_sample(tmp_path_factory.mktemp("root"))


@pytest.fixture(scope="module")
def originals(sample):
    return {kind.path: kind.read(sample) for kind in KINDS}


@pytest.fixture(scope="module")
def canary(tmp_path_factory):
    """Path of a file that executed content creates; checked after all tests."""
    path = tmp_path_factory.mktemp("canary") / "alive"
    yield path
    assert not path.exists()


@contextmanager
def replaced(path: Path):
    """Move the file away during the block."""
    kept = path.with_name(f"{path.name}.kept")
    path.rename(kept)
    try:
        yield
    finally:
        if path.is_dir() and not path.is_symlink():
            path.rmdir()
        elif os.path.lexists(path):
            path.unlink()
        kept.rename(path)


def refusal(kind, sample):
    """Return the error message of reading the file; it names the file and the remedy."""
    with pytest.raises(kind.error) as refused:
        kind.read(sample)
    message = str(refused.value)
    assert Path(kind.path).name in message
    assert kind.remedy in message
    assert len(message) < 5000
    return message


def read_or_refused(kind, sample):
    """Return what is read and an empty text, or None and the error message, which names the file."""
    try:
        return kind.read(sample), ""
    except (kind.error, SessionError) as error:
        message = str(error)
    # A contradiction between values of a profile and others names only the keys.
    assert Path(kind.path).name in message or kind.path == "user/profile.yaml"
    return None, message


def is_believable(kind, found, original):
    """Return whether the result is what was written; a file of records may have lost its last ones."""
    if found is None or found == original:
        return True
    if kind.path == RECORDS:
        return found == original[: len(found)]
    return not kind.checked


@EVERY_KIND
def test_truncated_file_is_rejected_or_complete(kind, sample, originals):
    path, content = sample / kind.path, (sample / kind.path).read_bytes()
    cuts = random.Random(1)
    with replaced(path):
        for length in {0, 1, 7, 8, len(content) - 2, *(cuts.randrange(len(content)) for _ in range(CUTS))}:
            path.write_bytes(content[:length])
            found, message = read_or_refused(kind, sample)
            assert is_believable(kind, found, originals[kind.path]), length
            assert kind not in TENSORS or "is not a complete safetensors file" in message, length


@EVERY_KIND
def test_flipped_bit_is_detected_or_harmless(kind, sample, originals):
    path, content = sample / kind.path, (sample / kind.path).read_bytes()
    draws = random.Random(2)
    with replaced(path):
        for _ in range(FLIPS):
            damaged, position = bytearray(content), draws.randrange(len(content))
            damaged[position] ^= 1 << draws.randrange(8)
            path.write_bytes(damaged)
            found, _ = read_or_refused(kind, sample)
            assert is_believable(kind, found, originals[kind.path]), position


@settings(derandomize=True, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_random_bytes_are_rejected_by_name(sample, originals, data):
    kind = data.draw(st.sampled_from(KINDS))
    content = data.draw(st.one_of(st.binary(max_size=200), st.text(max_size=200).map(str.encode)))
    path = sample / kind.path
    with replaced(path):
        path.write_bytes(content)
        found, _ = read_or_refused(kind, sample)
    assert found is None or not kind.checked or (kind.path == RECORDS and found == [])


@EVERY_KIND
def test_file_of_other_kind_is_rejected(kind, sample):
    path = sample / kind.path
    contents = {name: (sample / name).read_bytes() for name in DONORS}
    with replaced(path):
        for name, content in contents.items():
            path.write_bytes(content)
            if name == kind.path:
                continue
            found, message = read_or_refused(kind, sample)
            assert found is None or (kind.path == RECORDS and found == []), name
            if {kind.path, name} <= TENSOR_PATHS and path.name != Path(name).name:
                assert ": format is 'embodied_active_learning/" in message, name


@EVERY_KIND
def test_special_file_is_rejected_unopened(kind, sample, tmp_path):
    path = sample / kind.path
    made = {
        "it is a folder": path.mkdir,
        "it is a named pipe": lambda: os.mkfifo(path),  # opening it would wait for a writer for ever
        "it is a device": lambda: path.symlink_to("/dev/zero"),  # reading it would never end
        "it is a socket": lambda: bind(path, tmp_path),
    }
    for complaint, make in made.items():
        with replaced(path):
            make()
            message = refusal(kind, sample)
            assert complaint in message or "it is a symbolic link" in message


def bind(path, folder):
    """Create a socket; its own path would be too long."""
    with socket.socket(socket.AF_UNIX) as stream:
        os.chdir(folder)
        stream.bind("s")
    os.rename(folder / "s", path)


@EVERY_KIND
def test_missing_file_is_named_unless_optional(kind, sample, originals):
    with replaced(sample / kind.path):
        if kind.path.endswith(".csv"):
            assert all(shape == (0,) for _, shape, _ in kind.read(sample).values())
        elif kind.path.startswith(("checkpoints", "planner", "arm_states")):
            assert kind.read(sample) is None
        elif kind.path.endswith("calibration.safetensors"):
            assert kind.read(sample)  # without the calibration
        elif kind.path == "model.safetensors":
            assert kind.read(sample) == originals[kind.path]  # of the newest checkpoint
        elif kind.path in (RECORDS, "identification/first/decisions.yaml"):
            with pytest.raises(SessionError, match=r"has no observations yet|is missing: no identification"):
                kind.read(sample)
        else:
            refusal(kind, sample)


@EVERY_KIND
def test_huge_file_is_rejected_unread(kind, sample):
    path = sample / kind.path
    content = path.read_bytes()
    size = HUGE if kind.path == RECORDS else kind.limit + 1
    with replaced(path):
        path.write_bytes(content)
        os.truncate(path, size)
        message = refusal(kind, sample)
    if kind.path == RECORDS:
        assert f"record {OBSERVATIONS} is damaged" in message
    else:
        assert f"has {size} bytes, at most {kind.limit} are allowed" in message


@EVERY_KIND
def test_link_out_of_session_is_not_followed(kind, sample, tmp_path, originals):
    path = sample / kind.path
    outside = tmp_path / path.name
    shutil.copy(path, outside)
    with replaced(path):
        path.symlink_to(outside)
        if kind.path.startswith("user"):
            assert kind.read(sample) == originals[kind.path]
        else:
            refusal(kind, sample)
            assert path.is_symlink()
        path.unlink()
        path.symlink_to(path)
        refusal(kind, sample)


class Payload:
    """A pickle that creates a file when it is loaded."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return (open, (str(self.path), "w"))


def malicious(kind, path, canary):
    """Yield contents that an unsafe reader would execute."""
    yield pickle.dumps(Payload(canary))
    torch.save(Payload(canary), path)
    yield path.read_bytes()
    np.savez(path.with_suffix(".npz"), a=np.array([Payload(canary)], dtype=object))
    yield path.with_suffix(".npz").read_bytes()
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("data.pkl", pickle.dumps(Payload(canary)))
    yield path.read_bytes()
    for tag in ("apply:os.mkdir", "new:os.mkdir", "apply:builtins.open"):
        yield f"!!python/object/{tag} [{canary}]\n".encode()
        yield f"config: !!python/object/{tag} [{canary}]\n".encode()
    yield f"!!python/object/apply:os.system ['touch {canary}']\n".encode()
    yield b"!!python/name:os.system\n"
    yield f"__import__('os').mkdir({str(canary)!r})\n".encode()


@EVERY_KIND
def test_malicious_file_is_rejected_unexecuted(kind, sample, tmp_path, canary):
    path = sample / kind.path
    with replaced(path):
        for content in malicious(kind, tmp_path / "made", canary):
            path.write_bytes(content)
            found, _ = read_or_refused(kind, sample)
            assert found is None or (kind.path == RECORDS and found == [])
            assert not canary.exists()


def test_canary_detects_execution(tmp_path):
    canary = tmp_path / "canary"
    pickle.loads(pickle.dumps(Payload(canary))).close()  # noqa: S301 - what the readers must not do
    assert canary.exists()


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("a: &a [x, x, x, x]\nb: &b [*a, *a, *a, *a]\nc: [*b, *b, *b, *b]\n", "anchors are not supported"),
        ("a: &a [*a]\n", "anchors are not supported"),
        ("a: " + "[" * 500, "nested deeper than 32 levels"),
        ("{a: " * 50000, "nested deeper than 32 levels"),
        ("a: " + "9" * 100000, "a number has 100000 digits"),
        ("a: 1\nb: 2\na: 3\n", "line 3: duplicate key 'a'"),
        ("1: 2\n", "key 1 is not a text"),
        ("a: !!binary x\n", "the tag .* is not supported"),
        ("a: 1\n--- \nb: 1\n", "expected a single document"),
        ("\x00", "special characters"),
        ("- a\n", "is a list, expected fields"),
        ("word\n", "is a str, expected fields"),
        ("# nothing\n", "is empty, expected fields"),
        ("a: [", "is not plain YAML"),
        ("\xff", "is not UTF-8 text"),
        ("a: 1\n" + "#" * MAX_YAML_SIZE, "bytes, at most 262144 are allowed"),
    ],
    ids=lambda text: text[:20],
)
def test_yaml_beyond_plain_data_is_rejected(sample, text, complaint):
    for kind in YAML_FILES:
        path = sample / kind.path
        with replaced(path):
            path.write_bytes(text.encode("latin-1"))
            with pytest.raises(kind.error, match=rf"{path.name}.*{complaint}"):
                kind.read(sample)


@given(
    st.recursive(
        st.one_of(st.none(), st.booleans(), st.integers(-(2**63), 2**64), st.floats(allow_nan=False), st.text()),
        lambda inner: st.one_of(st.lists(inner, max_size=3), st.dictionaries(st.text(), inner, max_size=3)),
        max_leaves=10,
    )
)
@settings(derandomize=True)
def test_plain_yaml_round_trip(value):
    assert parse_yaml(yaml.safe_dump(value)) == value


@given(st.text(alphabet="ab:-[]{}&*!?|>'\"%@#<=\n ,.0123456789~", max_size=60))
@settings(derandomize=True)
def test_any_yaml_is_parsed_or_rejected(text):
    with contextlib.suppress(ValueError):
        repr(parse_yaml(text))


def with_header(header, data=b"", claimed=None):
    text = header if isinstance(header, bytes) else json.dumps(header).encode()
    return (len(text) if claimed is None else claimed).to_bytes(8, "little") + text + data


@pytest.mark.parametrize("kind", TENSORS, ids=lambda kind: kind.path)
def test_tensor_file_with_false_header_is_rejected(kind, sample):
    path = sample / kind.path
    whole = {"__metadata__": safetensors_header(path)["__metadata__"]}
    header = json.loads(whole["__metadata__"]["header"])

    def with_tensor(data=bytes(8), **fields):
        tensor = {"dtype": "F32", "shape": [2], "data_offsets": [0, 8], **fields}
        return with_header({**whole, "w": tensor}, data)

    def with_metadata(**fields):
        return with_header({"__metadata__": {"header": json.dumps({**header, **fields})}})

    wrong = {
        "is not a complete safetensors file": [
            with_header(whole, claimed=2**63),
            with_header(whole, claimed=0),
            with_header(whole, claimed=len(json.dumps(whole)) + 1),
            with_header(b"[" * 100000),
            with_header(b"\xff" * 100),
            with_tensor(b""),
            with_tensor(b"1234", shape=[2**40], data_offsets=[0, 2**42]),
            with_tensor(data_offsets=[8, 0]),
            with_tensor(shape=[3]),
            with_tensor(shape=[-1]),
            with_tensor(dtype="EVIL"),
            with_tensor(dtype="F8_E4M3", shape=[8]),
            with_tensor(dtype="BF16", shape=[4]),
        ],
        "w is float16, expected one of": [with_tensor(dtype="F16", shape=[4])],
        "format is None": [with_header({}), with_header({"__metadata__": header})],
        "version is '3'": [with_metadata(version="3")],
        "facts of the header is not a text": [with_metadata(facts=1)],
        "header is not JSON": [with_header({"__metadata__": {"header": "[" * 100000}})],
        "sha256 is": [
            with_tensor(),
            with_metadata(facts="[" * 100000),
            with_metadata(sha256=""),
        ],
    }
    with replaced(path):
        for complaint, contents in wrong.items():
            for content in contents:
                path.write_bytes(content)
                assert complaint in refusal(kind, sample)


def safetensors_header(path):
    content = path.read_bytes()
    return json.loads(content[8 : 8 + int.from_bytes(content[:8], "little")])


def resealed(path, arrays, facts):
    """Change arrays and facts of a file (None removes one) and write a valid checksum."""
    kind = json.loads(safetensors_header(path)["__metadata__"]["header"])["format"].rpartition("/")[2]
    found, stored_facts = read_arrays(path, kind)
    whole = {name: array for name, array in {**found, **arrays}.items() if array is not None}
    path.unlink()
    write_arrays(
        path, kind, whole, {name: fact for name, fact in {**stored_facts, **facts}.items() if fact is not None}
    )


@pytest.mark.parametrize(
    ("name", "arrays", "facts", "complaint"),
    [
        ("model", {"decoder.0.bias": np.zeros(5, np.float32)}, {}, "does not fit .*decoder.0.bias"),
        ("model", {"decoder.0.bias": np.zeros(4)}, {}, "decoder.0.bias is torch.float64, expected torch.float32"),
        ("model", {"decoder.0.bias": None}, {}, "does not fit .*decoder.0.bias"),
        ("model", {"other": np.zeros(1, np.float32)}, {}, "does not fit .*other"),
        ("model", {"decoder.0.bias": np.full(4, np.nan, np.float32)}, {}, "decoder.0.bias has values that are not"),
        ("model", {"decoder.0.bias": np.zeros(4, np.uint64)}, {}, "decoder.0.bias is uint64"),
        ("model", {}, {"updates": None}, "updates is missing"),
        ("model", {}, {"updates": "9"}, "updates is '9': expected a whole number"),
        ("checkpoint", {}, {"updates": None}, "updates is missing"),
        ("checkpoint", {}, {"updates": 4}, "updates is 4: expected 3"),
        ("checkpoint", {}, {"observations": -1}, "observations is -1"),
        ("checkpoint", {}, {"counters": [1]}, r"counters is \[1\]"),
        ("checkpoint", {"network/decoder.0.bias": np.full(4, np.inf, np.float32)}, {}, "values that are not finite"),
    ],
)
def test_wrong_tensors_with_valid_checksum_are_rejected(sample, name, arrays, facts, complaint):
    kind = next(kind for kind in TENSORS if f"/{kind.path}".rpartition("/")[2].startswith(name))
    path = sample / kind.path
    content = path.read_bytes()
    with replaced(path):
        path.write_bytes(content)
        resealed(path, arrays, facts)
        with pytest.raises(CorruptFileError, match=rf"(?s){path.name}.*{complaint}"):
            kind.read(sample)


def test_observations_of_other_camera_are_rejected(sample):
    path = sample / "observations" / "format.json"
    content = {**json.loads(path.read_text()), "image_shape": [6, 24, 3]}  # as many bytes
    with replaced(path):
        path.write_text(json.dumps(content))
        with pytest.raises(ObservationError, match=r"format.json: image_shape is \[6, 24, 3\], but the camera is"):
            Session.open_read_only(sample).open_observations()


@pytest.mark.parametrize("folder", ["observations", "checkpoints", "fingerprints", "identification", "figures"])
def test_folder_link_out_of_session_is_rejected(tmp_path, folder):
    path, outside = make_sample(tmp_path / "root"), tmp_path / "outside"
    (path / "figures").mkdir()
    (path / folder).rename(outside)
    (path / folder).symlink_to(outside)
    before = sorted(entry.name for entry in outside.rglob("*"))
    for attempt in (
        lambda: Session.open_read_only(path),
        lambda: Session.open_for_writing(configuration(tmp_path / "root", resume=True)),
    ):
        with pytest.raises(SessionError, match=rf"{folder} leads out of {path}, to {outside}"):
            attempt()
    assert sorted(entry.name for entry in outside.rglob("*")) == before


def open_everything(config):
    with Session.open_for_writing(config) as session, session.open_observations(), session.open_table("exploration"):
        pass


@pytest.mark.parametrize("name", [".lock", "exploration.csv", "observations/observations.bin"])
def test_link_is_not_written_through(tmp_path, name):
    path, outside = make_sample(tmp_path / "root"), tmp_path / "outside"
    outside.write_text("precious")
    (path / name).unlink()
    (path / name).symlink_to(outside)
    with pytest.raises(SessionError, match="it is a symbolic link"):
        open_everything(configuration(tmp_path / "root", resume=True))
    assert outside.read_text() == "precious"


@pytest.mark.parametrize("encoding", ["ebcdic-none", "utf-7", "utf-16", "rot13"])
def test_xml_in_other_encoding_is_rejected(sample, encoding):
    kind, path = next(kind for kind in KINDS if kind.path == "user/thing.urdf"), sample / "user/thing.urdf"
    with replaced(path):
        path.write_text(f'<?xml version="1.0" encoding="{encoding}"?><robot/>')
        refusal(kind, sample)


def test_xml_entity_expansion_is_rejected(sample):
    kind, path = next(kind for kind in KINDS if kind.path == "user/thing.urdf"), sample / "user/thing.urdf"
    entities = "".join(f'<!ENTITY e{n} "{f"&e{n - 1};" * 10}">' for n in range(1, 30))
    with replaced(path):
        path.write_text(f'<!DOCTYPE robot [<!ENTITY e0 "laugh">{entities}]><robot name="&e29;"/>')
        refusal(kind, sample)
