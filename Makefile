# Targets that run Python first create an environment in .venv, for example `make demo` and `make test`.
PYTHON ?= python3
# Warnings are errors with WERROR=ON, for changes of csrc/. Newer compilers report more warnings.
WERROR ?= OFF
# GPU architectures of the CUDA kernels, for example 80, or OFF. Compiling them takes half of the time of a build, so by
# default they are compiled only where an NVIDIA GPU is, and only for this GPU.
CUDA_ARCHITECTURES ?= $(shell nvidia-smi -L >/dev/null 2>&1 && echo native || echo OFF)
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
NATIVE := $(shell find csrc -type f -not -path 'csrc/tests/*' -not -path 'csrc/fuzz/*')

# Modules are compiled at their first import (see PIP below). With this variable, which some containers set, every process
# would compile them again: the tests start hundreds of processes.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: help install install-locked demo test test-slow lint docs clean sanitize sanitize-address sanitize-thread count
.PHONY: fuzz fuzz-readers fuzz-kernels

help:
	@echo "make demo       synthetic capture -> trained 4D scene -> video, in demo/"
	@echo "make test       the test suite"
	@echo "make test-slow  the tests that take longer than a few seconds each"
	@echo "make lint       ruff, mypy and import-linter"
	@echo "make docs       the documentation as a site, in build/site/"
	@echo "make sanitize   the C++ kernels under ASan, UBSan and TSan"
	@echo "make fuzz       the readers of files, and the kernels if Clang exists, with coverage feedback, for SECONDS=60 each"
	@echo "make count      the C++ kernels' instructions against those accepted before"
	@echo "make install-locked  install packages with the hashes in requirements.lock; then use the targets above"
	@echo "make clean      remove the environment and everything built"

# A kernel build without its own environment, so that it uses the pinned versions of the build tools.
ifeq ($(CUDA_ARCHITECTURES),OFF)
CUDA_OPTION := cmake.define.FOURD_CUDA=OFF
else
CUDA_OPTION := cmake.define.CMAKE_CUDA_ARCHITECTURES=$(CUDA_ARCHITECTURES)
endif
BUILD := --no-build-isolation --config-settings cmake.define.FOURD_WERROR=$(WERROR) --config-settings $(CUDA_OPTION)
# Python compiles modules at their first import. Compiling all of them in advance takes longer.
PIP := $(BIN)/python -m pip --disable-pip-version-check install --quiet --no-compile

$(STAMP): pyproject.toml constraints.txt $(NATIVE)
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(PIP) -c constraints.txt pip torch scikit-build-core nanobind cmake ninja
	$(PIP) -c constraints.txt $(BUILD) -e '.[train,viewer,splats,cluster,storage,onnx,notebook]' --group dev --group docs
	touch $@

install: $(STAMP)

# Install only files with the hashes of requirements.lock. torch has no hash here, because its builds for CPU and CUDA are
# different files of the same version.
install-locked:
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(PIP) --require-hashes --no-deps --only-binary :all: -r requirements.lock
	$(PIP) -c constraints.txt torch
	$(PIP) --no-deps $(BUILD) -e .
	$(BIN)/pip check
	touch $(STAMP)

demo: install
	$(BIN)/python tools/demo.py

# Tests run in WORKERS processes, of which each uses one thread. All tests of a file run in the same process, because they
# share fixtures. There is one process more than cores, because some tests wait for browsers, windows and servers.
WORKERS ?= $(shell $(PYTHON) -c "import os; print(min(4, os.cpu_count() or 1) + 1)")
test: install
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest -m "not slow" -n $(WORKERS) --dist loadfile --no-loadscope-reorder --max-worker-restart 0

test-slow: install
	$(BIN)/python -m pytest -m slow

lint: install
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports --no-logo

docs: install
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --strict --quiet

clean:
	rm -rf $(VENV) build demo .mypy_cache .pytest_cache .ruff_cache .import_linter_cache

# Run the kernels on invalid inputs: under ASan and UBSan, including the emulated CUDA kernels, and under TSan.
sanitize: sanitize-address sanitize-thread

sanitize-address: install
	$(BIN)/cmake -S csrc/tests -B build/asan -DFOURD_SANITIZE=address,undefined -G "Unix Makefiles" -DCMAKE_BUILD_TYPE=Debug -DFOURD_WERROR=ON >/dev/null
	$(BIN)/cmake --build build/asan
	build/asan/hostile 300
	build/asan/hostile_gpu 100

sanitize-thread: install
	$(BIN)/cmake -S csrc/tests -B build/tsan -DFOURD_SANITIZE=thread -G "Unix Makefiles" -DCMAKE_BUILD_TYPE=Debug -DFOURD_WERROR=ON >/dev/null
	$(BIN)/cmake --build build/tsan
	build/tsan/hostile 60

# Fuzz for SECONDS each. The corpora, which grow, and the inputs that fail are in build/fuzz/.
SECONDS ?= 60
fuzz: fuzz-readers install
	$(BIN)/python tools/security/fuzz_kernels.py --seconds $(SECONDS) --optional

fuzz-readers: install
	$(PIP) -c constraints.txt atheris
	$(BIN)/python -m tests.hostile.fuzz --seconds $(SECONDS)

fuzz-kernels: install
	$(BIN)/python tools/security/fuzz_kernels.py --seconds $(SECONDS)

count: install
	PATH=$(abspath $(BIN)):$$PATH $(BIN)/python tools/count_instructions.py
