// Limits on each joint's velocity, as coopqp.limits has them.
#pragma once
#include <algorithm>
#include <cmath>
#include <vector>

#include "model.hpp"

namespace coopqp {

struct PositionLimit {
    std::vector<double> lower, upper;
    double rate, recovery, rounding;  // 1 / time, way back [rad/s], ROUNDING / dt
};

class Bounds {
  public:
    std::vector<double> lower, upper;  // constant ones
    std::vector<PositionLimit> positions;

    void update(const Model& m, const double* q, double* lb, double* ub) const {
        const std::size_t n = m.joints.size();
        for (std::size_t j = 0; j < n; j++) {
            double least = lower[j], most = upper[j];
            for (const PositionLimit& p : positions) {
                const double below = (p.lower[j] - q[j]) * p.rate, above = (p.upper[j] - q[j]) * p.rate;
                least = std::max(least, std::min(below, 0.0));
                most = std::min(most, std::max(above, 0.0));
                if (below > p.rounding) most = std::min(most, p.recovery);
                if (above < -p.rounding) least = std::max(least, -p.recovery);
            }
            lb[m.joints[j].lane] = least;
            ub[m.joints[j].lane] = most;
        }
    }
};

}  // namespace coopqp
