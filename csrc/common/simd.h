// Instruction sets. Each kernel selects its instruction set at run time (common/dispatch.h).
#pragma once

namespace fourd {

// The instruction sets in ascending order. avx2 includes FMA and F16C. avx512 stands for AVX-512 F, DQ and VL.
enum class Simd { baseline, avx2, avx512 };

// Returns true if this machine supports the instruction set with the given name.
bool simd_available(const char* name);

// Returns the name of the widest instruction set that this machine supports.
const char* simd_default();

// Returns the instruction set with the given name, or the widest one if the name is empty. Throws std::invalid_argument
// if this machine does not support the instruction set.
Simd simd_named(const char* name);

}  // namespace fourd
