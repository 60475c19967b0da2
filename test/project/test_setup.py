"""setup.bash: shells, other workspaces, moved checkouts."""

import os
import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
SHELLS = [["bash"], ["bash", "-u"], ["zsh", "-f"]]
MANIFEST = "<package><name>lab_models</name><version>0.0.0</version><description>-</description></package>"


def run(shell, script, setup=ROOT / "setup.bash", **variables):
    """Run a script after sourcing setup.bash in an otherwise empty environment."""
    environment = {"HOME": os.environ["HOME"], "PATH": "/usr/bin:/bin", "SETUP": str(setup), **variables}
    command = [*shell, "-c", f'. "$SETUP" || exit 3\n{script}']
    return subprocess.run(command, env=environment, cwd="/", check=False, capture_output=True, text=True)


@pytest.mark.parametrize("shell", SHELLS, ids=" ".join)
def test_setup_works_in_bash_and_zsh(shell):
    if shutil.which(shell[0]) is None:
        pytest.skip(f"{shell[0]} is not installed")
    result = run(shell, "rospack find embodied_active_learning && command -v python3")
    assert result.stdout.splitlines() == [str(ROOT), f"{ROOT}/.venv/bin/python3"], result.stderr


def test_setup_refuses_other_shells():
    if "BASH_VERSION" in subprocess.run(["sh", "-c", "set"], check=True, capture_output=True, text=True).stdout:
        pytest.skip("sh is bash")
    result = run(["sh"], "true")
    assert (result.returncode, result.stderr) == (3, "setup.bash: unknown shell; use bash or zsh\n")


def test_setup_keeps_workspaces_sourced_before(tmp_path):
    package = tmp_path / "src" / "lab_models"
    package.mkdir(parents=True)
    (package / "package.xml").write_text(MANIFEST)
    (tmp_path / "devel").mkdir()
    (tmp_path / "devel" / ".catkin").write_text(str(tmp_path / "src"))
    result = run(
        ["bash"],
        "rospack find lab_models; rospack find embodied_active_learning",
        CMAKE_PREFIX_PATH=f"{tmp_path}/devel",
    )
    assert result.stdout.splitlines() == [str(package), str(ROOT)], result.stderr


@pytest.mark.parametrize(
    ("built_in", "message"),
    [(None, "the package is not built; run 'make'"), ("/old", "was built in /old, but is now in")],
)
def test_setup_detects_missing_build_and_moved_checkout(tmp_path, built_in, message):
    shutil.copy(ROOT / "setup.bash", tmp_path)
    if built_in:
        (tmp_path / "build" / "devel").mkdir(parents=True)
        (tmp_path / "build" / "devel" / "setup.bash").touch()
        (tmp_path / "build" / "CMakeCache.txt").write_text(f"CMAKE_HOME_DIRECTORY:INTERNAL={built_in}\n")
    result = run(["bash"], "true", setup=tmp_path / "setup.bash")
    assert result.returncode == 3
    assert message in result.stderr
    assert str(tmp_path) in result.stderr
