#include "common/simd.h"

#include <cstdint>
#include <stdexcept>
#include <string>

#if defined(FOURD_X86)
#if defined(_MSC_VER) && !defined(__clang__)
#include <intrin.h>
#else
#include <cpuid.h>
#endif
#endif

namespace fourd {
namespace {

#if defined(FOURD_X86)

struct Registers {
    std::uint32_t eax, ebx, ecx, edx;
};

// Returns the registers of a CPUID leaf, or zeros if the processor does not have this leaf.
Registers cpuid(std::uint32_t leaf) {
#if defined(_MSC_VER) && !defined(__clang__)
    int out[4] = {}, highest[4] = {};
    __cpuid(highest, 0);
    if (leaf <= static_cast<std::uint32_t>(highest[0])) __cpuidex(out, static_cast<int>(leaf), 0);
    return {static_cast<std::uint32_t>(out[0]), static_cast<std::uint32_t>(out[1]), static_cast<std::uint32_t>(out[2]),
            static_cast<std::uint32_t>(out[3])};
#else
    Registers out{};
    if (!__get_cpuid_count(leaf, 0, &out.eax, &out.ebx, &out.ecx, &out.edx)) return {};
    return out;
#endif
}

// Returns the mask of the vector registers that the operating system saves (XCR0). This function requires a processor
// with XSAVE.
std::uint32_t saved_registers() {
#if defined(_MSC_VER) && !defined(__clang__)
    return static_cast<std::uint32_t>(_xgetbv(0));
#else
    std::uint32_t low, high;
    __asm__ volatile("xgetbv" : "=a"(low), "=d"(high) : "c"(0));
    return low;
#endif
}

bool has_bits(std::uint32_t value, std::uint32_t bits) { return (value & bits) == bits; }

Simd detect() {
    constexpr std::uint32_t kFma = 1u << 12, kOsxsave = 1u << 27, kAvx = 1u << 28, kF16c = 1u << 29;  // CPUID leaf 1, ECX.
    constexpr std::uint32_t kAvx2 = 1u << 5, kAvx512 = 1u << 16 | 1u << 17 | 1u << 31;                // CPUID leaf 7, EBX.
    constexpr std::uint32_t kYmm = 0x6, kZmm = 0xe6;                                                  // Bits of XCR0.
    if (!has_bits(cpuid(1).ecx, kFma | kOsxsave | kAvx | kF16c)) return Simd::baseline;
    const std::uint32_t features = cpuid(7).ebx, saved = saved_registers();
    if (!has_bits(features, kAvx2) || !has_bits(saved, kYmm)) return Simd::baseline;
    return has_bits(features, kAvx512) && has_bits(saved, kZmm) ? Simd::avx512 : Simd::avx2;
}

#else

Simd detect() { return Simd::baseline; }

#endif

// The processor is asked only once: in a virtual machine, every CPUID instruction stops the machine, and the questions
// of one kernel call take 50 microseconds.
Simd widest() {
    static const Simd found = detect();
    return found;
}

constexpr const char* kNames[] = {"baseline", "avx2", "avx512"};

}  // namespace

bool simd_available(const char* name) {
    for (int simd = 0; simd <= static_cast<int>(widest()); ++simd) {
        if (std::string(name) == kNames[simd]) return true;
    }
    return false;
}

const char* simd_default() { return kNames[static_cast<int>(widest())]; }

Simd simd_named(const char* name) {
    const std::string wanted = *name ? name : simd_default();
    if (!simd_available(wanted.c_str())) {
        throw std::invalid_argument(
            "FOURD_SIMD: expected baseline, avx2 or avx512, and one that this machine runs, got " + wanted);
    }
    return wanted == "avx512" ? Simd::avx512 : wanted == "avx2" ? Simd::avx2 : Simd::baseline;
}

}  // namespace fourd
