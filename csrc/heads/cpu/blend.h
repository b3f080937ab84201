// The blend head of one block of points and the mixing of colours, with their gradients. heads/cpu/loops.cpp includes
// this file inside its namespace.

// Computes the rectified hidden layer of the blend head in one view, into space.back.
inline void blend_hidden(const Job& job, const Workspace& space, const Shapes& at, const float* point, int count) {
    for (int i = 0; i < count; ++i) {
        float* to = space.back + static_cast<std::size_t>(i) * at.hidden;
        std::memcpy(to, point + static_cast<std::size_t>(i) * at.first, at.hidden * sizeof(float));
    }
    add_product(columns_of(space.samples, kBlock), count, job.packed->image_columns, at.hidden, at.sizes.channels,
                space.back, at.hidden, at.hidden);
    rectify(space.back, at.hidden, count, at.hidden);
}

FOURD_INLINE float dot(const float* a, const float* b, int width) {
    float lanes[kPad] = {};
    for (int h = 0; h < width; h += kPad) {
        for (int i = 0; i < kPad; ++i) lanes[i] += a[h + i] * b[h + i];
    }
    for (int half = kPad / 2; half > 0; half /= 2) {
        for (int i = 0; i < half; ++i) lanes[i] += lanes[i + half];
    }
    return lanes[0];
}

// Computes the logits of all views, and the colours that are blended: space.logits and space.colours.
inline void blend_views(const Job& job, const Workspace& space, const Shapes& at, std::size_t first, int count,
                        const float* point) {
    const Inputs& inputs = *job.inputs;
    const Settings& settings = *job.settings;
    for (int view = 0; view < at.sizes.views; ++view) {
        const std::size_t offset = static_cast<std::size_t>(view) * at.sizes.channels * inputs.count + first;
        load_channels(inputs.samples + offset, inputs.count, at.sizes.channels, count, space.samples);
        std::memcpy(space.colours + view * 3 * kBlock, space.samples + (at.sizes.channels - 3) * kBlock,
                    3 * kBlock * sizeof(float));
        blend_hidden(job, space, at, point, count);
        float* logits = space.logits + view * kBlock;
        for (int i = 0; i < count; ++i) {
            logits[i] = dot(space.back + static_cast<std::size_t>(i) * at.hidden, job.packed->out, at.hidden);
        }
        for (int i = count; i < kBlock; ++i) logits[i] = 0.0f;
        const float bias = *job.packed->out_bias, range = settings.logit_range;
        for (int i = 0; i < kBlock; ++i) logits[i] = range * fast_tanh((logits[i] + bias) / range);
    }
}

// Computes the normalised blend weights from the logits and visibilities: space.weights. A point that no view sees has
// the weights of the views, normalised; the second result is then 0, and otherwise 1.
inline void blend_weights(const Job& job, const Workspace& space, std::size_t first, int count, float* is_seen) {
    const Inputs& inputs = *job.inputs;
    const int views = job.sizes->views;
    float total[kBlock] = {}, even = 0.0f;
    for (int view = 0; view < views; ++view) {
        const float share = inputs.view_weights[view], least = job.settings->min_visibility;
        const float* visibility = inputs.visibility + view * inputs.count + first;
        const float* logits = space.logits + view * kBlock;
        float* weights = space.weights + view * kBlock;
        even += share;
        for (int i = 0; i < count; ++i) weights[i] = visibility[i] < least ? 0.0f : visibility[i] * share;
        for (int i = count; i < kBlock; ++i) weights[i] = 0.0f;
        for (int i = 0; i < kBlock; ++i) weights[i] *= fast_exp(logits[i]);
        for (int i = 0; i < kBlock; ++i) total[i] += weights[i];
    }
    for (int i = 0; i < kBlock; ++i) is_seen[i] = total[i] > 0.0f ? 1.0f : 0.0f;
    for (int view = 0; view < views; ++view) {
        float* weights = space.weights + view * kBlock;
        const float mean = inputs.view_weights[view] / even;
        for (int i = 0; i < kBlock; ++i) weights[i] = total[i] > 0.0f ? weights[i] / total[i] : mean;
    }
}

// Mixes the colour of one view with the points' own colours.
inline float mixed(float colour, float own, float share) {
    const float mix = colour + share * (own - colour);
    return mix < 0.0f ? 0.0f : mix > 1.0f ? 1.0f : mix;
}

// The share of the own colour that replaces the colour of a view: constant, or by visibility.
inline float own_share(const Settings& settings, float visibility) {
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
        for (int c = 0; c < 3; ++c) {
            const float* colour = space.colours + (view * 3 + c) * kBlock;
            const float* weights = space.weights + view * kBlock;
            float* to = out + c * kBlock;
            if (!inputs.own) {
                for (int i = 0; i < count; ++i) to[i] += weights[i] * colour[i];
            } else if (settings.own_share > 0.0f) {
                for (int i = 0; i < count; ++i) {
                    to[i] += weights[i] * mixed(colour[i], inputs.own[3 * (first + i) + c], settings.own_share);
                }
            } else {
                for (int i = 0; i < count; ++i) {
                    const float own = inputs.own[3 * (first + i) + c];
                    to[i] += weights[i] * (colour[i] + own_share(settings, visibility[i]) * (own - colour[i]));
                }
            }
        }
    }
}

