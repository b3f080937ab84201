// A thread pool that lives for one kernel call. It keeps no state between calls, which makes it safe with forks,
// exceptions and sanitizers. It does not need OpenMP.
#pragma once

#include <atomic>
#include <condition_variable>
#include <exception>
#include <functional>
#include <mutex>
#include <thread>
#include <vector>

namespace fourd {

class Team {
  public:
    // A function called as body(task, worker). Workers are numbered from 0, and each runs one task at a time.
    using Body = std::function<void(int task, int worker)>;

    explicit Team(int threads);
    ~Team();
    Team(const Team&) = delete;
    Team& operator=(const Team&) = delete;

    int size() const { return static_cast<int>(workers_.size()) + 1; }

    // Runs body for every task in [0, tasks), in any order, and returns when all are done. If body throws, run rethrows
    // the first exception and skips tasks that have not started.
    void run(int tasks, const Body& body);

  private:
    void work(int worker);
    void claim_tasks(int worker);

    std::vector<std::thread> workers_;
    std::mutex mutex_;
    std::condition_variable begin_, end_;
    std::exception_ptr error_;
    const Body* body_ = nullptr;
    std::atomic<int> next_{0};
    int tasks_ = 0;
    int busy_ = 0;
    unsigned round_ = 0;
    bool closing_ = false;
};

}  // namespace fourd
