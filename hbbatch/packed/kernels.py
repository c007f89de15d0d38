"""The compiled kernels (`c/`), where they were built when the package was installed.

Where there was no compiler they are missing, and everything still works, only slower: torch modules
step the filters (`tracking.tensor_bank`), numpy does the rest.
"""

from __future__ import annotations

from importlib.util import find_spec
from typing import Final

AVAILABLE: Final = find_spec("hbbatch.packed._kernels") is not None

if AVAILABLE:
    from hbbatch.packed._kernels import lines, local_fit, match, steps

__all__ = ["AVAILABLE", "lines", "local_fit", "match", "steps"]
