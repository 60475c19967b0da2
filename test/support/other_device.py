"""pytest plugin that runs the learner on a fake device, which rejects the same operations as CUDA.

A device stays registered with torch until the process ends, so these tests run in a process of their own.
"""

import hashlib
import os
import subprocess
from pathlib import Path

import torch

from embodied_active_learning.model import learner

SOURCE = Path(__file__).with_suffix(".cpp")
LIBRARY = "OTHER_DEVICE_LIBRARY"  # environment variable with its path
NAME = "other"


class Runtime:
    """The fake device's counterpart of the module torch.cuda."""

    @staticmethod
    def is_available():
        return True

    @staticmethod
    def device_count():
        return 1

    @staticmethod
    def current_device():
        return 0


def build(folder):
    """Compile the device for the installed torch, unless the folder has it already. Return the library's path."""
    torch_folder = Path(torch.__file__).parent
    abi = f"-D_GLIBCXX_USE_CXX11_ABI={int(torch.compiled_with_cxx11_abi())}"
    links = [f"-L{torch_folder / 'lib'}", "-ltorch", "-ltorch_cpu", "-lc10"]
    includes = ["-isystem", str(torch_folder / "include")]
    command = ["g++", "-std=c++17", "-O0", "-fPIC", "-shared", abi, *includes, str(SOURCE), *links]
    content = hashlib.sha256(SOURCE.read_bytes() + repr((torch.__version__, command)).encode()).hexdigest()
    library = folder / f"other_device_{content[:16]}.so"
    if not library.exists():
        unfinished = library.with_suffix(f".{os.getpid()}.so")
        subprocess.run([*command, "-o", str(unfinished)], check=True)
        unfinished.replace(library)
    return library


def pytest_configure():
    """Put every learner of this process on the fake device, whatever its configuration."""
    torch.ops.load_library(os.environ[LIBRARY])
    torch.utils.rename_privateuse1_backend(NAME)
    torch._register_device_module(NAME, Runtime)
    learner.choose_device = lambda name: torch.device(NAME)
