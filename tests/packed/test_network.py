"""The networks as they are computed on other processors than this one."""

from __future__ import annotations

import subprocess
import sysconfig
from importlib.machinery import ExtensionFileLoader
from importlib.util import module_from_spec, spec_from_loader
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from hbbatch.errors import WeightsError
from hbbatch.model.hybrid import HybridFilter
from hbbatch.packed import kalman
from hbbatch.packed.filters import packed_filter
from tests.packed.test_kernels import call

FOLDER = Path(kalman.__file__).parent / "c"
SHARED = FOLDER.parents[1] / "c"


def compiled(folder: Path, lanes: int) -> ModuleType:
    """The kernels without registers of more lanes."""
    target = folder / f"_kernels_{lanes}.so"
    sources = [str(path) for place in (FOLDER, SHARED) for path in place.glob("*.c")]
    include = [f"-I{path}" for path in (SHARED, sysconfig.get_paths()["include"])]
    flags = [*("-std=c11", "-O3", "-ffp-contract=off", "-shared", "-fPIC"), f"-DMOST_LANES={lanes}"]
    command = ["cc", *flags, *include, *sources, "-o", str(target), "-lm"]
    subprocess.run(command, check=True, capture_output=True)
    loader = ExtensionFileLoader("_kernels", str(target))
    spec = spec_from_loader("_kernels", loader)
    assert spec is not None
    module = module_from_spec(spec)
    loader.exec_module(module)
    return module


@pytest.mark.parametrize("wide", [{"memory": 256}, {"hidden": 1024}])
def test_networks_too_wide_for_the_kernels_are_refused_when_loaded(wide: dict[str, int]) -> None:
    motion = HybridFilter(("a", "b"), "cv", **wide)
    parameters = {name: value.numpy() for name, value in motion.state_dict().items()}
    options = {"motion_model": "cv", **wide}
    with pytest.raises(WeightsError, match="the kernels have room for 1024: train with a smaller"):
        packed_filter("hybrid", ("a", "b"), options, parameters)


@pytest.mark.parametrize("lanes", [4, 8])
def test_networks_say_the_same_whatever_the_processor(
    kernels: ModuleType, tmp_path: Path, lanes: int
) -> None:
    other = compiled(tmp_path, lanes)
    mine, theirs = call("hybrid"), call("hybrid")
    rng = np.random.default_rng(0)
    for weights in ("encoder", "heads_in", "heads_out", "gates", "kept", "candidate", "read_out"):
        mine[weights] = theirs[weights] = 0.1 * rng.normal(size=mine[weights].shape).astype("f4")
    kernels.steps(*mine.values())
    other.steps(*theirs.values())
    for what in ("tracks boxes", "tracks state"):
        assert np.abs(mine[what]).max() > 0.1
        assert theirs[what] == pytest.approx(mine[what], rel=1e-4, abs=1e-5)
