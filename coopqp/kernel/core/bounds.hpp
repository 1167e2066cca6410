// Limits on each joint's velocity, as coopqp.limits has them.
#pragma once
#include <algorithm>
#include <cmath>
#include <vector>

#include "model.hpp"
#include "problem.hpp"

namespace coopqp {

// One limit whose bounds change from tick to tick; what they mean depends on the kind.
struct JointLimit {
    Bounded kind;
    std::vector<double> lower, upper;  // of what the kind says
    std::vector<double> step;          // of braking: change of v
    double speed;                      // of a position: fastest way back from outside
};

class Bounds {
  public:
    Bounds() = default;
    Bounds(std::size_t joints, double dt)
        : lower(joints, -1e300), upper(joints, 1e300), least_(joints), most_(joints), rate_(1.0 / dt), rounding_(OUTSIDE / dt),
          dt_(dt) {}

    std::vector<double> lower, upper;  // constant ones
    const double* q_measured = nullptr;

    void take(JointLimit limit) {
        if (limit.kind != Bounded::Velocity) return limits_.push_back(std::move(limit));
        for (std::size_t j = 0; j < lower.size(); j++) {
            lower[j] = std::max(lower[j], limit.lower[j]);
            upper[j] = std::min(upper[j], limit.upper[j]);
        }
    }

    // Limits tighten in their order, since braking supports those before it.
    void update(const Model& m, const double* q, const double* v, double* lb, double* ub) {
        const std::size_t n = lower.size();
        double *least = least_.data(), *most = most_.data();
        std::copy_n(lower.data(), n, least);
        std::copy_n(upper.data(), n, most);
        for (const JointLimit& limit : limits_) {
            if (limit.kind == Bounded::Position) {
                keep_place(limit, n, q, least, most);
                continue;
            }
            for (std::size_t j = 0; j < n; j++) {
                if (limit.kind == Bounded::Braking)
                    brake(limit, j, q[j], v[j], least[j], most[j]);
                else if (q_measured && std::isfinite(q_measured[j]))
                    lead(limit, j, q[j] - q_measured[j], least[j], most[j]);
            }
        }
        for (std::size_t j = 0; j < n; j++) {
            lb[m.joints[j].lane] = least[j];
            ub[m.joints[j].lane] = most[j];
        }
    }

  private:
    // Without branches, so that compilers take several joints at once.
    void keep_place(const JointLimit& p, std::size_t n, const double* q, double* __restrict least,
                    double* __restrict most) const {
        const double *low = p.lower.data(), *high = p.upper.data();
        const double rate = rate_, rounding = rounding_, speed = p.speed;
        for (std::size_t j = 0; j < n; j++) {
            const double below = (low[j] - q[j]) * rate, above = (high[j] - q[j]) * rate;
            const double down = below < 0.0 ? below : 0.0, up = above > 0.0 ? above : 0.0;
            const double slowest = least[j] < down ? down : least[j];
            const double quickest = most[j] > up ? up : most[j];
            const double in = below > rounding ? speed : quickest;
            const double out = above < -rounding ? -speed : slowest;
            most[j] = quickest > in ? in : quickest;
            least[j] = slowest < out ? out : slowest;
        }
    }

    // Braking comes before the acceleration limit, other limits come before both.
    void brake(const JointLimit& p, std::size_t j, double q, double v, double& least,
               double& most) const {
        const double step = p.step[j], low = -fastest(q - p.lower[j], step),
                     high = fastest(p.upper[j] - q, step);
        const double slowest = std::min(std::max(v - step, low), high);
        const double quickest = std::min(std::max(v + step, low), high);
        const double floor = least, ceiling = most;
        least = std::min(std::max(slowest, floor), ceiling);
        most = std::min(std::max(quickest, floor), ceiling);
    }

    // On the chords of coopqp.limits.joint_acceleration.
    double fastest(double margin, double step) const {
        const double s = std::max(margin * (2.0 / (step * dt_)), 0.0);
        const double ticks = std::max(std::nearbyint(std::sqrt(s + 0.25)), 1.0);
        return (s / ticks + ticks - 1.0) * (0.5 * step);
    }

    void lead(const JointLimit& p, std::size_t j, double ahead, double& least,
              double& most) const {
        least = std::max(least, std::min((p.lower[j] - ahead) * rate_, 0.0));
        most = std::min(most, std::max((p.upper[j] - ahead) * rate_, 0.0));
    }

    std::vector<JointLimit> limits_;
    std::vector<double> least_, most_;  // of all joints, while they tighten
    double rate_ = 0.0, rounding_ = 0.0, dt_ = 0.0;
};

}  // namespace coopqp
