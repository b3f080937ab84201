// What kernels written for a GPU may do beside plain arithmetic: vote and add up within a warp, and add to
// memory that other threads add to. A kernel is a function object, called once for each index; the same source
// runs on a GPU (device/cuda.h) and, to be tested, on the CPU (device/emulated.h).
#pragma once

#include <cstdint>

#include "common/host_device.h"

namespace fourd::device {

constexpr int kWarp = 32;  // threads that run in step

#ifdef __CUDACC__

// One thread of a warp. Every thread of it must make the same calls: none may return, or leave a loop, alone.
class Lane {
  public:
    FOURD_DEVICE bool any(bool value) const { return __any_sync(kAll, value) != 0; }

    FOURD_DEVICE bool first() const { return threadIdx.x % kWarp == 0; }

    // The warp's sum, in every thread.
    FOURD_DEVICE float sum(float value) const {
        for (int step = kWarp / 2; step > 0; step /= 2) value += __shfl_xor_sync(kAll, value, step);
        return value;
    }

    FOURD_DEVICE std::uint32_t largest(std::uint32_t value) const {
        for (int step = kWarp / 2; step > 0; step /= 2) {
            const std::uint32_t other = __shfl_xor_sync(kAll, value, step);
            value = other > value ? other : value;
        }
        return value;
    }

  private:
    static constexpr unsigned kAll = 0xffffffffu;
};

#else

// The threads of an emulated warp meet at every call; emulated.h says how.
class Warp;

class Lane {
  public:
    Lane(Warp& warp, int number) : warp_(warp), number_(number) {}

    bool any(bool value) const;
    bool first() const { return number_ == 0; }
    float sum(float value) const;
    std::uint32_t largest(std::uint32_t value) const;

  private:
    Warp& warp_;
    int number_;
};

#endif

// What many threads add to or raise. The order is not set, so that sums of floats differ in their last bits.
FOURD_DEVICE static inline void add_shared(float* target, float value) {
#ifdef __CUDA_ARCH__
    atomicAdd(target, value);
#else
    *target += value;
#endif
}

// target and value are not negative, so that their bits order as they do.
FOURD_DEVICE static inline void raise_shared(float* target, float value) {
#ifdef __CUDA_ARCH__
    atomicMax(reinterpret_cast<unsigned*>(target), __float_as_uint(value));
#else
    *target = value > *target ? value : *target;
#endif
}

}  // namespace fourd::device
