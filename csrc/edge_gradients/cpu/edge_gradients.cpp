#include "edge_gradients/edge_gradients.h"

#include <vector>

#include "antialias/cpu/bands.h"
#include "common/buffer.h"
#include "common/team.h"
#include "edge_gradients/cpu/loops.h"

namespace fourd::edge_gradients {

void edge_gradients(const Mesh& mesh, const antialias::Images& images, const antialias::Settings& settings,
                    const float* gradient, float* positions) {
    const Loops& loops = select_loops(settings.simd);
    Team team(settings.threads);
    const Buffer<std::uint8_t> silhouettes = antialias::find_silhouettes(mesh, images.count, settings.simd, team);
    const Plan plan{mesh, images, silhouettes.data()};
    const int tasks = antialias::tasks_of(images);
    std::vector<Buffer<float>> scratch(team.size());
    for (Buffer<float>& one : scratch) one.require(3 * static_cast<std::size_t>(images.width));
    Buffer<std::uint8_t> codes(images.count * images.pixels());
    std::vector<std::size_t> first(tasks + 1, 0);
    team.run(tasks, [&](int task, int worker) {
        first[task + 1] =
            loops.find(plan, antialias::rows_of(images, task), gradient, scratch[worker].data(), codes.data());
    });
    for (int task = 0; task < tasks; ++task) first[task + 1] += first[task];
    Buffer<Contribution> contributions(first[tasks]);
    team.run(tasks, [&](int task, int) {
        loops.contribute(plan, antialias::rows_of(images, task), gradient, codes.data(),
                         contributions.data() + first[task]);
    });
    // Each worker thread sums the contributions to one range of vertices, in the order of the pixels, so the sums do
    // not depend on the number of workers.
    const std::size_t vertices = mesh.vertices * (mesh.instanced ? images.count : 1);
    const std::size_t parts = static_cast<std::size_t>(team.size());
    team.run(team.size(), [&](int part, int) {
        loops.scatter(contributions.data(), first[tasks], vertices * part / parts, vertices * (part + 1) / parts,
                      positions);
    });
}

}  // namespace fourd::edge_gradients
