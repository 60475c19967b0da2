"""The node trainer, without a ROS master."""

import runpy

import pytest

from embodied_active_learning.config import Config
from embodied_active_learning.errors import ConfigError
from launching import ROOT


@pytest.mark.parametrize("setting", ["explorer", "measure"])
def test_unusable_explorer_or_measure_creates_no_session(tmp_path, setting):
    sections = {"exploration": {setting: "no_such_module:Thing"}, "session": {"root": str(tmp_path), "name": "run"}}
    main = runpy.run_path(str(ROOT / "nodes" / "trainer"))["main"]
    with pytest.raises(ConfigError, match="check PYTHONPATH"):
        main(Config.from_dict(sections))
    assert list(tmp_path.iterdir()) == []
