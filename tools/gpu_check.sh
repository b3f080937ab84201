#!/usr/bin/env bash
# On a machine with an NVIDIA GPU: builds for it, runs every parity and gradient test on it, and prints the benchmark
# table. Needs no network: the machine has Python 3.11+ with torch, numpy, opencv, pyyaml, rich, safetensors, pytest,
# scikit-build-core, nanobind, cmake and ninja, and CUDA's nvcc. PYTHON names another interpreter than python3,
# ARCHITECTURES others than that of the GPU.
#
#   tools/gpu_check.sh              tests and table
#   tools/gpu_check.sh sanitize     the tests under compute-sanitizer
set -euo pipefail
cd "$(dirname "$0")/.."
python=${PYTHON:-python3}
site=$PWD/build/gpu/site

nvidia-smi --query-gpu=name,driver_version,memory.total --format=csv,noheader
nvcc --version | grep release
rm -rf "$site"
mkdir -p "$site"
# For the architecture that is here alone, which takes a third of the time.
SKBUILD_CMAKE_ARGS="-DCMAKE_CUDA_ARCHITECTURES=${ARCHITECTURES:-native};-DFOURD_CUDA=ON" SKBUILD_BUILD_DIR=build/gpu/cmake \
  "$python" -m pip install --quiet --no-index --no-deps --no-build-isolation --no-compile --target "$site" .

# The tests and their settings beside what was installed, so that they cannot find the source folder's package.
cp -r tests pyproject.toml "$site"
export PYTHONPATH=$site${PYTHONPATH:+:$PYTHONPATH}
cd "$site"
"$python" - <<'PYTHON'
import os, sys
import fourd
from fourd.benchmarks.machine import has_gpu

if not fourd.__file__.startswith(os.getcwd()):
    sys.exit(f"gpu_check: expected the package just built, got {fourd.__file__}; use a Python without an editable fourd")
if not has_gpu():
    sys.exit("gpu_check: expected a CUDA device and its kernels, found none")
PYTHON
tests=(tests/ops/test_points_cuda.py tests/ops/test_planes.py tests/ops/test_sources.py
  tests/ops/test_hashgrid.py tests/baking/test_gpu_player.py)
if [ "${1:-}" = sanitize ]; then
  # One process under the tool at a time: torch's own allocations are pooled, so that only ours are judged by place.
  PYTORCH_NO_CUDA_MEMORY_CACHING=1 compute-sanitizer --tool memcheck --error-exitcode 1 \
    "$python" -m pytest -q -k "cuda" "${tests[@]}"
  exit
fi
"$python" -m pytest -q -k "cuda" "${tests[@]}"
"$python" "$OLDPWD/tools/gpu_table.py"
# OpenGL by EGL on the same card, where Python has what it takes.
if "$python" -c "import moderngl, tyro, OpenGL, scipy" 2>/dev/null; then
  "$python" -m pytest -q tests/viewer/rendering/test_renderers.py
  for size in "1920 1080" "3840 2160"; do "$python" "$OLDPWD/tools/viewer_table.py" --size $size; done
else
  echo "gpu_check: without moderngl, tyro, PyOpenGL and scipy, OpenGL is neither tested nor timed"
fi
