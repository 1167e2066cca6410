// Limits on the object's twist as rows G v <= h: its speed, and planes that points of it must not
// pass, as coopqp.limits.object_speed and coopqp.limits.workspace have them.
#pragma once
#include <vector>

#include "rows.hpp"
#include "shared.hpp"

namespace coopqp {

struct TwistLimit {
    int at;                        // its first row
    std::vector<double> bounds;    // of each component's size; none for planes
    std::vector<int> components;   // of the twist
    std::vector<double> points;    // of the object, in its frame
    double normal[3], offset, gain;  // of the plane, n'p >= offset
};

class TwistLimits {
  public:
    std::vector<TwistLimit> limits;

    // Fill rows of G, in lanes, and of h.
    void update(const Kinematics& k, const Model& m, const Rows& rows, double* G,
                std::vector<double>& h) const {
        for (const TwistLimit& limit : limits) {
            const std::size_t stride = rows.stride();
            double* row = G + std::size_t(limit.at) * stride;
            double* side = h.data() + limit.at;
            const std::size_t count = limit.bounds.size();
            for (std::size_t i = 0; i < 2 * count; i++, row += stride) {
                double unit[6] = {0, 0, 0, 0, 0, 0};
                unit[limit.components[i % count]] = i < count ? 1.0 : -1.0;
                side[i] = limit.bounds[i % count];
                fill(m, rows, unit, row);
            }
            for (std::size_t i = 0; 3 * i < limit.points.size(); i++, row += stride)
                side[i] = keep_off(limit, &limit.points[3 * i], k, m, rows, row);
        }
    }

  private:
    static void fill(const Model& m, const Rows& rows, const double* twist, double* row) {
        clear(row, m.blocks);
        rows.pull_object(twist, row);
    }

    // The point's distance d from the plane may shrink by gain d, coopqp.limit.damp.
    static double keep_off(const TwistLimit& plane, const double* p_O, const Kinematics& k,
                           const Model& m, const Rows& rows, double* row) {
        double lever[3], p[3], twist[6];
        times3(k.R_WO, p_O, lever);
        for (int i = 0; i < 3; i++) p[i] = k.p_WO[i] + lever[i];
        cross3(plane.normal, lever, twist + 3);
        for (int i = 0; i < 3; i++) twist[i] = -plane.normal[i];
        fill(m, rows, twist, row);
        const double d = dot3(plane.normal, p) - plane.offset;
        return d < -SHALLOW ? 0.0 : plane.gain * d;
    }
};

}  // namespace coopqp
