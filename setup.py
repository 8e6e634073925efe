"""Build the shared-memory extension; everything else stands in pyproject.toml."""

from setuptools import Extension, setup

setup(
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
    ]
)
