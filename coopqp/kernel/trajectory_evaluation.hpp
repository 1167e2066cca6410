// What there was along a motion as a Python class.
#pragma once
#include <memory>

#include "core/trajectory_evaluation.hpp"
#include "reading.hpp"

namespace KERNEL_MODULE {

class TrajectoryEvaluation {
  public:
    explicit TrajectoryEvaluation(const nb::dict& d) {
        auto arena = std::make_unique<coopqp::Arena>();
        auto model = model_of(nb::cast<nb::dict>(d["model"]), *arena);
        auto levels = levels_of(d, *model, *arena);
        auto primitives = primitives_of(d);
        const auto joints = integers(d, "joints");
        const auto places = numbers(d, "places");
        std::vector<coopqp::Fixed> points;
        for (std::size_t i = 0; i < joints.size(); i++)
            points.push_back({joints[i], {places[3 * i], places[3 * i + 1], places[3 * i + 2]}});
        survey_ = std::make_unique<coopqp::TrajectoryEvaluation>(std::move(arena), std::move(model),
                                                   std::move(levels), std::move(primitives),
                                                   std::move(points));
    }

    // With the GIL held, which keeps other threads out. Without v, of no numbers, `moved` is left.
    void look(const Numbers& t, const Numbers& q, const Numbers& v, const Written& e,
              const Written& rate, const Written& moved, const Written& p_WO, const Written& R_WO,
              const Written& loop_error, const Written& points) {
        const std::size_t instants = t.size(), n = survey_->n(), rows = survey_->rows();
        const bool moves = v.size() > 0;
        const bool fits =
            q.size() == instants * n && e.size() == instants * rows &&
            rate.size() == instants * rows && p_WO.size() == 3 * instants &&
            R_WO.size() == 9 * instants && loop_error.size() == instants * survey_->loops() &&
            points.size() == 3 * instants * survey_->points() &&
            (!moves || (v.size() == (instants - 1) * n && moved.size() == (instants - 1) * rows));
        if (!fits) throw nb::value_error("a row for each instant");
        survey_->look(instants, t.data(), q.data(), moves ? v.data() : nullptr,
                      {e.data(), rate.data(), moved.data(), p_WO.data(), R_WO.data(),
                       loop_error.data(), points.data()});
    }

  private:
    std::unique_ptr<coopqp::TrajectoryEvaluation> survey_;
};

}  // namespace KERNEL_MODULE
