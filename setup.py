"""Build the extensions, and be a ROS 2 package; all else stands in pyproject.toml."""

import os
import sysconfig

from setuptools import Extension, setup

# `colcon build --symlink-install` runs a link to this file elsewhere, and links too little else.
HERE = os.path.dirname(os.path.realpath(__file__))
for name in ("pyproject.toml", "README.md", "runtime", "whiteboard"):
    if not os.path.exists(name):
        os.symlink(os.path.join(HERE, name), name)

# One binary for every Python from 3.11, except those without the interpreter's lock, which have no
# stable interface yet: there it is built for that one version.
STABLE = not sysconfig.get_config_var("Py_GIL_DISABLED")


def extension(name, source, **options):
    """Describe an extension module; without a compiler, llfsm is installed without it."""
    return Extension(
        name,
        [source],
        optional=True,
        py_limited_api=STABLE,
        define_macros=[("Py_LIMITED_API", "0x030b0000")] if STABLE else [],
        # Much of the work is calls to the interpreter: without detours through jump tables.
        extra_compile_args=["-std=c11", "-O2", "-fno-plt", "-Wall", "-Wextra"],
        **options,
    )


setup(
    license="Apache-2.0",
    python_requires=">=3.11",  # in pyproject.toml it would be no plain text, which colcon needs
    options={"bdist_wheel": {"py_limited_api": "cp311"}} if STABLE else {},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/llfsm"]),
        ("share/llfsm", ["package.xml"]),
        ("share/llfsm/launch", ["launch/wall.launch.py"]),
    ],
    ext_modules=[
        extension(
            "llfsm.whiteboard._shm",
            "whiteboard/_shm.c",
            include_dirs=["whiteboard/include"],
            depends=[
                "whiteboard/_board.h",
                "whiteboard/_fields.h",
                "whiteboard/_recent.h",
                "whiteboard/_waiting.h",
                "whiteboard/include/llfsm_whiteboard.h",
            ],
        ),
        extension(
            "llfsm.runtime.engine._ringlet",
            "runtime/engine/_ringlet.c",
            depends=["runtime/engine/_records.h"],
        ),
    ],
)
