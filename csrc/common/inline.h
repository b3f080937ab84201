// Macros and functions for forced inlining, non-aliasing pointers, bit operations and prefetching, whose syntax depends
// on the compiler.
//
// Dispatched files (common/dispatch.h), which are compiled once for each instruction set, depend on forced inlining. An
// inline function that the compiler does not inline has one copy for each instruction set. The linker keeps only one
// of these copies, which may use instructions that the processor does not have.
#pragma once

#include <cstddef>
#include <cstdint>

#if defined(__GNUC__)
#define FOURD_INLINE inline __attribute__((always_inline))
#define FOURD_INLINE_LAMBDA __attribute__((always_inline))  // Write this macro after the parameters of a lambda.
#define FOURD_RESTRICT __restrict__
#elif defined(_MSC_VER)
#include <intrin.h>
#define FOURD_INLINE __forceinline
#define FOURD_INLINE_LAMBDA
#define FOURD_RESTRICT __restrict
#else
#define FOURD_INLINE inline
#define FOURD_INLINE_LAMBDA
#define FOURD_RESTRICT
#endif

// Write this macro before a loop over the lanes of a vector. Without it, GCC unrolls the loop and then fails to
// vectorise it.
#if defined(__GNUC__) && !defined(__clang__)
#define FOURD_KEEP_LOOP _Pragma("GCC unroll 1")
#else
#define FOURD_KEEP_LOOP
#endif

// Write this macro before a loop of at most 16 iterations over an array that is meant to be kept in registers.
#if defined(__clang__)
#define FOURD_UNROLL _Pragma("unroll")
#elif defined(__GNUC__)
#define FOURD_UNROLL _Pragma("GCC unroll 16")
#else
#define FOURD_UNROLL
#endif

namespace fourd {

// Prefetches the cache line at an address. The address does not need to be valid.
FOURD_INLINE void prefetch(const void* address) {
#if defined(__GNUC__)
    __builtin_prefetch(address);
#else
    static_cast<void>(address);
#endif
}

FOURD_INLINE void prefetch_for_write(const void* address) {
#if defined(__GNUC__)
    __builtin_prefetch(address, 1);
#else
    static_cast<void>(address);
#endif
}

constexpr std::size_t kCacheLine = 64;  // Size in bytes of a cache line, on all common processors.

// Prefetches `bytes` bytes.
FOURD_INLINE void prefetch_bytes(const void* first, std::size_t bytes) {
    for (std::size_t at = 0; at < bytes; at += kCacheLine) prefetch(static_cast<const char*>(first) + at);
}

FOURD_INLINE void prefetch_bytes_for_write(void* first, std::size_t bytes) {
    for (std::size_t at = 0; at < bytes; at += kCacheLine) prefetch_for_write(static_cast<char*>(first) + at);
}

// Returns the number of bits that are 1 in `bits`.
FOURD_INLINE int popcount(std::uint32_t bits) {
#if defined(__GNUC__)
    return __builtin_popcount(bits);
#else
    int count = 0;
    for (; bits != 0; bits &= bits - 1) ++count;
    return count;
#endif
}

// Returns the index of the lowest bit that is 1 in `bits`. At least one bit must be 1.
FOURD_INLINE int lowest_bit(std::uint64_t bits) {
#if defined(__GNUC__)
    return __builtin_ctzll(bits);
#elif defined(_MSC_VER) && defined(_WIN64)
    unsigned long index;
    _BitScanForward64(&index, bits);
    return static_cast<int>(index);
#else
    int index = 0;
    for (; (bits & 1) == 0; bits >>= 1) ++index;
    return index;
#endif
}

}  // namespace fourd
