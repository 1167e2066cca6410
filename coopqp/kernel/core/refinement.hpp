// The optimum of exact rows in twice the digits, where rows nearly depend on each other and their
// multipliers have too few.
//
// Over x = [v; shares] the cost is |x - best|^2 with weights D alone, and the optimum, with the rows C
// that hold in it, of loops, tasks, and active limits,
//
//     x = best - D^-1 C' y,   C D^-1 C' y = C best - b
//
// This matrix squares the condition of the rows, which twice the digits bear.
#pragma once
#include <algorithm>
#include <cmath>
#include <vector>

#include "constraints.hpp"
#include "hierarchy.hpp"
#include "rows.hpp"
#include "twofold.hpp"

namespace coopqp {

class Refinement {
  public:
    // Of the first level.
    Refinement(const Model& model, const Rows& rows, const Hierarchy& hierarchy, Shares& shares,
               const Level& level, const std::vector<std::vector<int>>& kept)
        : m_(model), rows_(rows), hierarchy_(hierarchy), shares_(shares), level_(level), kept_(kept) {}

    // Put v, in lanes, and the shares at the optimum; false where its active limits are not found.
    //   b: that loops move by. d, first: as in Check::judge. c: with limits that may be active.
    bool find(const double* b, double d, int first, const Constraints& c, double* v) {
        open(d);
        take_loops(b);
        for (int k = 0; k < first; k++) take_task(hierarchy_.pivot_row(k));
        for (int i = 0; i < c.nearest.active; i++) take_limit(c, c.nearest.row(i), c.nearest.side(i));
        for (int change = 0; change < MOST_CHANGED; change++) {
            if (!solve()) return false;
            if (drop_wrong() || add_exceeded(c)) continue;
            for (std::size_t j = 0; j < joints(); j++) v[m_.joints[j].lane] = x_[j].hi;
            for (std::size_t k = 0; k < count_shares(); k++) shares_.share(int(k)) = x_[joints() + k].hi;
            return true;
        }
        return false;
    }

    // By how much a certificate in single digits may be off about the optimum found last, from the last
    // digits of all that pulls at joints and shares.
    double digits() {
        const double mu = std::min(D_[0], SCALE_WEIGHT);
        double squares = 0.0;
        for (std::size_t j = 0; j < width_; j++) {
            double size = 0.0;
            for (std::size_t i = 0; i < height_; i++) size += std::fabs(C(i, j).hi * y_[i].hi);
            squares += size * size / (mu * (j < joints() ? mu : SCALE_WEIGHT));
        }
        return ROUNDED * std::sqrt(squares);
    }

  private:
    static constexpr int MOST_CHANGED = 20;
    static constexpr double SINGULAR = 1e-27;  // share of a row's square that others leave of it
    static constexpr double ROUNDED = 1.4e-14;  // share of a sum that its rounding may be

    std::size_t joints() const { return m_.joints.size(); }
    std::size_t count_shares() const { return std::size_t(shares_.count()); }
    Twofold& C(std::size_t i, std::size_t j) { return C_[i * width_ + j]; }
    Twofold& L(std::size_t i, std::size_t j) { return L_[i * height_ + j]; }

    void open(double d) {
        width_ = joints() + count_shares();
        height_ = 0;
        C_.clear();
        b_.clear();
        limit_.clear();
        D_.assign(width_, d);
        best_.assign(width_, 0.0);
        for (std::size_t k = 0; k < count_shares(); k++) {
            D_[joints() + k] = SCALE_WEIGHT;
            best_[joints() + k] = level_.best_share(int(k));
        }
    }

    // A new row with nothing in it; limit: 1 at an upper one, -1 at a lower one, 0 where it must hold.
    std::size_t new_row(double limit = 0.0) {
        C_.resize(C_.size() + width_);
        b_.emplace_back();
        limit_.push_back(limit);
        return height_++;
    }

