"""Build the shared-memory extension, and be a ROS 2 package; all else stands in pyproject.toml."""

import os

from setuptools import Extension, setup

# `colcon build --symlink-install` runs a link to this file elsewhere, and links too little else.
HERE = os.path.dirname(os.path.realpath(__file__))
for name in ("pyproject.toml", "README.md", "whiteboard"):
    if not os.path.exists(name):
        os.symlink(os.path.join(HERE, name), name)

setup(
    license="Apache-2.0",
    python_requires=">=3.11",  # in pyproject.toml it would be no plain text, which colcon needs
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/llfsm"]),
        ("share/llfsm", ["package.xml"]),
        ("share/llfsm/launch", ["launch/wall.launch.py"]),
    ],
    ext_modules=[
        Extension(
            "llfsm.whiteboard._shm",
            ["whiteboard/_shm.c"],
            include_dirs=["whiteboard/include"],
            depends=[
                "whiteboard/_board.h",
                "whiteboard/_fields.h",
                "whiteboard/include/llfsm_whiteboard.h",
            ],
            optional=True,
            extra_compile_args=["-std=c11", "-O2", "-Wall", "-Wextra"],
        )
    ],
)
