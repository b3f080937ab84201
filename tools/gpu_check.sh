#!/usr/bin/env bash
# Build fourd for this machine's NVIDIA GPU, run every parity and gradient test on the GPU, and print the benchmark
# table. The script needs no network. It needs CUDA's nvcc, and Python 3.11+ with torch, numpy, opencv, pyyaml, rich,
# safetensors, cachetools, zstandard, msgspec, trimesh, scipy, pytest, scikit-build-core, nanobind, cmake and ninja.
# Environment variables: PYTHON is the interpreter (default: python3), and ARCHITECTURES are the GPU architectures
# (default: this GPU's). Set WHEEL to a wheel of fourd with CUDA kernels for this Python and GPU to install it instead of
# a new build.
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
# Building for this GPU's architecture takes a third of the time of building for all architectures.
SKBUILD_CMAKE_ARGS="-DCMAKE_CUDA_ARCHITECTURES=${ARCHITECTURES:-native};-DFOURD_CUDA=ON;-DFOURD_EMULATION=OFF" \
  SKBUILD_BUILD_DIR=build/gpu/cmake \
  "$python" -m pip install --quiet --no-index --no-deps --no-build-isolation --no-compile --target "$site" "${WHEEL:-.}"

# Copy the tests next to the installed package, so that they do not import the source tree.
cp -r tests pyproject.toml "$site"
export PYTHONPATH=$site${PYTHONPATH:+:$PYTHONPATH}
cd "$site"
"$python" - <<'PYTHON'
import os, sys
import fourd
from fourd.rendering.ops.gpu import has_gpu

if not fourd.__file__.startswith(os.getcwd()):
    sys.exit(f"gpu_check: expected the package just built, got {fourd.__file__}; use a Python without an editable fourd")
if not has_gpu():
    sys.exit("gpu_check: expected a CUDA device and kernels built for it, got none")
PYTHON
tests=(-q -k "cuda and not emulated" tests/ops tests/raster tests/lenses tests/baking/test_gpu_player.py
  tests/training/test_device.py)
if [ "${1:-}" = sanitize ]; then
  # To let compute-sanitizer check each allocation separately, torch's memory pool is switched off.
  PYTORCH_NO_CUDA_MEMORY_CACHING=1 compute-sanitizer --tool memcheck --error-exitcode 1 "$python" -m pytest "${tests[@]}"
  exit
fi
# The table is printed even if a test fails. The script's exit status reports the failure.
failed=0
"$python" -m pytest "${tests[@]}" || failed=1
speed=$OLDPWD/tools/measurements/speed
"$python" "$speed/gpu_table.py"
# Test and measure the viewer's OpenGL renderers through EGL on the same GPU, if their Python packages are installed.
if "$python" -c "import moderngl, tyro, OpenGL, scipy" 2>/dev/null; then
  "$python" -m pytest -q tests/viewer/rendering/test_renderers.py || failed=1
  for size in "1920 1080" "3840 2160"; do
    # The source tree, which has tools/, comes after the package just built.
    PYTHONPATH=$PYTHONPATH:$OLDPWD "$python" "$speed/viewer_table.py" --size $size --seconds 1
  done
else
  echo "gpu_check: OpenGL is neither tested nor timed; it needs moderngl, tyro, PyOpenGL and scipy"
fi
exit $failed
