"""Whether the compiled kernels (`_kernels.c`) were built when the package was installed.

Where there was no compiler they are missing, and everything still works, only slower.
"""

from __future__ import annotations

from importlib.util import find_spec
from typing import Final

AVAILABLE: Final = find_spec("hbbatch.packed._kernels") is not None
