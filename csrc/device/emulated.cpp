#include "device/emulated.h"

#include <ucontext.h>

#include <algorithm>
#include <array>
#include <memory>
#include <numeric>
#include <stdexcept>
#include <vector>

#include "device/entry_estimator.h"

namespace fourd::device {
namespace {

enum class Call { none, any, sum, max };

constexpr std::size_t kStackBytes = 128 << 10;

// makecontext accepts only int arguments, so a pointer is passed as two halves.
union Pieces {
    void* pointer;
    unsigned halves[2];
};
static_assert(sizeof(void*) == 2 * sizeof(unsigned), "expected a 64-bit machine");

}  // namespace

// Runs the 32 lanes of a warp as coroutines, which are resumed one after another. A resumed lane runs until it returns
// or waits in a call of a Lane function.
class Warp {
  public:
    explicit Warp(const std::function<void(const Lane&)>& body)
        : body_(body), stacks_(new char[kWarpSize * kStackBytes]) {
        for (int number = 0; number < kWarpSize; ++number) start(number);
    }

    void run() {
        while (finished_ == 0) {
            for (int number = 0; number < kWarpSize; ++number) resume(number);
            if (error_) std::rethrow_exception(error_);
            if (finished_ == kWarpSize) return;
            if (finished_ != 0) throw std::logic_error("emulated warp: lanes returned while others wait for them");
            for (const Call call : calls_) {
                if (call != calls_[0]) throw std::logic_error("emulated warp: lanes wait in different calls");
            }
            combine();
        }
    }

    // Each lane calls this function, which waits for the other lanes and returns the combined value of all lanes.
    double meet(int number, Call call, double value) {
        calls_[number] = call;
        values_[number] = value;
        swapcontext(&lanes_[number], &scheduler_);
        return result_;
    }

  private:
    void start(int number) {
        ucontext_t& lane = lanes_[number];
        getcontext(&lane);
        lane.uc_stack.ss_sp = stacks_.get() + number * kStackBytes;
        lane.uc_stack.ss_size = kStackBytes;
        lane.uc_link = &scheduler_;
        Pieces self;
        self.pointer = this;
        makecontext(&lane, reinterpret_cast<void (*)()>(&Warp::enter), 3, self.halves[0], self.halves[1], number);
    }

    static void enter(unsigned low, unsigned high, int number) {
        Pieces self;
        self.halves[0] = low;
        self.halves[1] = high;
        static_cast<Warp*>(self.pointer)->live(number);
    }

    void live(int number) {
        try {
            body_(Lane(*this, number));
        } catch (...) {
            error_ = std::current_exception();
        }
        ++finished_;
    }

    void resume(int number) { swapcontext(&scheduler_, &lanes_[number]); }

    void combine() {
        const auto first = values_.begin(), last = values_.end();
        switch (calls_[0]) {
            case Call::sum: {
                float total = 0;
                for (const double value : values_) total += static_cast<float>(value);
                result_ = total;
                return;
            }
            default:
                result_ = *std::max_element(first, last);
        }
    }

    const std::function<void(const Lane&)>& body_;
    std::unique_ptr<char[]> stacks_;  // Most of this memory is never used, so it is not initialised.
    std::array<ucontext_t, kWarpSize> lanes_{};
    ucontext_t scheduler_{};
    std::array<Call, kWarpSize> calls_{};
    // The values of all lanes. A double represents every float, bool and 32-bit integer exactly.
    std::array<double, kWarpSize> values_{};
    double result_ = 0;
    int finished_ = 0;
    std::exception_ptr error_;
};

bool Lane::any(bool value) const { return warp_.meet(number_, Call::any, value) != 0; }
float Lane::sum(float value) const { return static_cast<float>(warp_.meet(number_, Call::sum, value)); }
std::uint32_t Lane::max(std::uint32_t value) const {
    return static_cast<std::uint32_t>(warp_.meet(number_, Call::max, value));
}

void run_warp(const std::function<void(const Lane&)>& body) { Warp(body).run(); }

void Executor::sort(const std::uint32_t* keys, std::uint32_t* sorted_keys, const std::uint32_t* values,
                    std::uint32_t* sorted_values, std::size_t count, int bits, void*, std::size_t) const {
    const std::uint32_t mask = bits < 32 ? (1u << bits) - 1u : ~0u;
    std::vector<std::size_t> order(count);
    std::iota(order.begin(), order.end(), std::size_t{0});
    std::stable_sort(order.begin(), order.end(),
                     [&](std::size_t a, std::size_t b) { return (keys[a] & mask) < (keys[b] & mask); });
    for (std::size_t i = 0; i < count; ++i) {
        sorted_keys[i] = keys[order[i]];
        sorted_values[i] = values[order[i]];
    }
}

void Executor::exclusive_sum(const std::uint64_t* counts, std::uint64_t* out, std::size_t count, void*,
                             std::size_t) const {
    std::uint64_t total = 0;
    for (std::size_t i = 0; i < count; ++i) {
        out[i] = total;
        total += counts[i];
    }
}

std::uint64_t* allocate_mapped_counter() { return new std::uint64_t; }
void free_mapped_counter(std::uint64_t* number) { delete number; }

}  // namespace fourd::device
