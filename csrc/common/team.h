// Worker threads that live for one call: no state between calls, so forking, exceptions and
// sanitizers find nothing to trip over, and OpenMP is not needed where a compiler lacks it.
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
    // A body is called as body(task, worker); workers are numbered from 0 and run one task at a time.
    using Body = std::function<void(int task, int worker)>;

    explicit Team(int threads);
    ~Team();
    Team(const Team&) = delete;
    Team& operator=(const Team&) = delete;

    int size() const { return static_cast<int>(workers_.size()) + 1; }

    // Runs body for every task in [0, tasks), in any order, and returns when all are done.
    // The first exception thrown by a body is rethrown here; tasks not yet begun are dropped then.
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
