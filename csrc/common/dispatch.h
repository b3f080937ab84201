// Selects the instruction set of a kernel at run time. All CPU kernels use this selection.
//
// The inner loops of a kernel are in a separate file, cpu/loops.cpp. fourd_kernel(DISPATCH ...) compiles this file once
// for each instruction set, from the baseline up to the argument WIDEST, and defines the macro FOURD_SIMD as the name
// of the set. The header cpu/loops.h declares a struct Loops of function pointers and ends with FOURD_DISPATCH(Loops,
// Simd::WIDEST). cpu/loops.cpp defines the functions and the table `const Loops loops` in the namespace FOURD_SIMD,
// inside the namespace of the kernel.
//
// A dispatched file (a file that is compiled once per instruction set) must not call inline functions with external
// linkage, such as the functions of standard containers, because the linker keeps only one copy of each inline function
// in the program, and that copy may use AVX-512. A dispatched file may call functions that are static, marked
// FOURD_INLINE or in namespace FOURD_SIMD.
#pragma once

#include "common/simd.h"

#if defined(FOURD_X86)
#define FOURD_DISPATCH(TABLE, WIDEST)                       \
    namespace baseline {                                    \
    extern const TABLE loops;                               \
    }                                                       \
    namespace avx2 {                                        \
    extern const TABLE loops;                               \
    }                                                       \
    namespace avx512 {                                      \
    extern const TABLE loops;                               \
    }                                                       \
    inline const TABLE& select_loops(::fourd::Simd simd) {  \
        using ::fourd::Simd;                                \
        if constexpr ((WIDEST) >= Simd::avx512) {           \
            if (simd == Simd::avx512) return avx512::loops; \
        }                                                   \
        if constexpr ((WIDEST) >= Simd::avx2) {             \
            if (simd >= Simd::avx2) return avx2::loops;     \
        }                                                   \
        return baseline::loops;                             \
    }
#else
#define FOURD_DISPATCH(TABLE, WIDEST) \
    namespace baseline {              \
    extern const TABLE loops;         \
    }                                 \
    inline const TABLE& select_loops(::fourd::Simd) { return baseline::loops; }
#endif
