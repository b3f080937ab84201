// Launches kernels on a GPU, asynchronously on one stream. Only nvcc compiles this file.
#pragma once

#include <cub/device/device_radix_sort.cuh>
#include <cub/device/device_scan.cuh>

#include <cstddef>
#include <cstdint>
#include <stdexcept>
#include <string>

#include "device/lane.h"

namespace fourd::device {

constexpr int kThreads = 256;  // Number of threads per block, which must be a multiple of the warp size.
constexpr std::size_t kMaxBlocks = 1 << 20;

template <typename Kernel>
__global__ void __launch_bounds__(kThreads) run_for_each(const Kernel kernel, const std::size_t count) {
    const std::size_t stride = static_cast<std::size_t>(gridDim.x) * kThreads;
    for (std::size_t i = static_cast<std::size_t>(blockIdx.x) * kThreads + threadIdx.x; i < count; i += stride) {
        kernel(i);
    }
}

// Calls kernel(index, lane) for each index below `count`, which must be a multiple of kWarpSize, so that every warp is
// complete.
template <typename Kernel>
__global__ void __launch_bounds__(kThreads) run_warps(const Kernel kernel, const std::size_t count) {
    const std::size_t stride = static_cast<std::size_t>(gridDim.x) * kThreads;
    for (std::size_t i = static_cast<std::size_t>(blockIdx.x) * kThreads + threadIdx.x; i < count; i += stride) {
        kernel(i, Lane());
    }
}

inline void check(cudaError_t status, const char* what) {
    if (status != cudaSuccess) throw std::runtime_error(std::string(what) + ": " + cudaGetErrorString(status));
}

class Executor {
  public:
    // `stream` is a cudaStream_t of the current device.
    explicit Executor(void* stream) : stream_(static_cast<cudaStream_t>(stream)) {}

    // Calls kernel(index) for each index below count, in any order.
    template <typename Kernel>
    void for_each(std::size_t count, const Kernel& kernel) const {
        if (count == 0) return;
        run_for_each<<<blocks(count), kThreads, 0, stream_>>>(kernel, count);
        check(cudaGetLastError(), "a kernel's launch");
    }

    // Calls kernel(index, lane) for each index below `count`, which must be a multiple of kWarpSize, because kWarpSize
    // consecutive indices form a warp.
    template <typename Kernel>
    void for_each_in_warps(std::size_t count, const Kernel& kernel) const {
        if (count == 0) return;
        run_warps<<<blocks(count), kThreads, 0, stream_>>>(kernel, count);
        check(cudaGetLastError(), "a kernel's launch");
    }

    // Sorts (key, value) pairs stably by the `bits` lowest bits of their keys. `count` must be below 2^31.
    void sort(const std::uint32_t* keys, std::uint32_t* sorted_keys, const std::uint32_t* values,
              std::uint32_t* sorted_values, std::size_t count, int bits, void* scratch,
              std::size_t scratch_bytes) const {
        check(cub::DeviceRadixSort::SortPairs(scratch, scratch_bytes, keys, sorted_keys, values, sorted_values,
                                              static_cast<int>(count), 0, bits, stream_),
              "a sort");
    }

    // Sets out[i] to the sum of counts[0] to counts[i - 1]. `count` must be below 2^31.
    void exclusive_sum(const std::uint64_t* counts, std::uint64_t* out, std::size_t count, void* scratch,
                       std::size_t scratch_bytes) const {
        check(cub::DeviceScan::ExclusiveSum(scratch, scratch_bytes, counts, out, static_cast<int>(count), stream_),
              "a sum");
    }

    // Returns the number of bytes of scratch memory that sort or exclusive_sum needs for `count` elements.
    static std::size_t scratch_bytes(std::size_t count) {
        std::size_t sort = 0, sum = 0;
        const int number = static_cast<int>(count);
        std::uint32_t* words = nullptr;
        std::uint64_t* sums = nullptr;
        check(cub::DeviceRadixSort::SortPairs(nullptr, sort, words, words, words, words, number), "a sort");
        check(cub::DeviceScan::ExclusiveSum(nullptr, sum, sums, sums, number), "a sum");
        return sort > sum ? sort : sum;
    }

  private:
    static unsigned blocks(std::size_t count) {
        const std::size_t wanted = (count + kThreads - 1) / kThreads;
        return static_cast<unsigned>(wanted < kMaxBlocks ? wanted : kMaxBlocks);
    }

    cudaStream_t stream_;
};

}  // namespace fourd::device
