// The way back of joints that are outside their limits, before all tasks, as
// coopqp.qp_law.limit_recovery: a level of its own, in which each of them wants to be inside again.
#pragma once
#include <algorithm>
#include <cmath>
#include <vector>

#include "cascade.hpp"
#include "shared.hpp"

namespace coopqp {

constexpr double IN_PART = 1.0 - ALL_OF_IT;  // of the Baumgarte stabilisation

class LimitRecovery {
  public:
    LimitRecovery(const Model& model, const Settings& settings, const Rows& rows, const Loops& loops,
            const Limits& limits, const std::vector<std::vector<int>>& kept, Arena& arena)
        : m_(model), s_(settings), limits_(limits), levels_{of_all_joints(model, arena)},
          cascade_(model, settings, rows, loops, limits, kept, levels_, arena) {}

    // The fastest one; Outside where the loops leave none, or one that is not worth all of the drift
    // correction.
    //   damping: for what the last one has pulled at the loops; where they leave hardly a way they
    //   turn quickly along it, so that its steps are the shorter.
    //   b, v: as in Cascade::begin.
    Status find(const double* q, double damping, const double* b, const double* v) {
        [[maybe_unused]] const WithinLimitRecovery here{};
        Level& level = levels_[0];
        level.rows = 0;
        for (int j = 0; j < m_.n(); j++)
            if (const int side = s_.outside(q, j)) take_row(level, q[j], j, side);
        cascade_.begin(b, v);
        const Status status = cascade_.decide(0, LEAST_MOTION + damping);
        if (status != Status::Optimal)
            return status == Status::Infeasible ? Status::Outside : status;
        const bool in_part = cascade_.check().loop_saving() > IN_PART * SCALE_WEIGHT;
        return in_part ? Status::Outside : status;
    }

    // Let nobody take away what was found, but for a little margin, so that tasks stay feasible.
    void keep(const double* q, Limits& limits) const {
        for (int j = 0; j < m_.n(); j++) {
            const int side = s_.outside(q, j), lane = m_.joints[std::size_t(j)].lane;
            const double kept = KEPT * v()[lane];
            if (side > 0) limits.lb[lane] = std::max(limits.lb[lane], std::max(kept, 0.0));
            if (side < 0) limits.ub[lane] = std::min(limits.ub[lane], std::min(kept, 0.0));
        }
    }

    const double* v() const { return cascade_.v(); }  // in lanes
    double pull() const { return cascade_.check().loop_pull(); }

  private:
    static Level of_all_joints(const Model& model, Arena& arena) {
        Level level;
        const std::size_t n = model.joints.size();
        level.rows = int(n);
        for (auto* a : {&level.e, &level.rate, &level.gain, &level.curvature_bound, &level.wanted})
            a->assign(n, 0.0);
        level.weight.assign(n, 1.0);
        level.share.assign(n, -1);
        level.twist.assign(n, 0);
        level.asks_velocity.assign(n, 0);
        level.J = arena.take((n + 1) * std::size_t(model.blocks) * LANES);
        return level;
    }

    // The next row: a joint inside again, no slower than LEAST_RECOVERY; to go to zero at the limit
    // is never to get there.
    void take_row(Level& level, double q, int j, int side) {
        const std::size_t at = std::size_t(j);
        const int lane = m_.joints[at].lane;
        const double out = side > 0 ? s_.lower[at] - q : q - s_.upper[at];
        const double wish = side * std::max(out / s_.dt, LEAST_RECOVERY);
        unit(level.J + std::size_t(level.rows) * std::size_t(m_.blocks) * LANES, lane, m_.blocks);
        level.wanted[std::size_t(level.rows++)] =
            std::min(std::max(wish, limits_.lb[lane]), limits_.ub[lane]);
    }

    const Model& m_;
    const Settings& s_;
    const Limits& limits_;
    std::vector<Level> levels_;
    Cascade cascade_;
};

}  // namespace coopqp