    // Row r of an arm's Jacobian, times a factor, for row i.
    void add_arm(std::size_t i, int arm, int r, const Twofold& factor) {
        const Arm& a = m_.arms[std::size_t(arm)];
        for (std::size_t j = 0; j < a.base.size() + a.own.size(); j++) {
            const bool own = j >= a.base.size();
            const int joint = own ? a.own[j - a.base.size()] : a.base[j];
            C(i, std::size_t(joint)) += factor * a.columns[TWIST * j + std::size_t(r)];
        }
    }

    void take_loops(const double* b) {
        for (int a = 1; a < m_.holding; a++)
            for (int r : kept_[std::size_t(a - 1)]) {
                const std::size_t i = new_row();
                add_arm(i, a, r, 1.0);
                add_arm(i, 0, r, -1.0);
                b_[i] = *b++;
            }
    }

    //   limit, width: of a row that gives way by so much at a side.
    void take_task(int s, double limit = 0.0, double width = 0.0) {
        const std::size_t i = new_row(limit), at = std::size_t(s);
        for (std::size_t j = 0; j < joints() && !level_.twist[at]; j++)
            C(i, j) = level_.J[at * rows_.stride() + std::size_t(m_.joints[j].lane)];
        for (std::size_t a = 0; a < m_.arms.size() && level_.twist[at]; a++)
            for (int r = 0; m_.arms[a].alpha != 0.0 && r < 6; r++)
                add_arm(i, int(a), r, Twofold::product(m_.arms[a].alpha, level_.T[TWIST * s + r]));
        b_[i] = Twofold(level_.share[at] < 0 ? level_.wanted[at] : 0.0) + limit * width;
        for (std::size_t k = 0; k < count_shares(); k++) C(i, joints() + k) = -level_.asks(s, int(k));
    }

    // A row of the constraints at one of its sides, as they number it.
    void take_limit(const Constraints& c, int row, double side) {
        const int n = m_.blocks * LANES;
        if (row >= c.spare_row(0)) return take_task(row - c.spare_row(0), -side, c.width());
        const std::size_t i = new_row(side);
        if (row < n) {
            for (std::size_t j = 0; j < joints(); j++)
                if (m_.joints[j].lane == row) C(i, j) = 1.0;
            b_[i] = side > 0.0 ? c.limits.ub[row] : c.limits.lb[row];
        } else if (row < c.share_row(0)) {
            const double* G = c.limits.G + std::size_t(row - n) * rows_.stride();
            for (std::size_t j = 0; j < joints(); j++) C(i, j) = G[m_.joints[j].lane];
            b_[i] = c.limits.h[std::size_t(row - n)];
        } else {
            C(i, joints() + std::size_t(row - c.share_row(0))) = 1.0;
            b_[i] = side > 0.0 ? 1.0 : 0.0;
        }
    }

    // x and y with the rows as they are, in sums whose next terms come one after the other, so that none
    // waits for the one before it; false where they depend on each other.
    bool solve() {
        L_.assign(height_ * height_, {});
        for (std::size_t i = 0; i < height_; i++) {
            scaled_.resize(width_);
            for (std::size_t j = 0; j < width_; j++)
                scaled_[j] = C(i, j).hi != 0.0 ? C(i, j) / D_[j] : Twofold();
            for (std::size_t j = 0; j < width_; j++)
                for (std::size_t k = i; k < height_ && scaled_[j].hi != 0.0; k++)
                    if (C(k, j).hi != 0.0) L(k, i) += C(k, j) * scaled_[j];
        }
        if (!factor()) return false;
        y_.assign(height_, {});
        x_ = best_;
        for (int pass = 0; pass < 2; pass++) {
            side_.resize(height_);
            for (std::size_t i = 0; i < height_; i++) side_[i] = -b_[i];
            for (std::size_t j = 0; j < width_; j++)
                for (std::size_t i = 0; i < height_; i++)
                    if (C(i, j).hi != 0.0) side_[i] += C(i, j) * x_[j];
            back(side_);
            pulls_.assign(width_, {});
            for (std::size_t i = 0; i < height_; i++) {
                y_[i] += side_[i];
                for (std::size_t j = 0; j < width_; j++)
                    if (C(i, j).hi != 0.0) pulls_[j] += C(i, j) * y_[i];
            }
            for (std::size_t j = 0; j < width_; j++) x_[j] = best_[j] - pulls_[j] / D_[j];
        }
        return true;
    }

