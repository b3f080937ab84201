// A thread pool that exists for one kernel call. It keeps no state between calls, so forks, exceptions and sanitizers
// cause no problems. It does not need OpenMP.
#pragma once

#include <algorithm>
#include <atomic>
#include <condition_variable>
#include <cstddef>
#include <exception>
#include <functional>
#include <mutex>
#include <thread>
#include <vector>

namespace fourd {

class Team {
  public:
    // A function that the pool calls as body(task, worker). Workers are numbered from 0, and each worker runs one task
    // at a time.
    using Body = std::function<void(int task, int worker)>;

    explicit Team(int threads);
    ~Team();
    Team(const Team&) = delete;
    Team& operator=(const Team&) = delete;

    int size() const { return static_cast<int>(workers_.size()) + 1; }

    // Runs body for every task in [0, tasks), in any order, and returns when all tasks are done. If body throws an
    // exception, run skips the tasks that have not started and rethrows the first exception.
    void run(int tasks, const Body& body);

  private:
    void work(int worker);
    void claim_tasks(int worker);

    std::vector<std::thread> workers_;
    std::mutex mutex_;
    std::condition_variable begin_, end_;
    std::exception_ptr error_;
    const Body* body_ = nullptr;  // Null between calls of run().
    std::atomic<int> next_{0};
    int tasks_ = 0;
    int busy_ = 0;  // Workers that claim tasks.
    unsigned round_ = 0;
    bool closing_ = false;
};

// Splits [0, count) into parts of `per_part` elements, and calls work(begin, end) for each part, on all workers of the
// team. The parts do not depend on the number of threads.
template <typename Work>
void run_parts(Team& team, std::size_t count, std::size_t per_part, const Work& work) {
    team.run(static_cast<int>((count + per_part - 1) / per_part), [&](int task, int) {
        const std::size_t begin = task * per_part;
        work(begin, std::min(count, begin + per_part));
    });
}

}  // namespace fourd
