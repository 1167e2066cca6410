// The look at the loops after the step, and how fast the drift is corrected, as
// coopqp.qp_law.safety.StepVerification.
#pragma once
#include <algorithm>
#include <cmath>
#include <vector>

#include "kinematics.hpp"
#include "problem.hpp"
#include "shared.hpp"
#include "small.hpp"

namespace coopqp {

class Ahead {
  public:
    Ahead(const Model& model, const Settings& settings, Arena& arena)
        : m_(model), s_(settings), after_(model), q_(model.joints.size()),
          part_(arena.take(std::size_t(model.blocks * LANES))) {}

    // Gain of the Baumgarte stabilisation: more where the loop budget is half used up.
    double kappa(const double* drift) const {
        const double most = 1.0 / s_.dt;
        if (s_.kappa >= most) return s_.kappa;
        double used = 0.0;
        for (int i = 0; i < m_.loops(); i++) {
            const double* e = drift + 6 * i;
            used = std::max(used, size3(e) / s_.budget.loop_position);
            used = std::max(used, size3(e + 3) / s_.budget.loop_orientation);
        }
        return std::max(s_.kappa, std::min(std::max(2.0 * used - 1.0, 0.0), 1.0) * most);
    }

    // The largest share of a step v dt, v in lanes, that leaves the loops within their budget, by
    // which v is shortened. 0 where hardly a step would.
    double shorten(const double* q, const double* loop_offset, const double* drift, double* v) {
        if (within(q, loop_offset, drift, v)) return 1.0;
        double share = 0.0, more = 0.5;
        for (int i = 0; i < HALVINGS; i++, more *= 0.5) {
            for (int b = 0; b < m_.blocks; b++)
                lanes(part_)[b] = (share + more) * lanes(v)[b];
            if (within(q, loop_offset, drift, part_)) share += more;
        }
        if (share < SHORTEST) return 0.0;
        for (int b = 0; b < m_.blocks; b++) lanes(v)[b] *= share;
        return share;
    }

  private:
    static double size3(const double* e) { return std::sqrt(dot3(e, e)); }

    // Whether the loops are within their budget after a step, or no worse than before it.
    bool within(const double* q, const double* loop_offset, const double* drift, const double* v) {
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
        return fits(error, opened) || look(q, loop_offset, drift, v);
    }

    bool fits(double error, double opened) const {
        return error + s_.reach * opened <= s_.budget.loop_position &&
               error + opened <= s_.budget.loop_orientation;
    }

    bool look(const double* q, const double* loop_offset, const double* drift, const double* v) {
        for (std::size_t j = 0; j < q_.size(); j++)
            q_[j] = q[j] + s_.dt * v[m_.joints[j].lane];
        after_.place(q_.data());
        after_.measure();
        for (int i = 0; i < m_.loops(); i++) {
            double e[6];
            for (int r = 0; r < 6; r++)
                e[r] = after_.loop_error[std::size_t(6 * i + r)] - loop_offset[6 * i + r];
            // A loop that is open already may be closed by steps that leave it open for now.
            const double* before = drift + 6 * i;
            if (!(size3(e) <= std::max(s_.budget.loop_position, size3(before)) &&
                  size3(e + 3) <= std::max(s_.budget.loop_orientation, size3(before + 3))))
                return false;
        }
        return true;
    }

    const Model& m_;
    const Settings& s_;
    Kinematics after_;
    std::vector<double> q_;
    double* part_;  // of a step
};

}  // namespace coopqp
