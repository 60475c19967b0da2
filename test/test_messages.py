"""Whoever is stopped by a message finds it in a table, with its cause and the way out; and what it names exists."""

import re
import sys
from collections import Counter
from pathlib import Path
from xml.etree import ElementTree

import pytest

from embodied_active_learning.config import Config, settings
from embodied_active_learning.ros import names

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tools"))

from messages import TABLES, Module, Scanner, explained, find_messages  # noqa: E402  lies in tools/, which is no package

# Where a message is given whose text is not written there, and where it is written.
PASSED_ON = {
    "src/embodied_active_learning/franka/driver.py: FrankaDriver._begin": "what preparing the robot has raised",
    "src/embodied_active_learning/franka/driver.py: FrankaDriver._measured": "what preparing the robot has raised",
    "src/embodied_active_learning/ros/arm_client.py: ArmClient.stop": "the arm's answer: what its node raises",
    "src/embodied_active_learning/ros/arm_client.py: _command": "the arm's answer: what its node raises",
    "src/embodied_active_learning/ros/failure.py: FailureWatch.check": "the reason that another node has left",
    "src/embodied_active_learning/ros/franka_keeper.py: FrankaKeeper.recover": "what the driver says it lacks",
    "src/embodied_active_learning/ros/guided_arm.py: GuidedArm._bear": "an error that was raised elsewhere",
    "src/embodied_active_learning/ros/guided_arm.py: GuidedArm.wait_while_paused": "told as: paused, waiting for ...",
    "src/embodied_active_learning/ros/node.py: wait_until": "what its callers say that they wait for",
    "src/embodied_active_learning/training_run.py: TrainingRun._restore": "puts the file before what was raised",
}
FOUND = find_messages()
ROWS = {table: explained(table) for table in TABLES}
# Services and topics that are not this package's own, as its messages and tables name them.
OTHERS_NAMES = {"/clock", "/use_sim_time", "/diagnostics", "/trainer"}


def rows():
    """Every line of the tables that explain messages, with the file it stands in."""
    for table in TABLES:
        for line in (ROOT / table).read_text(encoding="utf-8").splitlines():
            if line.startswith("| `") and any(f"`{message}`" in line for message in ROWS[table]):
                yield line, table


def told():
    """Every message with where it is given, and every line that explains some."""
    yield from ((message, where[0]) for message, where in FOUND.templates.items())
    yield from rows()


def test_every_message_is_in_one_of_the_tables():
    missing = set(FOUND.templates) - {message for rows in ROWS.values() for message in rows}
    told = [f"{message}   ({', '.join(FOUND.templates[message])})" for message in sorted(missing)]
    assert told == [], "put each into README.md or docs/messages.md, with its cause and the way out"


def test_every_row_of_the_tables_is_a_message_of_the_code():
    stale = {table: [row for row in rows if row not in FOUND.templates] for table, rows in ROWS.items()}
    assert stale == {table: [] for table in TABLES}, "no code says these any more, or not in these words"


def test_no_message_is_explained_twice():
    counts = Counter(message for rows in ROWS.values() for message in rows)
    assert [message for message, count in counts.items() if count > 1] == []


def test_every_row_says_cause_and_way_out():
    for line, where in rows():
        cells = [cell.strip() for cell in re.split(r"(?<!\\)\|", line)[1:-1]]
        assert len(cells) == 3, f"{where}: {line}"
        assert all(cells), f"{where}: {line}"


def test_what_is_told_without_its_text_in_sight_is_known_and_little():
    assert sorted(FOUND.unseen) == sorted(PASSED_ON), "write the text where the message is given, or list the place"


@pytest.mark.parametrize(
    ("code", "messages"),
    [
        ('raise SessionError(f"{path} is lost: look for it")', ["… is lost: look for it"]),
        ('raise DivergenceError("too " + "far")', ["too far"]),
        ('rospy.logwarn("%s is late by %.1f s", name, age)', ["… is late by … s"]),
        ('LOG.warning("%d lost", count)', ["… lost"]),
        ('rospy.loginfo("all is well")', []),
        ('return Health(WARN, "tired", values)', ["tired"]),
        ('return Health(OK, "fine", values)', []),
        ('return TriggerResponse(False, "no")', ["no"]),
        ('return TriggerResponse(True, "yes")', []),
        ('wait_until(ready, lambda: f"the {thing}")', ["waiting for the …"]),
        ('raise _READER.refuse(path, f"is {size} bytes long")', ["… is … bytes long: …"]),
        ("raise ConfigError(f\"{key} is {'too ' if much else ''}large\")", ["… is too large", "… is large"]),
        ('raise ConfigError(f"call {rospy.resolve_name(names.ARM_RECOVER)}")', ["call /arm/recover"]),
        ('raise SessionError(_in_words(who))\n\ndef _in_words(who):\n    return f"{who} has it"', ["… has it"]),
        ('sys.stderr.write("gone\\n")', ["gone"]),
    ],
)
def test_a_message_is_seen_however_it_is_given(code, messages, tmp_path, monkeypatch):
    monkeypatch.setattr("messages.ROOT", tmp_path)
    path = tmp_path / "code.py"
    path.write_text(f"def give():\n    {code}\n", encoding="utf-8")
    assert list(Scanner([Module.read(path)]).scan().templates) == messages


def test_the_parameters_that_are_named_exist():
    known = {f"{section}/{item.name}" for section, item in settings()}
    sections = "|".join(Config.__dataclass_fields__)
    for text, where in told():
        for name in re.findall(rf"(?<![\w/.-])((?:{sections})/[a-z_]+)(?![\w/])", text):
            assert name in known, f"{where} names the parameter {name}: {text}"


def test_the_services_and_topics_that_are_named_exist():
    known = {f"/{name}" for key, name in vars(names).items() if key.isupper()} | OTHERS_NAMES
    for text, where in told():
        for name in re.findall(r"(?<![\w/.…~)>-])(/[a-z][a-z_]*(?:/[a-z_]+)*)(?![\w/.-])", text):
            assert name in known, f"{where} names {name}: {text}"


def test_the_launch_arguments_and_files_that_are_named_exist():
    launches = list((ROOT / "launch").glob("*.launch"))
    arguments = {item.get("name") for path in launches for item in ElementTree.parse(path).getroot().iter("arg")}
    for text, where in told():
        for name in re.findall(r"\b([a-z_]+):=", text):
            assert name in arguments, f"{where} names the argument {name}: {text}"
        for name in re.findall(r"\b((?:docs|tools|config|worlds|launch)/[\w.-]+\.\w+|\w+\.launch)\b", text):
            assert (ROOT / name).exists() or (ROOT / "launch" / name).exists(), f"{where} names {name}: {text}"
