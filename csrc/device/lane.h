// The GPU operations that kernels may use besides plain arithmetic: warp votes, warp sums and atomics. A kernel is a
// function object that is called once per index. The same source code of a kernel runs on a GPU (device/cuda.h) and,
// for tests, on the CPU (device/emulated.h).
#pragma once

#include <cstdint>

#include "common/host_device.h"

namespace fourd::device {

constexpr int kWarpSize = 32;  // Number of threads that run in lockstep.

#ifdef __CUDACC__

// One thread of a warp. All threads of a warp must call the same functions of Lane in the same order, so they must
// leave a loop that contains such calls at the same iteration.
class Lane {
  public:
    FOURD_DEVICE bool any(bool value) const { return __any_sync(kAll, value) != 0; }

    FOURD_DEVICE bool is_first() const { return threadIdx.x % kWarpSize == 0; }

    // Adds the values of all threads of the warp, and returns the sum to every thread.
    FOURD_DEVICE float sum(float value) const {
        for (int step = kWarpSize / 2; step > 0; step /= 2) value += __shfl_xor_sync(kAll, value, step);
        return value;
    }

    FOURD_DEVICE std::uint32_t max(std::uint32_t value) const {
        for (int step = kWarpSize / 2; step > 0; step /= 2) {
            const std::uint32_t other = __shfl_xor_sync(kAll, value, step);
            value = other > value ? other : value;
        }
        return value;
    }

  private:
    static constexpr unsigned kAll = 0xffffffffu;
};

#else

// The lanes of an emulated warp synchronise at every call of a Lane function (emulated.h).
class Warp;

class Lane {
  public:
    Lane(Warp& warp, int number) : warp_(warp), number_(number) {}

    bool any(bool value) const;
    bool is_first() const { return number_ == 0; }
    float sum(float value) const;
    std::uint32_t max(std::uint32_t value) const;

  private:
    Warp& warp_;
    int number_;
};

#endif

// Atomic operations. The order of atomic additions is not fixed, so the last bits of float sums can differ between
// program runs.
FOURD_DEVICE static inline void atomic_add(float* target, float value) {
#ifdef __CUDA_ARCH__
    atomicAdd(target, value);
#else
    *target += value;
#endif
}

// Adds 1 atomically, and returns the previous value.
FOURD_DEVICE static inline std::uint32_t atomic_increment(std::uint32_t* target) {
#ifdef __CUDA_ARCH__
    return atomicAdd(target, 1u);
#else
    return (*target)++;
#endif
}

FOURD_DEVICE static inline void atomic_min(std::uint64_t* target, std::uint64_t value) {
#ifdef __CUDA_ARCH__
    atomicMin(reinterpret_cast<unsigned long long*>(target), static_cast<unsigned long long>(value));
#else
    *target = value < *target ? value : *target;
#endif
}

// Replaces `*target` by the larger of `*target` and `value`. The sign bit of both must be 0, because only the bits of
// such floats, read as unsigned integers, have the same order as the floats.
FOURD_DEVICE static inline void atomic_max(float* target, float value) {
#ifdef __CUDA_ARCH__
    atomicMax(reinterpret_cast<unsigned*>(target), __float_as_uint(value));
#else
    *target = value > *target ? value : *target;
#endif
}

}  // namespace fourd::device
