"""The compiled part of the package; all else about it is in pyproject.toml."""

from pathlib import Path

from setuptools import Extension, setup

SOURCES = Path("hbbatch/packed/c")

KERNELS = Extension(
    "hbbatch.packed._kernels",
    sorted(map(str, SOURCES.glob("*.c"))),
    depends=sorted(map(str, SOURCES.glob("*.h"))),
    # Nothing is fused or reordered: rounding is the same whatever the machine.
    extra_compile_args=[
        *("-std=c11", "-O3", "-fvisibility=hidden"),
        "-g0",  # a wheel names no folder of who built it
        *("-ffp-contract=off", "-fno-math-errno", "-fno-trapping-math"),
    ],
    libraries=["m"],
    py_limited_api=True,
    optional=True,  # without a compiler the package works all the same, only slower
)

setup(ext_modules=[KERNELS], options={"bdist_wheel": {"py_limited_api": "cp311"}})
