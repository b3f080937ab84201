#include "common/simd.h"

#include <stdexcept>
#include <string>

namespace fourd {
namespace {

bool runs_avx2() {
#ifdef FOURD_X86
    return __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma") &&
           __builtin_cpu_supports("f16c");
#else
    return false;
#endif
}

bool runs_avx512() {
#ifdef FOURD_X86
    return runs_avx2() && __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512dq") &&
           __builtin_cpu_supports("avx512vl");
#else
    return false;
#endif
}

}  // namespace

bool simd_available(const char* name) {
    const std::string wanted = name;
    return wanted == "baseline" || (wanted == "avx2" && runs_avx2()) || (wanted == "avx512" && runs_avx512());
}

const char* simd_default() { return runs_avx512() ? "avx512" : runs_avx2() ? "avx2" : "baseline"; }

Simd simd_named(const char* name) {
    const std::string wanted = *name ? name : simd_default();
    if (!simd_available(wanted.c_str())) {
        throw std::invalid_argument("FOURD_SIMD: expected baseline, avx2 or avx512, and one that this machine runs, got " +
                                    wanted);
    }
    return wanted == "avx512" ? Simd::avx512 : wanted == "avx2" ? Simd::avx2 : Simd::baseline;
}

}  // namespace fourd