// Computes the gradients of logits and mixed colours, in place of their values: space.logits and space.colours. Writes
// the gradient of the own colours.
inline void blend_weights_backward(const Job& job, const Workspace& space, std::size_t first, int count,
                                   const float* is_seen, const Gradients& out) {
    const Inputs& inputs = *job.inputs;
    const Settings& settings = *job.settings;
    const int views = job.sizes->views;
    float to_own[3 * kBlock] = {}, mean[kBlock] = {};
    for (int pass = 0; pass < 2; ++pass) {
        for (int view = 0; view < views; ++view) {
            const float* visibility = inputs.visibility + view * inputs.count + first;
            const float* weights = space.weights + view * kBlock;
            float* logits = space.logits + view * kBlock;
            float to_weight[kBlock] = {};
            for (int c = 0; c < 3; ++c) {
                float* colours = space.colours + (view * 3 + c) * kBlock;
                const float* gradient = space.grad_colour + c * kBlock;
                for (int i = 0; i < count; ++i) {
                    const float own = inputs.own ? inputs.own[3 * (first + i) + c] : 0.0f;
                    const float share = inputs.own ? own_share(settings, visibility[i]) : 0.0f;
                    const float mix = colours[i] + share * (own - colours[i]);
                    const bool clamps = inputs.own && settings.own_share > 0.0f;
                    const bool is_free = !clamps || (mix >= 0.0f && mix <= 1.0f);
                    const float shown = is_free ? mix : mix < 0.0f ? 0.0f : 1.0f;
                    to_weight[i] += gradient[i] * shown;
                    if (pass == 0) continue;
                    const float to_mix = is_free ? gradient[i] * weights[i] : 0.0f;
                    to_own[c * kBlock + i] += share * to_mix;
                    colours[i] = (1.0f - share) * to_mix;
                }
            }
            if (pass == 0) {
                for (int i = 0; i < kBlock; ++i) mean[i] += weights[i] * to_weight[i];
                continue;
            }
            for (int i = 0; i < kBlock; ++i) {
                const float ratio = logits[i] / settings.logit_range;
                logits[i] = is_seen[i] * weights[i] * (to_weight[i] - mean[i]) * (1.0f - ratio * ratio);
            }
        }
    }
    if (!out.own) return;
    for (int i = 0; i < count; ++i) {
        for (int c = 0; c < 3; ++c) out.own[3 * (first + i) + c] = to_own[c * kBlock + i];
    }
}

// Computes the gradients of the blend head, from the gradients that blend_weights_backward() wrote.
inline void blend_backward(const Job& job, const Workspace& space, const Shapes& at, std::size_t first, int count,
                           const Gradients& out, const Sums& sums) {
    const Inputs& inputs = *job.inputs;
    const Packed& packed = *job.packed;
    const int channels = at.sizes.channels;
    const float* point = space.first + at.hidden;
    float* to_point = space.grad_first + at.hidden;
    for (int i = 0; i < count; ++i) clear(to_point + static_cast<std::size_t>(i) * at.first, at.hidden);
    for (int view = 0; view < at.sizes.views; ++view) {
        const std::size_t offset = static_cast<std::size_t>(view) * channels * inputs.count + first;
        load_channels(inputs.samples + offset, inputs.count, channels, count, space.samples);
        blend_hidden(job, space, at, point, count);
        const float* to_raw = space.logits + view * kBlock;
        add_product({to_raw, 0, 1}, 1, space.back, at.hidden, count, sums.out, at.hidden, at.hidden);
        const float* FOURD_RESTRICT weights = packed.out;
        for (int i = 0; i < count; ++i) {
            float* FOURD_RESTRICT row = space.back + static_cast<std::size_t>(i) * at.hidden;
            float* FOURD_RESTRICT to = to_point + static_cast<std::size_t>(i) * at.first;
            const float gradient = to_raw[i];
            *sums.out_bias += gradient;
            for (int h = 0; h < at.hidden; ++h) {
                const float product = gradient * weights[h];
                row[h] = row[h] > 0.0f ? product : 0.0f;
                to[h] += row[h];
            }
        }
        add_product(rows_of(space.samples, kBlock), channels, space.back, at.hidden, count, sums.image_columns,
                    at.hidden, at.hidden);
        clear(space.wide, static_cast<std::size_t>(count) * at.channels);
        add_product(rows_of(space.back, at.hidden), count, packed.image, at.channels, at.sizes.hidden, space.wide,
                    at.channels, at.channels);
        const float* colours = space.colours + view * 3 * kBlock;
        for (int c = 0; c < channels; ++c) {
            float* to = out.samples + offset + c * inputs.count;
            for (int i = 0; i < count; ++i) to[i] = space.wide[i * at.channels + c];
            if (c < channels - 3) continue;
            for (int i = 0; i < count; ++i) to[i] += colours[(c - (channels - 3)) * kBlock + i];
        }
    }
}
