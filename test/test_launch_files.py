"""Launch files: every argument says what it is for."""

from pathlib import Path
from xml.etree import ElementTree

import pytest

LAUNCH = sorted((Path(__file__).resolve().parents[1] / "launch").glob("*.launch"))


@pytest.mark.parametrize("path", LAUNCH, ids=lambda path: path.stem)
def test_every_argument_has_its_meaning_beside_it(path):
    for argument in ElementTree.parse(path).getroot().iter("arg"):
        if argument.get("value") is None:
            assert argument.get("doc"), f"{path.name}: argument {argument.get('name')} lacks doc="
