// The look at the loops after the step, and how fast the drift is corrected, as
// coopqp.qp_law.safety.LoopProbe.
#pragma once
#include <algorithm>
#include <cmath>
#include <vector>

#include "kinematics.hpp"
#include "problem.hpp"
#include "small.hpp"

namespace coopqp {

class Ahead {
  public:
    Ahead(const Model& model, const Settings& settings)
        : m_(model), s_(settings), after_(model), q_(model.joints.size()) {}

    // Gain of the drift correction: more where the loop budget is half used up.
    double kappa(const double* drift) const {
        const double most = 1.0 / s_.dt;
        if (s_.kappa >= most) return s_.kappa;
        double used = 0.0;
        for (int i = 0; i < m_.loops(); i++) {
            const double* e = drift + 6 * i;
            used = std::max(used, std::sqrt(dot3(e, e)) / s_.budget.loop_position);
            used = std::max(used, std::sqrt(dot3(e + 3, e + 3)) / s_.budget.loop_orientation);
        }
        return std::max(s_.kappa, std::min(std::max(2.0 * used - 1.0, 0.0), 1.0) * most);
    }

    // Whether the step v dt, v in lanes, leaves the loops within their budget.
    bool within(const double* q, const double* gap, const double* drift, const double* v) {
        if (m_.loops() < 1) return true;
        double error = 0.0;
        for (int i = 0; i < 6 * m_.loops(); i++) error += drift[i] * drift[i];
        error = 2.0 * std::sqrt(error);
        if (fits(error, s_.steepest * dot(v, v, m_.blocks))) return true;
        double opened = 0.0;
        for (int i = 0; i < m_.loops(); i++) {
            double by = 0.0;
            for (int j = 0; j < m_.n(); j++) {
                const double of_joint = v[m_.joints[std::size_t(j)].lane];
                by += s_.second_order[std::size_t(i * m_.n() + j)] * of_joint * of_joint;
            }
            opened = std::max(opened, by);
        }
        return fits(error, opened) || look(q, gap, v);
    }

  private:
    bool fits(double error, double opened) const {
        return error + s_.reach * opened <= s_.budget.loop_position &&
               error + opened <= s_.budget.loop_orientation;
    }

    bool look(const double* q, const double* gap, const double* v) {
        for (std::size_t j = 0; j < q_.size(); j++)
            q_[j] = q[j] + s_.dt * v[m_.joints[j].lane];
        after_.place(q_.data());
        after_.measure();
        for (int i = 0; i < m_.loops(); i++) {
            double e[6];
            for (int r = 0; r < 6; r++)
                e[r] = after_.loop_error[std::size_t(6 * i + r)] - gap[6 * i + r];
            if (!(std::sqrt(dot3(e, e)) <= s_.budget.loop_position &&
                  std::sqrt(dot3(e + 3, e + 3)) <= s_.budget.loop_orientation))
                return false;
        }
        return true;
    }

    const Model& m_;
    const Settings& s_;
    Kinematics after_;
    std::vector<double> q_;
};

}  // namespace coopqp
