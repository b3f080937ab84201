// Emulates a GPU in one CPU thread, for tests. The emulator calls a kernel for its indices in ascending order, and runs
// the 32 lanes of a warp in lockstep. If a lane diverges from its warp, the emulator raises an error. On a GPU, a
// diverging lane may hang or give wrong sums.
#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>

#include "device/lane.h"

namespace fourd::device {

// Runs body(lane) for each lane of a warp. A lane that calls a member function of Lane waits until all lanes have
// called the same function. Throws std::logic_error if some lanes return while others wait, or if lanes call different
// functions.
void run_warp(const std::function<void(const Lane&)>& body);

class Executor {
  public:
    explicit Executor(void*) {}

    template <typename Kernel>
    void for_each(std::size_t count, const Kernel& kernel) const {
        for (std::size_t i = 0; i < count; ++i) kernel(i);
    }

    template <typename Kernel>
    void for_each_in_warps(std::size_t count, const Kernel& kernel) const {
        for (std::size_t first = 0; first < count; first += kWarpSize) {
            std::size_t next = first;  // Lanes start in ascending order, so `next` gives each lane its index.
            run_warp([&](const Lane& lane) { kernel(next++, lane); });
        }
    }

    void sort(const std::uint32_t* keys, std::uint32_t* sorted_keys, const std::uint32_t* values,
              std::uint32_t* sorted_values, std::size_t count, int bits, void* scratch,
              std::size_t scratch_bytes) const;

    void exclusive_sum(const std::uint64_t* counts, std::uint64_t* out, std::size_t count, void* scratch,
                       std::size_t scratch_bytes) const;

    static std::size_t scratch_bytes(std::size_t) { return 0; }
};

}  // namespace fourd::device
