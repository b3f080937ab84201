#include <algorithm>
#include <vector>

#include "antialias/antialias.h"
#include "antialias/cpu/bands.h"
#include "antialias/cpu/loops.h"
#include "common/buffer.h"
#include "common/pages.h"
#include "common/team.h"

namespace fourd::antialias {
namespace {

constexpr std::size_t kTrianglesPerTask = 4096;

std::size_t floats_of(const Images& images) { return images.count * images.pixels() * images.channels; }

}  // namespace

Buffer<std::uint8_t> find_silhouettes(const Mesh& mesh, std::size_t images, Simd simd, Team& team) {
    const Loops& loops = select_loops(simd);
    const std::size_t instances = mesh.instanced ? images : 1;
    Buffer<std::uint8_t> out(instances * mesh.triangle_count);
    const std::size_t parts = (mesh.triangle_count + kTrianglesPerTask - 1) / kTrianglesPerTask;
    team.run(static_cast<int>(instances * parts), [&](int task, int) {
        const std::size_t begin = task % parts * kTrianglesPerTask;
        const std::size_t end = std::min(mesh.triangle_count, begin + kTrianglesPerTask);
        loops.silhouettes(mesh, task / parts, begin, end, out.data());
    });
    return out;
}

void blend(const Mesh& mesh, const Images& images, const Settings& settings, float* out, std::uint8_t* codes) {
    const Loops& loops = select_loops(settings.simd);
    Team team(settings.threads);
    const Buffer<std::uint8_t> silhouettes = find_silhouettes(mesh, images.count, settings.simd, team);
    const Plan plan{mesh, images, silhouettes.data()};
    prefer_huge_pages(out, floats_of(images) * sizeof(float));
    std::vector<Buffer<float>> scratch(team.size());
    for (Buffer<float>& one : scratch) one.require(3 * static_cast<std::size_t>(images.width));
    team.run(tasks_of(images), [&](int task, int worker) {
        loops.blend(plan, rows_of(images, task), scratch[worker].data(), out, codes);
    });
}

void blend_backward(const Mesh& mesh, const Images& images, const Settings& settings, const Gradients& gradients) {
    const Loops& loops = select_loops(settings.simd);
    Team team(settings.threads);
    const Plan plan{mesh, images, nullptr};
    const int tasks = tasks_of(images);
    if (gradients.colours) prefer_huge_pages(gradients.colours, floats_of(images) * sizeof(float));
    std::vector<std::size_t> first(tasks + 1, 0);
    if (gradients.positions) {
        team.run(tasks, [&](int task, int) {
            first[task + 1] = 2 * loops.count(plan, rows_of(images, task), gradients.codes);
        });
        for (int task = 0; task < tasks; ++task) first[task + 1] += first[task];
    }
    Buffer<Contribution> contributions(first[tasks]);
    team.run(tasks, [&](int task, int) {
        Contribution* const to = gradients.positions ? contributions.data() + first[task] : nullptr;
        loops.blend_backward(plan, rows_of(images, task), gradients, to);
    });
    if (!gradients.positions) return;
    // Each worker thread sums the contributions to one range of vertices, in the order of the pixels, so the sums do
    // not depend on the number of workers.
    const std::size_t vertices = mesh.vertices * (mesh.instanced ? images.count : 1);
    const std::size_t parts = static_cast<std::size_t>(team.size());
    team.run(team.size(), [&](int part, int) {
        loops.scatter(contributions.data(), first[tasks], vertices * part / parts, vertices * (part + 1) / parts,
                      gradients.positions);
    });
}

}  // namespace fourd::antialias
