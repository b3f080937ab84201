// Instruction sets. Each kernel selects its instruction set at run time (common/dispatch.h).
#pragma once

namespace fourd {

// The instruction sets in ascending order. avx2 includes FMA and F16C. avx512 stands for AVX-512 F, DQ and VL.
enum class Simd { baseline, avx2, avx512 };

// Returns whether this machine supports the instruction set with the given name.
bool simd_available(const char* name);

// The name of the widest instruction set that this machine supports.
const char* simd_default();

// The instruction set with the given name. An empty name selects the widest instruction set. Throws
// std::invalid_argument if this machine does not support the instruction set.
Simd simd_named(const char* name);

}  // namespace fourd
