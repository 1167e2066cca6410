// Distances of a robot's bodies at given configurations as a Python class.
#pragma once
#include <memory>

#include "core/apart.hpp"
#include "reading.hpp"

namespace KERNEL_MODULE {

// For each configuration, (N, n), whether all pairs keep their distance; without the GIL.
inline void told_free(const coopqp::Model& model, const std::vector<coopqp::KeptApart>& kept,
                      const Numbers& q, const Said& free) {
    const std::size_t n = model.joints.size();
    if (q.size() != n * free.size()) throw nb::value_error("a number for each joint");
    const nb::gil_scoped_release released;
    coopqp::FreeSpace space(model, kept);
    for (std::size_t i = 0; i < free.size(); i++) free.data()[i] = space.free(q.data() + i * n);
}

class FreeSpace {
  public:
    explicit FreeSpace(const nb::dict& d) : model_(model_of(nb::cast<nb::dict>(d["model"]), arena_)) {
        for (nb::handle kept : nb::cast<nb::list>(d["distances"]))
            kept_.push_back(kept_apart_of(nb::cast<nb::dict>(kept)));
    }

    // For each configuration, (N, n), whether all pairs keep their distance.
    void is_free(const Numbers& q, const Said& free) const { told_free(*model_, kept_, q, free); }

    // Of each pair: what was told, d, gap, p and n of coopqp::Closest, (pairs, 9); without the GIL.
    void measure(const Numbers& q, const Written& found) const {
        std::size_t pairs = 0;
        for (const auto& each : kept_) pairs += each.pairs.size();
        if (q.size() != model_->joints.size() || found.size() != 9 * pairs)
            throw nb::value_error("a number for each joint, nine for each pair");
        const nb::gil_scoped_release released;
        double* to = found.data();
        coopqp::FreeSpace(*model_, kept_).measure(q.data(), [&](const coopqp::Closest& c) {
            for (double x : {double(c.told), c.d, c.gap, c.p.x, c.p.y, c.p.z, c.n.x, c.n.y, c.n.z})
                *to++ = x;
        });
    }

    // For one thread; this outlives it.
    coopqp::FreeSpace own() const { return {*model_, kept_}; }

  private:
    coopqp::Arena arena_;
    std::unique_ptr<coopqp::Model> model_;
    std::vector<coopqp::KeptApart> kept_;
};

}  // namespace KERNEL_MODULE