    // L E L', with E on the diagonal.
    bool factor() {
        scaled_.resize(std::max(width_, height_));
        by_.resize(height_);
        for (std::size_t k = 0; k < height_; k++) scaled_[k] = L(k, k);
        for (std::size_t k = 0; k < height_; k++) {
            if (!(L(k, k).hi > SINGULAR * scaled_[k].hi)) return false;
            for (std::size_t i = k + 1; i < height_; i++) {
                by_[i] = L(i, k) / L(k, k);
                for (std::size_t j = i; j < height_; j++) L(j, i) -= by_[i] * L(j, k);
            }
            for (std::size_t i = k + 1; i < height_; i++) L(i, k) = by_[i];
        }
        return true;
    }

    void back(std::vector<Twofold>& r) {
        for (std::size_t k = 0; k < height_; k++)
            for (std::size_t i = k + 1; i < height_; i++) r[i] -= L(i, k) * r[k];
        for (std::size_t i = 0; i < height_; i++) r[i] = r[i] / L(i, i);
        for (std::size_t i = height_; i-- > 0;)
            for (std::size_t k = i + 1; k < height_; k++) r[i] -= L(k, i) * r[k];
    }

    // Leave out the limit that pulls most, where one does.
    bool drop_wrong() {
        std::size_t worst = height_;
        for (std::size_t i = 0; i < height_; i++)
            if (limit_[i] * y_[i].hi < (worst < height_ ? limit_[worst] * y_[worst].hi : 0.0)) worst = i;
        if (worst == height_) return false;
        const auto row = C_.begin() + std::ptrdiff_t(worst * width_);
        C_.erase(row, row + std::ptrdiff_t(width_));
        b_.erase(b_.begin() + std::ptrdiff_t(worst));
        limit_.erase(limit_.begin() + std::ptrdiff_t(worst));
        height_--;
        return true;
    }

    // Take up the limit that is exceeded most, where one is.
    bool add_exceeded(const Constraints& c) {
        double most = LAST_DIGITS, side = 0.0;
        int worst = -1;
        const auto see = [&](int row, const Twofold& over, double on) {
            if (!(over.hi > most)) return;
            most = over.hi;
            worst = row;
            side = on;
        };
        for (std::size_t j = 0; j < joints(); j++) {
            const int lane = m_.joints[j].lane;
            see(lane, x_[j] - c.limits.ub[lane], 1.0);
            see(lane, Twofold(c.limits.lb[lane]) - x_[j], -1.0);
        }
        for (std::size_t i = 0; i < c.limits.h.size(); i++) {
            Twofold over = -c.limits.h[i];
            for (std::size_t j = 0; j < joints(); j++)
                over += x_[j] * c.limits.G[i * rows_.stride() + std::size_t(m_.joints[j].lane)];
            see(m_.blocks * LANES + int(i), over, 1.0);
        }
        for (std::size_t k = 0; k < count_shares(); k++) {
            see(c.share_row(int(k)), x_[joints() + k] - 1.0, 1.0);
            see(c.share_row(int(k)), -x_[joints() + k], -1.0);
        }
        if (worst >= 0) take_limit(c, worst, side);
        return worst >= 0;
    }

    const Model& m_;
    const Rows& rows_;
    const Hierarchy& hierarchy_;
    Shares& shares_;
    const Level& level_;
    const std::vector<std::vector<int>>& kept_;
    std::size_t width_ = 0, height_ = 0;  // columns and rows of C
    std::vector<Twofold> C_, b_, L_, x_, y_, best_, scaled_, by_, side_, pulls_;
    std::vector<double> D_, limit_;
};

}  // namespace coopqp
