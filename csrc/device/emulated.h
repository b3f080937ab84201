// A GPU in one thread of the CPU, for tests: every kernel in its order, warps with their thirty-two threads in
// step. A thread that leaves the others, which on a GPU may hang or give wrong sums, is an error here.
#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>

#include "device/lane.h"

namespace fourd::device {

// Runs body(lane) once for each lane; calls of Lane's functions wait until all lanes have made them.
// Throws std::logic_error if some lanes return while others wait, or their calls differ.
void run_warp(const std::function<void(const Lane&)>& body);

class Machine {
  public:
    explicit Machine(void*) {}

    template <typename Kernel>
    void each(std::size_t count, const Kernel& kernel) const {
        for (std::size_t i = 0; i < count; ++i) kernel(i);
    }

    template <typename Kernel>
    void warps(std::size_t count, const Kernel& kernel) const {
        for (std::size_t first = 0; first < count; first += kWarp) {
            std::size_t next = first;  // lanes start in order
            run_warp([&](const Lane& lane) { kernel(next++, lane); });
        }
    }

    void sort(const std::uint32_t* keys, std::uint32_t* sorted_keys, const std::uint32_t* values,
              std::uint32_t* sorted_values, std::size_t count, int bits, void* scratch, std::size_t scratch_bytes) const;

    void sum_before(const std::uint64_t* counts, std::uint64_t* out, std::size_t count, void* scratch,
                    std::size_t scratch_bytes) const;

    static std::size_t scratch_bytes(std::size_t) { return 0; }
};

}  // namespace fourd::device
