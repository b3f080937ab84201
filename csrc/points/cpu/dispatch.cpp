#include <cstring>
#include <stdexcept>
#include <string>

#include "points/cpu/tiles.h"

namespace fourd::points {
namespace {

bool runs_avx2() {
#ifdef FOURD_X86
    return __builtin_cpu_supports("avx2");
#else
    return false;
#endif
}

bool runs_avx512() {
#ifdef FOURD_X86
    return __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512dq") &&
           __builtin_cpu_supports("avx512vl");
#else
    return false;
#endif
}

}  // namespace

const char* simd_default() { return runs_avx512() ? "avx512" : runs_avx2() ? "avx2" : "baseline"; }

bool simd_available(const char* name) {
    if (std::strcmp(name, "avx512") == 0) return runs_avx512();
    if (std::strcmp(name, "avx2") == 0) return runs_avx2();
    return std::strcmp(name, "baseline") == 0;
}

const TileKernels& tile_kernels(const char* simd) {
    const std::string name = *simd ? simd : simd_default();
    if (!simd_available(name.c_str())) {
        throw std::invalid_argument("FOURD_SIMD: expected baseline, avx2 or avx512, and one that this machine runs, got " + name);
    }
#ifdef FOURD_X86
    if (name == "avx512") return tile_kernels_avx512;
    if (name == "avx2") return tile_kernels_avx2;
#endif
    return tile_kernels_baseline;
}

}  // namespace fourd::points
