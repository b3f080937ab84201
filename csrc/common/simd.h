// Instruction sets. The one that a kernel runs is selected at run time (common/dispatch.h).
#pragma once

namespace fourd {

// avx2 includes FMA and F16C; avx512 is F, DQ and VL. In ascending order.
enum class Simd { baseline, avx2, avx512 };

// Whether this machine runs the instruction set of that name.
bool simd_available(const char* name);

// The name of the widest one that this machine runs.
const char* simd_default();

// By name; "" selects the widest. Throws std::invalid_argument if this machine does not run it.
Simd simd_named(const char* name);

}  // namespace fourd
