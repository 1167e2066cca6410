// Manifolds and paths on them as a Python class.
#pragma once
#include <memory>

#include "core/apart.hpp"
#include "core/way.hpp"
#include "free_space.hpp"
#include "reading.hpp"

namespace KERNEL_MODULE {

// The kernel's distances, then what limits in Python say of a configuration.
class Room final : public coopqp::Obstruction {
  public:
    Room(const coopqp::Model& model, const std::vector<coopqp::KeptApart>& kept, nb::object others)
        : space_(model, kept), others_(std::move(others)), n_(std::size_t(model.n())) {}

    bool free(const coopqp::Kinematics& kinematics, const double* q) override {
        if (!space_.free(kinematics)) return false;
        if (others_.is_none()) return true;
        nb::gil_scoped_acquire held;
        nb::ndarray<nb::numpy, const double> seen(q, {n_}, nb::handle());
        return nb::cast<bool>(others_(nb::cast(seen, nb::rv_policy::copy)));
    }

  private:
    coopqp::FreeSpace space_;
    nb::object others_;
    std::size_t n_;
};

class Planner {
  public:
    explicit Planner(const nb::dict& d) {
        auto arena = std::make_unique<coopqp::Arena>();
        auto model = model_of(nb::cast<nb::dict>(d["model"]), *arena);
        auto levels = levels_of(d, *model, *arena);
        auto primitives = primitives_of(d);
        manifold_ = std::make_unique<coopqp::Manifold>(
            std::move(arena), std::move(model), numbers(d, "kept"), int(number(d, "rank")),
            std::move(levels), std::move(primitives), number(d, "t"), numbers(d, "lower"),
            numbers(d, "upper"));
        for (nb::handle kept : nb::cast<nb::list>(d["distances"]))
            kept_.push_back(kept_apart_of(nb::cast<nb::dict>(kept)));
    }

    // Bring each row of q to the manifold; `closed` says which are there.
    void project(const Written& q, const Said& closed, int steps) {
        const auto n = std::size_t(manifold_->n());
        if (q.size() != closed.size() * n) throw nb::value_error("a number for each joint");
        const nb::gil_scoped_release released;
        for (std::size_t i = 0; i < closed.size(); i++)
            closed.data()[i] = manifold_->project(q.data() + i * n, nullptr, steps);
    }

    // For each configuration, (N, n), whether all pairs keep their distance.
    void is_free(const Numbers& q, const Said& free) const {
        told_free(manifold_->model(), kept_, q, free);
    }

    // `others` says whether a configuration keeps the limits that Python knows; None: there are none.
    nb::dict find(const nb::dict& d, const nb::object& others, const nb::callable& wait) const {
        coopqp::Search search;
        search.step = number(d, "step");
        search.fine = number(d, "fine");
        search.range = number(d, "range");
        search.seconds = number(d, "seconds");
        search.most = long(number(d, "most"));
        search.seed = nb::cast<std::uint64_t>(d["seed"]);
        search.shortcuts = int(number(d, "shortcuts"));
        search.low = numbers(d, "low");
        search.high = numbers(d, "high");
        const std::size_t n = search.low.size();
        const auto flags = integers(d, "charts");
        for (std::size_t at = 0; at < flags.size(); at += n)
            search.charts.emplace_back(flags.begin() + long(at), flags.begin() + long(at + n));
        const auto starts = numbers(d, "starts"), goals = numbers(d, "goals");
        if (n != std::size_t(manifold_->n()) || starts.size() % n || goals.size() % n ||
            flags.size() % n || search.charts.empty())
            throw nb::value_error("a number for each joint");
        Room room(manifold_->model(), kept_, others);
        coopqp::Way way(*manifold_, room, search, [&] {
            nb::gil_scoped_acquire held;
            wait();
        });
        coopqp::Found found;
        {
            const nb::gil_scoped_release released;
            found = way.find(starts, goals);
        }
        nb::dict out;
        out["found"] = found.found;
        out["path"] = nb::bytes(reinterpret_cast<const char*>(found.path.data()),
                                found.path.size() * sizeof(double));
        out["first"] = found.first;
        out["checks"] = found.checks;
        out["projections"] = found.projections;
        out["nodes"] = found.nodes;
        return out;
    }

  private:
    std::unique_ptr<coopqp::Manifold> manifold_;
    std::vector<coopqp::KeptApart> kept_;
};

}  // namespace KERNEL_MODULE
