// What rows that must hold lack, and how far the answer is from where they do.
//
// Rows that nearly depend on each other, or on active limits, hold almost as well far from the
// answer. So a residual says little by itself: it counts by how far v has to go to make it nothing.
#pragma once
#include <cmath>
#include <vector>

#include "constraints.hpp"
#include "hierarchy.hpp"
#include "loops.hpp"
#include "rows.hpp"

namespace coopqp {

class Residuals {
  public:
    Residuals(const Model& model, const Rows& rows, const Loops& loops, Hierarchy& hierarchy,
              const Shares& shares, const std::vector<Level>& levels, Arena& arena)
        : of_loops(std::size_t(6 * std::max(model.loops(), 1))), m_(model), rows_(rows),
          loops_(loops), hierarchy_(hierarchy), shares_(shares), levels_(levels),
          step_(arena.take(rows.stride())), V_(arena.take(TWIST)),
          x_(arena.take(std::size_t(hierarchy.width()))),
          z_(arena.take(std::size_t(hierarchy.width()))) {
        std::size_t rows_in_all = 0;
        for (const Level& level : levels) rows_in_all += std::size_t(level.rows);
        of_rows.resize(rows_in_all);
    }

    // What v lacks of the loops' rows and of those of the levels, in the hierarchy's order.
    std::vector<double> of_loops, of_rows;

    // Length of the least step after which loops, the rows that the first coordinates are of, and
    // active limits all hold, by the factors; none where all hold to the last digits.
    //   gap: what v lacks of all rows but limits.
    double distance(int first, double gap, const double* v, Constraints& c) {
        if (gap <= LAST_DIGITS && limits_hold(v, c)) return 0.0;
        loops_.particular(of_loops.data(), step_);
        if (first) restore_decided(first);
        if (c.nearest.active) restore_limits(v, c);
        return std::sqrt(dot(step_, step_, m_.blocks));
    }

    // That step.
    const double* step() const { return step_; }

  private:
    bool limits_hold(const double* v, const Constraints& c) {
        if (!c.nearest.active) return true;
        clear(step_, m_.blocks);
        clear(V_, 2);
        bool hold = true;
        for (int i = 0; i < c.nearest.active; i++) hold &= std::fabs(lacks(i, v, c)) <= LAST_DIGITS;
        return hold;
    }

    void restore_decided(int first) {
        rows_.object_twist(step_, V_);
        clear(x_, hierarchy_.blocks());
        for (int k = 0; k < first; k++) {
            const int s = hierarchy_.pivot_row(k);
            const double* row = hierarchy_.row(s);
            double rest = lacks(s);
            for (int j = 0; j < k; j++) rest -= row[j] * x_[j];
            x_[k] = rest / row[k];
        }
        hierarchy_.to_z(x_, z_);
        add_rows(step_, loops_.Z, int(rows_.stride()), loops_.free, z_, m_.blocks);
    }

    void restore_limits(const double* v, Constraints& c) {
        rows_.object_twist(step_, V_);
        add(step_, c.nearest.restore([&](int i) { return lacks(i, v, c); }), 1.0, m_.blocks);
    }

    // What a row of the hierarchy still lacks after the step so far.
    double lacks(int s) const {
        int level = 0, own = s;
        while (own >= levels_[std::size_t(level)].rows) own -= levels_[std::size_t(level++)].rows;
        return of_rows[std::size_t(s)] - rows_.times(levels_[std::size_t(level)], own, step_, V_);
    }

    // The same of an active limit.
    double lacks(int i, const double* v, const Constraints& c) const {
        const int row = c.nearest.row(i), n = m_.blocks * LANES;
        const bool above = c.nearest.side(i) > 0.0;
        if (row < n) return (above ? c.limits.ub[row] : c.limits.lb[row]) - v[row] - step_[row];
        if (row < c.share_row(0)) {
            const double* G = c.limits.G + std::size_t(row - n) * rows_.stride();
            return c.limits.h[std::size_t(row - n)] - dot(G, v, m_.blocks) - dot(G, step_, m_.blocks);
        }
        if (row < c.spare_row(0)) return (above ? 1.0 : 0.0) - shares_.share(row - c.share_row(0));
        return lacks(row - c.spare_row(0));
    }

    const Model& m_;
    const Rows& rows_;
    const Loops& loops_;
    Hierarchy& hierarchy_;
    const Shares& shares_;
    const std::vector<Level>& levels_;
    double *step_, *V_, *x_, *z_;
};

}  // namespace coopqp
