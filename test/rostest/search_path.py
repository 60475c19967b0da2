"""Makes the helpers of the tests importable in the programs that rostest starts."""

import sys
from pathlib import Path

_TEST = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(_TEST), str(_TEST / "support")]
