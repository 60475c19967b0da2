"""Installs the Python library, through catkin or with `pip install .`; name and version come from package.xml."""

import shutil
import subprocess
import warnings
from pathlib import Path
from xml.etree import ElementTree

from setuptools import find_packages, setup
from setuptools.command.build_py import build_py

ROOT = Path(__file__).resolve().parent
PACKAGE = ElementTree.parse(ROOT / "package.xml").getroot()  # noqa: S314 - this package's own file
NAME = PACKAGE.findtext("name")
SHARED = ("config", "worlds")
REQUIREMENTS = [
    "matplotlib",
    "numpy<2",
    "opencv-python-headless",
    "pybullet",
    "PyYAML",
    "safetensors",
    "scikit-learn",
    "scipy",
    "torch",
]


class BuildWithKernels(build_py):
    """Compiles the kernels next to the library if there is a C compiler; without them training is slower."""

    def run(self):
        super().run()
        source = Path("src", NAME, "model", "native", "kernels.c")
        target = Path(self.build_lib, NAME, f"lib{NAME}_kernels.so")
        options = ["-std=gnu11", "-O2", "-ffp-contract=fast", "-march=native", "-shared", "-fPIC"]
        compiler = shutil.which("gcc") or shutil.which("cc")
        try:
            subprocess.run([compiler or "cc", *options, "-o", target, source], check=True, cwd=ROOT)
        except (OSError, subprocess.CalledProcessError) as error:
            warnings.warn(f"kernels not compiled: {error}; training will be slower", stacklevel=1)


def shared_files():
    """Return the profiles and worlds by the folder they are installed in."""
    share = Path("share", NAME)
    files = {str(share): ["package.xml"]}
    for folder in SHARED:
        for path in sorted((ROOT / folder).rglob("*")):
            if path.is_file():
                relative = path.relative_to(ROOT)
                files.setdefault(str(share / relative.parent), []).append(str(relative))
    return list(files.items())


setup(
    name=NAME,
    version=PACKAGE.findtext("version"),
    description=" ".join(PACKAGE.findtext("description").split()),
    license=PACKAGE.findtext("license"),
    python_requires=">=3.8",
    packages=find_packages("src"),
    package_dir={"": "src"},
    package_data={NAME: ["py.typed"], f"{NAME}.model.native": ["*.c", "*.h"]},
    data_files=shared_files(),
    cmdclass={"build_py": BuildWithKernels},
    install_requires=REQUIREMENTS,
)
