"""The compiled part of the package; all else about it is in pyproject.toml."""

from setuptools import Extension, setup

KERNELS = Extension(
    "hbbatch.packed._kernels",
    ["hbbatch/packed/_kernels.c"],
    # Nothing is fused or reordered: rounding is the same whatever the machine.
    extra_compile_args=["-O3", "-ffp-contract=off", "-fno-math-errno", "-fno-trapping-math"],
    libraries=["m"],
    py_limited_api=True,
    optional=True,  # without a compiler the package works all the same, only slower
)

setup(ext_modules=[KERNELS], options={"bdist_wheel": {"py_limited_api": "cp311"}})
