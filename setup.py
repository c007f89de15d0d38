"""The compiled parts of the package; all else about it is in pyproject.toml."""

from pathlib import Path

from setuptools import Extension, setup

ROOT = Path("hbbatch")
SHARED = ROOT / "c"


def extension(package: str, name: str) -> Extension:
    """An extension below a package, from what lies in its folder `c` and what all share."""
    folders = (ROOT / package / "c", SHARED)
    return Extension(
        f"hbbatch.{package}.{name}",
        [str(path) for folder in folders for path in sorted(folder.glob("*.c"))],
        depends=[str(path) for folder in folders for path in sorted(folder.glob("*.h"))],
        include_dirs=[str(SHARED)],
        # Nothing is fused or reordered but what is written so (packed/c/layers.h).
        extra_compile_args=[
            *("-std=c11", "-O3", "-fvisibility=hidden"),
            "-g0",  # a wheel names no folder of who built it
            *("-ffp-contract=off", "-fno-math-errno", "-fno-trapping-math"),
        ],
        libraries=["m"],
        py_limited_api=True,
        optional=True,  # without a compiler the package works all the same, only slower
    )


setup(
    ext_modules=[extension("packed", "_kernels"), extension("sources", "_cdr")],
    options={"bdist_wheel": {"py_limited_api": "cp311"}},
)
