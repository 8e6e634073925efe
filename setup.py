"""Find the packages, build the extensions, and be a ROS 2 package; the rest is in pyproject.toml.

Two environment variables change what is built:

* ``LLFSM_EXTENSIONS``: ``required`` fails when an extension cannot be compiled, ``none`` compiles
  none; otherwise what cannot be compiled is left out.
* ``LLFSM_REPOSITORY``: the repository's web address, to which the links in README.md lead where
  it is shown elsewhere.
"""

import os
import re
import shutil
import sys
import sysconfig
import tomllib

from setuptools import Extension, find_namespace_packages, setup
from setuptools.command.sdist import sdist

# `colcon build --symlink-install` runs a link to this file elsewhere, and links too little else.
HERE = os.path.dirname(os.path.realpath(__file__))
for name in ("pyproject.toml", "README.md", "runtime", "whiteboard"):
    if not os.path.exists(name):
        os.symlink(os.path.join(HERE, name), name)

# The folders that are packages of llfsm; links in src lead to them.
FOLDERS = ("bridges", "machines", "runtime", "whiteboard")

# One binary for every Python from 3.11, except those without the interpreter's lock, which have no
# stable interface yet: there it is built for that one version.
STABLE = not sysconfig.get_config_var("Py_GIL_DISABLED")
EXTENSIONS = os.environ.get("LLFSM_EXTENSIONS", "optional")
if EXTENSIONS not in ("optional", "required", "none"):
    sys.exit(f"LLFSM_EXTENSIONS={EXTENSIONS}: neither optional, required nor none")


REPOSITORY = os.environ.get("LLFSM_REPOSITORY", "")
with open("pyproject.toml", "rb") as file:
    VERSION = tomllib.load(file)["project"]["version"]


def packages():
    """Return where packages are, and their names.

    Archives and checkouts without symbolic links have a small file in the place of each link. There
    the folders themselves are the packages.
    """
    places, names = {"": "src"}, find_namespace_packages("src")
    if not all(os.path.isdir(f"src/llfsm/{folder}") for folder in FOLDERS):
        for folder in FOLDERS:
            if not os.path.isdir(folder):
                sys.exit(f"not all of llfsm: neither src/llfsm/{folder} nor {folder} is a folder")
            inner = find_namespace_packages(folder)
            places[f"llfsm.{folder}"] = folder
            names += [f"llfsm.{folder}", *(f"llfsm.{folder}.{name}" for name in inner)]
    return places, names


def description():
    """Return README.md, whose links lead to the repository if its address is known."""
    with open("README.md", encoding="utf-8") as file:
        text = file.read()
    if REPOSITORY:
        outside = r"(?!https?:|#)"
        text = re.sub(rf"(!\[[^]]*\]\(){outside}", rf"\1{REPOSITORY}/raw/v{VERSION}/", text)
        text = re.sub(rf"(\]\(){outside}", rf"\1{REPOSITORY}/blob/v{VERSION}/", text)
    return text


class SourceDistribution(sdist):
    """The repository as it is, with its links."""

    def make_release_tree(self, base_dir, files):
        """Lay out the files; each link takes the place of what was found behind it."""
        links = tuple(f"src/llfsm/{folder}" for folder in FOLDERS)
        kept = [file for file in files if not file.startswith(tuple(f"{link}/" for link in links))]
        shutil.rmtree(base_dir, ignore_errors=True)  # what a killed one has left
        super().make_release_tree(base_dir, kept)
        for folder, link in zip(FOLDERS, links, strict=True):
            os.symlink(f"../../{folder}", os.path.join(base_dir, link))


def extension(name, source, **options):
    """Describe an extension module."""
    return Extension(
        name,
        [source],
        optional=EXTENSIONS == "optional",
        py_limited_api=STABLE,
        define_macros=[("Py_LIMITED_API", "0x030b0000")] if STABLE else [],
        # Much of the work is calls to the interpreter: without detours through jump tables.
        extra_compile_args=["-std=c11", "-O2", "-fno-plt", "-Wall", "-Wextra"],
        **options,
    )


PLACES, NAMES = packages()
BINARY = EXTENSIONS != "none"
setup(
    license="Apache-2.0",
    python_requires=">=3.11",  # in pyproject.toml it would be no plain text, which colcon needs
    long_description=description(),
    long_description_content_type="text/markdown",
    project_urls={
        "Source": REPOSITORY,
        "Changelog": f"{REPOSITORY}/blob/v{VERSION}/CHANGELOG.md",
        "Issues": f"{REPOSITORY}/issues",
    }
    if REPOSITORY
    else {},
    package_dir=PLACES,
    packages=NAMES,
    cmdclass={"sdist": SourceDistribution},
    options={"bdist_wheel": {"py_limited_api": "cp311"}} if STABLE and BINARY else {},
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
                "whiteboard/_reading.h",
                "whiteboard/_recent.h",
                "whiteboard/_dozing.h",
                "whiteboard/_waiting.h",
                "whiteboard/include/llfsm_whiteboard.h",
            ],
        ),
        extension(
            "llfsm.runtime.engine._ringlet",
            "runtime/engine/_ringlet.c",
            depends=[f"runtime/engine/_{name}.h" for name in ("records", "timing", "rotation")],
        ),
        extension("llfsm.runtime.verification._states", "runtime/verification/_states.c"),
    ]
    if BINARY
    else [],
)
