# Every target sets up what it needs, in .venv and nowhere else.
VENV := .venv
BIN := $(VENV)/bin
SOURCES := pyproject.toml setup.py setup.cfg \
    $(wildcard whiteboard/*.c whiteboard/*.h whiteboard/include/*.h runtime/engine/*.c runtime/engine/*.h)
SANITIZED := $(abspath $(VENV))/sanitized
SANITIZE_SECONDS ?= 20
ADDRESS := -fsanitize=address,undefined -fno-sanitize-recover=all
UNDER_ASAN = ASAN_OPTIONS=detect_leaks=0 PYTHONMALLOC=malloc LLFSM_STRESS=2 \
    PYTHONPATH=$(SANITIZED)/site LD_PRELOAD="$$($(CC) -print-file-name=libasan.so)"
STRESS_FLAGS := -std=c11 -O1 -g -Wall -Wextra -Werror -I whiteboard/include -pthread
THREAD := -fsanitize=thread -Wno-tsan # which does not know fences; the header argues them

# Containers often ask Python to keep no compiled modules. Then every process that starts compiles all
# of llfsm that it imports, which is half of what the tests cost.
unexport PYTHONDONTWRITEBYTECODE

# Where a ROS 2 environment is sourced, PYTHONPATH leads to its packages, but not to what they need of
# the system's. So the venv sees that, too, and is of the same Python.
ifneq ($(AMENT_PREFIX_PATH),)
PYTHON ?= /usr/bin/python3
export PYTHON
VENV_MADE := $(VENV)/.sees-system
else
VENV_MADE := $(VENV)/pyvenv.cfg
endif

.DELETE_ON_ERROR:
.PHONY: help setup demo rover fleet test test-aarch64 fallback fallback-all slowest mutants check safety bench soak sanitize sanitized fuzz wheel docs docs-serve docs-check pictures screenshots codemirror lock clean

help:
	@echo "make demo      watch a turtle keep away from the walls (20 s)"
	@echo "make rover     let a rover with range sensors and a camera find a beacon between walls"
	@echo "make fleet     let ten turtles, driven on two hosts, form a circle on a third"
	@echo "make test      run the tests"
	@echo "make fallback  run those of machines without the extensions in C"
	@echo "make fallback-all  run all of them so; what needs shared memory is skipped"
	@echo "make slowest   run the tests and list the hundred that cost most, and the costliest files"
	@echo "make mutants   break each promise of the documents, the protocol of the boards, and 300 functions,"
	@echo "               each at one place, and look whether a test finds it: hours;"
	@echo "               AGAINST=out/before.json: the mutants of an earlier run, and what is missed now"
	@echo "make test-aarch64  test the whiteboard and the order of turns on aarch64, under qemu"
	@echo "make setup     install llfsm into .venv; then: .venv/bin/llfsm --help"
	@echo "make check     types, style, C warnings"
	@echo "make safety    measure how soon the robot stops, whatever happens (13 min)"
	@echo "make bench     measure us and the peers in one run"
	@echo "make soak      the whiteboard while writers are killed, the bridge for ten minutes while its"
	@echo "               processes are, ten topics at 1 kHz, three hosts, a fleet of 32, a hostile host, killed"
	@echo "               machines, a hundred thousand of all that comes and goes, states beside SPIN: an hour"
	@echo "make fuzz      a board that is changed while it is used, for 60 minutes (3 times MINUTES=...);"
	@echo "               damaged boards, messages, recordings and files, for 20 minutes;"
	@echo "               then all tests of hypothesis with twenty times as many examples"
	@echo "make sanitize  the C core under TSan, ASan and UBSan"
	@echo "make wheel     build the wheels and test ours on each Python of this machine"
	@echo "make docs      build the documentation as a site in out/site"
	@echo "make docs-serve  show it, and each change of it, at http://127.0.0.1:8000"
	@echo "make docs-check  look at each of its pages in Chromium: links, widths, contrast, search"
	@echo "make pictures  draw those in docs/pictures"
	@echo "make screenshots  of the pages, for docs/"
	@echo "make codemirror  bundle the editor of texts that the editor's page uses"
	@echo "make lock      lock the newest versions of all dependencies that pyproject.toml allows"
	@echo "make clean     remove .venv and what was built"

setup: $(VENV)/.ready-setup
	@echo "ready: $(BIN)/llfsm --help"

demo: $(VENV)/.ready-setup
	@$(BIN)/llfsm demo wall --seconds 20 --picture out/wall --view

rover: $(VENV)/.ready-setup
	@mkdir -p out
	@$(BIN)/python examples/rover/drive.py out/rover.svg

fleet: $(VENV)/.ready-setup
	@mkdir -p out
	@$(BIN)/python examples/fleet/start.py out/fleet.svg

# Without other plugins: a sourced ROS 2 environment brings some of its own. More than two workers a
# processor (see tests/workers.py), as tests wait half their time; each takes whole files, so that
# what a file's tests share is made once.
PYTEST := PYTEST_DISABLE_PLUGIN_AUTOLOAD=1 $(BIN)/python -m pytest -p _hypothesis_pytestplugin \
    -p pytest_timeout
TEST := LLFSM_WORKERS=$$((2 * $$(getconf _NPROCESSORS_ONLN) + 3)) $(PYTEST)
test: $(VENV)/.ready-test
	$(TEST)

slowest: $(VENV)/.ready-test
	@mkdir -p out
	LLFSM_COSTS=out/costs.json $(TEST) -q

# What was judged before is not judged again: remove out/mutants.json to begin anew.
AGAINST ?=
mutants: $(VENV)/.ready-test
	$(BIN)/python .ci/promises.py
	$(BIN)/python tests/stress/mutants.py
	$(BIN)/python .ci/mutants.py $(if $(AGAINST),--against $(AGAINST))

# On Debian, with its packages qemu-user-static and gcc-aarch64-linux-gnu. The emulated
# tests are many times slower: on two cores, they took some five minutes.
test-aarch64: $(VENV)/.ready-test
	$(BIN)/python .ci/aarch64.py

# What runs machines, or all, once more, as where there is no compiler: the extensions are hidden, and
# what needs shared memory is skipped.
HIDING = PYTHONPATH=$(abspath tests/without_extensions)$${PYTHONPATH:+:$$PYTHONPATH}
fallback-all: $(VENV)/.ready-test
	$(HIDING) $(TEST)
fallback: $(VENV)/.ready-test
	$(HIDING) $(TEST) \
	    tests/conformance tests/machines tests/runtime/bundles tests/runtime/engine \
	    tests/runtime/journal tests/runtime/presence tests/runtime/testing

check: $(VENV)/.ready-test
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy -p llfsm
	$(BIN)/python -m mypy.stubtest llfsm.whiteboard._shm llfsm.runtime.engine._ringlet \
	    llfsm.runtime.verification._states
	$(CC) -std=c11 -O2 -Wall -Wextra -Werror -fsyntax-only -x c \
	    whiteboard/include/llfsm_whiteboard.h
	$(CXX) -std=c++17 -O2 -Wall -Wextra -Wpedantic -Werror -fsyntax-only -x c++ \
	    whiteboard/include/llfsm_whiteboard.h

# The header under many threads, then the extensions under the tests of each: without the leak
# checker, which does not know what the interpreter leaves on purpose, and without the test of memory.
sanitize: sanitized
	$(CC) $(STRESS_FLAGS) $(THREAD) tests/stress/stress.c -o $(SANITIZED)/thread
	$(SANITIZED)/thread $(SANITIZE_SECONDS)
	$(CC) $(STRESS_FLAGS) $(ADDRESS) tests/stress/stress.c -o $(SANITIZED)/address
	$(SANITIZED)/address $(SANITIZE_SECONDS)
	$(CC) $(STRESS_FLAGS) $(THREAD) tests/stress/names.c -o $(SANITIZED)/thread
	$(SANITIZED)/thread threads $(SANITIZE_SECONDS)
	$(CC) $(STRESS_FLAGS) $(ADDRESS) tests/stress/names.c -o $(SANITIZED)/address
	$(SANITIZED)/address processes $(SANITIZE_SECONDS)
	$(CC) $(STRESS_FLAGS) $(ADDRESS) tests/stress/hostile.c -o $(SANITIZED)/address
	ASAN_OPTIONS=detect_leaks=0 $(SANITIZED)/address $(SANITIZE_SECONDS)
	$(UNDER_ASAN) $(BIN)/python -m pytest -p no:cacheprovider tests/whiteboard tests/stress \
	    --ignore tests/whiteboard/mirror \
	    --deselect tests/whiteboard/test_shared.py::test_a_process_that_uses_a_hundred_slots_is_small
	$(UNDER_ASAN) $(BIN)/python -m pytest -p no:cacheprovider tests/conformance \
	    $(addprefix tests/runtime/engine/test_,clock.py twin.py resting.py failures.py loading.py watchdog.py) \
	    tests/runtime/verification/test_packed_states.py

# Alone: the same tests are part of `make test`, where times depend on what else runs.
safety: $(VENV)/.ready-test
	LLFSM_TIMES=check $(PYTEST) -q -s tests/bridges/ros2/stopping \
	    tests/whiteboard/mirror/test_partition.py
	PYTHONPATH=tests $(BIN)/python tests/soak/faults.py

# llfsm with its extensions under ASan.
sanitized: $(VENV)/.ready-test
	@rm -rf $(SANITIZED) build && mkdir -p $(SANITIZED)
	CFLAGS="-g -O1 $(ADDRESS)" $(BIN)/python -m pip install --quiet --no-deps \
	    --no-build-isolation --disable-pip-version-check --target $(SANITIZED)/site .
	$(UNDER_ASAN) $(BIN)/python -c \
	    "from llfsm.runtime.engine import _ringlet; from llfsm.runtime.verification import _states; \
	    from llfsm.whiteboard import _shm; \
	    assert all('$(SANITIZED)' in each.__file__ for each in (_ringlet, _states, _shm))"

MINUTES ?= 20
fuzz: sanitized
	$(CC) $(STRESS_FLAGS) $(ADDRESS) tests/stress/hostile.c -o $(SANITIZED)/address
	ASAN_OPTIONS=detect_leaks=0 $(SANITIZED)/address $$(($(MINUTES) * 90))
	$(UNDER_ASAN) PYTHONPATH=$(SANITIZED)/site:tests \
	    $(BIN)/python tests/fuzz/changed.py $(SANITIZED)/address $$(($(MINUTES) * 90))
	$(UNDER_ASAN) PYTHONPATH=$(SANITIZED)/site:tests $(BIN)/python tests/fuzz/run.py --minutes $(MINUTES)
	LLFSM_EXAMPLES=20 $(TEST) -m hypothesis --timeout 3600

bench: $(VENV)/.ready-bench
	@mkdir -p out
	$(BIN)/python tests/bench/run.py --json out/bench.json

SOAK_SECONDS ?= 600
soak: $(VENV)/.ready-test
	LLFSM_STRESS=80 $(PYTEST) -s tests/stress/test_stress.py
	LLFSM_SOAK=1 $(TEST) -m soak
	LLFSM_WAITING_WORLDS=200000 $(PYTEST) --timeout 36000 tests/runtime/engine/test_waiting_worlds.py
	PYTHONPATH=tests $(BIN)/python tests/soak/turtle.py --seconds $(SOAK_SECONDS)
	PYTHONPATH=tests $(BIN)/python tests/soak/relays.py
	PYTHONPATH=tests $(BIN)/python tests/soak/hosts.py
	$(BIN)/python tests/bench/fleet.py
	PYTHONPATH=tests $(BIN)/python tests/soak/hostile.py
	$(BIN)/python tests/soak/floods.py
	PYTHONPATH=tests $(BIN)/python tests/soak/lives.py
	PYTHONPATH=tests $(BIN)/python tests/soak/guard.py
	PYTHONPATH=tests $(BIN)/python tests/soak/states.py
	PYTHONPATH=tests:tests/fuzz $(BIN)/python tests/soak/flat.py

# What each kind of work needs: a stamp says that it is installed, and a lock file exactly what that is.
# Beside ROS 2, what is installed with it counts, in the versions that it has.
EXTRAS_setup := draw,ros,hosts,record,view,examples
EXTRAS_test := test,$(EXTRAS_setup)
EXTRAS_bench := bench,$(EXTRAS_setup)
EXTRAS_release := release
EXTRAS_docs := docs
INSTALL := $(BIN)/python -m pip install --quiet --disable-pip-version-check

$(VENV)/.ready-%: .ci/locks/%.txt $(SOURCES) $(VENV_MADE)
	@sh .ci/prerequisites >/dev/null
	@echo "installing llfsm[$(EXTRAS_$*)] into $(VENV) ..."
	@find runtime whiteboard -name '*.so' -delete # one by another name could be found first
ifneq ($(AMENT_PREFIX_PATH),)
	@$(INSTALL) -e '.[$(EXTRAS_$*)]'
else
	@$(INSTALL) --require-hashes -r $<
	@$(INSTALL) --no-deps --no-build-isolation -e .
endif
	@$(BIN)/python -c 'import llfsm.whiteboard._shm, llfsm.runtime.engine._ringlet, \
	    llfsm.runtime.verification._states' || \
	    { echo "the extensions in C were not built; see: $(BIN)/pip install -v -e ." >&2; exit 1; }
	@touch $@

wheel: $(VENV)/.ready-release $(VENV)/.ready-test
	$(BIN)/python .ci/wheel.py

# Strict: a link that leads nowhere is an error. Nothing is fetched.
docs: $(VENV)/.ready-docs
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --quiet
docs-serve: $(VENV)/.ready-docs
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs serve

docs-check: docs $(VENV)/.ready-test
	$(BIN)/python .ci/browse.py

pictures: $(VENV)/.ready-test
	$(BIN)/python .ci/pictures.py

# With Chromium, which must be installed.
screenshots: $(VENV)/.ready-test
	$(BIN)/python .ci/screenshots.py

# The only script of others: needs npm, and fetches what the lock file names.
codemirror:
	rm -rf build/codemirror && mkdir -p build && cp -r .ci/codemirror build/codemirror
	cd build/codemirror && npm ci --silent && npx esbuild entry.js --bundle --format=esm --minify \
	    --legal-comments=none --banner:js="$$(cat licence.js)" --outfile=$(abspath bridges/edit/codemirror/codemirror.js)

lock: $(VENV)/.ready-release
	$(BIN)/python .ci/lock.py setup=$(EXTRAS_setup) test=$(EXTRAS_test) bench=$(EXTRAS_bench) \
	    release=$(EXTRAS_release) docs=$(EXTRAS_docs)

$(VENV)/pyvenv.cfg:
	@python=$$(sh .ci/prerequisites) && $$python -m venv $(VENV)

$(VENV)/.sees-system:
	@python=$$(sh .ci/prerequisites) && $$python -m venv --clear --system-site-packages $(VENV)
	@touch $@

clean:
	rm -rf $(VENV) build out src/llfsm.egg-info
	find runtime whiteboard -name '*.so' -delete
