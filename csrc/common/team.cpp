#include "common/team.h"

#include <system_error>

namespace fourd {

Team::Team(int threads) {
    workers_.reserve(threads > 1 ? static_cast<std::size_t>(threads) - 1 : 0);
    for (int worker = 1; worker < threads; ++worker) {
        try {
            workers_.emplace_back([this, worker] { work(worker); });
        } catch (const std::system_error&) {
            break;  // If the system cannot create another thread, the team works with fewer threads. Results do not
                    // depend on the number of threads.
        }
    }
}

Team::~Team() {
    {
        std::lock_guard<std::mutex> lock(mutex_);
        closing_ = true;
    }
    begin_.notify_all();
    for (std::thread& worker : workers_) worker.join();
}

void Team::run(int tasks, const Body& body) {
    {
        std::lock_guard<std::mutex> lock(mutex_);
        body_ = &body;
        tasks_ = tasks;
        next_.store(0, std::memory_order_relaxed);
        error_ = nullptr;
        ++round_;
    }
    begin_.notify_all();
    claim_tasks(0);
    std::unique_lock<std::mutex> lock(mutex_);
    end_.wait(lock, [this] { return busy_ == 0; });
    body_ = nullptr;  // Workers that have not woken up yet have nothing to do, and nobody waits for them.
    if (error_) std::rethrow_exception(error_);
}

void Team::work(int worker) {
    unsigned seen = 0;
    std::unique_lock<std::mutex> lock(mutex_);
    while (true) {
        begin_.wait(lock, [&] { return closing_ || (body_ && round_ != seen); });
        if (closing_) return;
        seen = round_;
        ++busy_;
        lock.unlock();
        claim_tasks(worker);
        lock.lock();
        if (--busy_ == 0) end_.notify_one();
    }
}

void Team::claim_tasks(int worker) {
    try {
        for (int task = next_.fetch_add(1); task < tasks_; task = next_.fetch_add(1)) (*body_)(task, worker);
    } catch (...) {
        std::lock_guard<std::mutex> lock(mutex_);
        if (!error_) error_ = std::current_exception();
        next_.store(tasks_);
    }
}

}  // namespace fourd
