// Instruction sets that kernels have copies for; which one runs is decided when the program runs.
#pragma once

namespace fourd {

enum class Simd { baseline, avx2, avx512 };  // avx512: F, DQ and VL; avx2: with FMA and F16C

// Whether this machine runs the instruction set of that name.
bool simd_available(const char* name);

// The name of the widest that this machine runs.
const char* simd_default();

// By name, or the widest for "". Throws std::invalid_argument if this machine does not run it.
Simd simd_named(const char* name);

}  // namespace fourd
