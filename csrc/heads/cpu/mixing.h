// The weights of the views' colours and the mixed colours of one block of points, with their gradients.
// heads/cpu/loops.cpp includes this file inside its namespace.

// The values of one channel of a view's colours.
FOURD_INLINE const float* colours_of(const Job& job, int view, int channel, std::size_t first) {
    const int row = (view + 1) * job.sizes->channels - 3 + channel;
    return job.inputs->samples + static_cast<std::size_t>(row) * job.inputs->count + first;
}

// Computes the normalised blend weights from the logits and visibilities: space.weights. A point that no view sees has
// the weights of the views, normalised; the second result is then 0, and otherwise 1.
inline void blend_weights(const Job& job, const Workspace& space, std::size_t first, int count, const float* logits,
                          float* is_seen) {
    const Inputs& inputs = *job.inputs;
    const int views = job.sizes->views;
    const float least = job.settings->min_visibility;
    float total[kBlock] = {}, even = 0.0f;
    for (int view = 0; view < views; ++view, logits += inputs.count) {
        const float share = inputs.view_weights[view];
        const float* visibility = inputs.visibility + view * inputs.count + first;
        float* weights = space.weights + view * kBlock;
        even += share;
        for (int i = 0; i < count; ++i) {
            const float seen = visibility[i] < least ? 0.0f : visibility[i] * share;
            weights[i] = seen * fast_exp(logits[i]);
            total[i] += weights[i];
        }
    }
    for (int i = 0; i < count; ++i) is_seen[i] = total[i] > 0.0f ? 1.0f : 0.0f;
    for (int view = 0; view < views; ++view) {
        float* weights = space.weights + view * kBlock;
        const float mean = inputs.view_weights[view] / even;
        for (int i = 0; i < count; ++i) weights[i] = total[i] > 0.0f ? weights[i] / total[i] : mean;
    }
}

// The share of the own colour that replaces the colour of a view: constant, or by visibility.
FOURD_INLINE float own_share(const Settings& settings, float visibility) {
    if (settings.own_share > 0.0f) return settings.own_share;
    return 1.0f - (visibility < settings.min_visibility ? 0.0f : visibility);
}

// Writes the blended colour to out (3, kBlock).
inline void blended_colour(const Job& job, const Workspace& space, std::size_t first, int count, float* out) {
    const Inputs& inputs = *job.inputs;
    const Settings& settings = *job.settings;
    clear(out, 3 * kBlock);
    for (int view = 0; view < job.sizes->views; ++view) {
        const float* visibility = inputs.visibility + view * inputs.count + first;
        const float* weights = space.weights + view * kBlock;
        for (int c = 0; c < 3; ++c) {
            const float* colour = colours_of(job, view, c, first);
            float* to = out + c * kBlock;
            if (!inputs.own) {
                for (int i = 0; i < count; ++i) to[i] += weights[i] * colour[i];
                continue;
            }
            const float* own = inputs.own + 3 * first + c;
            const bool clamps = settings.own_share > 0.0f;
            for (int i = 0; i < count; ++i) {
                const float share = own_share(settings, visibility[i]);
                float mix = colour[i] + share * (own[3 * i] - colour[i]);
                if (clamps) mix = mix < 0.0f ? 0.0f : mix > 1.0f ? 1.0f : mix;
                to[i] += weights[i] * mix;
            }
        }
    }
}

// Computes the gradient of a view's weights, and with Final also the gradients of its colours and of the own colours.
template <bool Final>
FOURD_INLINE void view_backward(const Job& job, const Workspace& space, std::size_t first, int count, int view,
                                float* to_weight, float* to_own) {
    const Inputs& inputs = *job.inputs;
    const Settings& settings = *job.settings;
    const float* visibility = inputs.visibility + view * inputs.count + first;
    const float* weights = space.weights + view * kBlock;
    const bool clamps = inputs.own && settings.own_share > 0.0f;
    for (int c = 0; c < 3; ++c) {
        const float* colours = colours_of(job, view, c, first);
        const float* gradient = space.grad_colour + c * kBlock;
        float* to_colours = space.grad_mixed + (view * 3 + c) * kBlock;
        for (int i = 0; i < count; ++i) {
            const float own = inputs.own ? inputs.own[3 * (first + i) + c] : 0.0f;
            const float share = inputs.own ? own_share(settings, visibility[i]) : 0.0f;
            const float mix = colours[i] + share * (own - colours[i]);
            const bool is_free = !clamps || (mix >= 0.0f && mix <= 1.0f);
            const float shown = is_free ? mix : mix < 0.0f ? 0.0f : 1.0f;
            to_weight[i] += gradient[i] * shown;
            if (!Final) continue;
            const float to_mix = is_free ? gradient[i] * weights[i] : 0.0f;
            to_own[c * kBlock + i] += share * to_mix;
            to_colours[i] = (1.0f - share) * to_mix;
        }
    }
}

// Computes the gradients of the logits before tanh and of the views' colours: space.grad_logits and space.grad_mixed.
// Writes the gradient of the own colours.
inline void blend_weights_backward(const Job& job, const Workspace& space, std::size_t first, int count,
                                   const float* logits, const float* is_seen, const Gradients& out) {
    const int views = job.sizes->views;
    const float range = job.settings->logit_range;
    float to_own[3 * kBlock] = {}, mean[kBlock] = {};
    for (int view = 0; view < views; ++view) {
        float to_weight[kBlock] = {};
        view_backward<false>(job, space, first, count, view, to_weight, to_own);
        const float* weights = space.weights + view * kBlock;
        for (int i = 0; i < count; ++i) mean[i] += weights[i] * to_weight[i];
    }
    for (int view = 0; view < views; ++view, logits += job.inputs->count) {
        float to_weight[kBlock] = {};
        view_backward<true>(job, space, first, count, view, to_weight, to_own);
        const float* weights = space.weights + view * kBlock;
        float* to_logits = space.grad_logits + view * kBlock;
        for (int i = 0; i < count; ++i) {
            const float ratio = logits[i] / range;
            to_logits[i] = is_seen[i] * weights[i] * (to_weight[i] - mean[i]) * (1.0f - ratio * ratio);
        }
    }
    if (!out.own) return;
    for (int i = 0; i < count; ++i) {
        for (int c = 0; c < 3; ++c) out.own[3 * (first + i) + c] = to_own[c * kBlock + i];
    }
}
