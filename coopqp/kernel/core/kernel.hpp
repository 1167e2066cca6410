// One verified tick: kinematics, loops, levels, the look ahead.
#pragma once
#include <algorithm>
#include <cmath>
#include <memory>
#include <stdexcept>
#include <vector>

#include "ahead.hpp"
#include "check.hpp"
#include "damping.hpp"
#include "faults.hpp"
#include "hierarchy.hpp"
#include "least_distance.hpp"
#include "loops.hpp"
#include "problem.hpp"
#include "rows.hpp"
#include "shares.hpp"
#include "small.hpp"

namespace coopqp {

constexpr double INSIDE = 1e-12;  // overrun of a limit that is left as it is [rad/s]

class Kernel {
  public:
    Kernel(std::unique_ptr<Arena> arena, std::unique_ptr<Model> model,
           std::vector<std::vector<int>> kept, Settings settings, std::vector<Level> given)
        : arena_(std::move(arena)),
          m_(std::move(model)),
          s_(std::move(settings)),
          kept_(std::move(kept)),
          levels(std::move(given)),
          kinematics(*m_),
          ahead_(*m_, s_),
          rows_(*m_),
          loops_(make_loops(*m_, kept_, *arena_)),
          hierarchy_(loops_->free, most_rows(), *arena_),
          shares_(levels[0], hierarchy_, stride(), *arena_),
          damping_(rows_, s_, levels, *arena_),
          nearest_(stride() + padded(s_.inequalities) + padded(shares_.count()) +
                       padded(levels[0].exact),
                   loops_->free + shares_.count(), *arena_),
          lb(arena_->take(std::size_t(stride()))),
          ub(arena_->take(std::size_t(stride()))),
          G(arena_->take(std::size_t(stride() * (s_.inequalities + 1)))),
          h(std::size_t(s_.inequalities)),
          check_(*m_, rows_, *loops_, hierarchy_, shares_, s_, levels, kept_, *arena_),
          b_(std::size_t(6 * std::max(m_->loops(), 1))),
          v_(arena_->take(std::size_t(stride()))),
          before_(arena_->take(std::size_t(stride()))),
          last_(arena_->take(std::size_t(stride()))),
          t_(arena_->take(std::size_t(stride()))),
          W_(arena_->take(std::size_t(TWIST * hierarchy_.width()))),
          w_(arena_->take(std::size_t(hierarchy_.width()))),
          x_(arena_->take(std::size_t(hierarchy_.width()))),
          z_(arena_->take(std::size_t(hierarchy_.width()))),
          X_(arena_->take(std::size_t(loops_->free + 1) * std::size_t(hierarchy_.width()))),
          residual_(std::size_t(most_rows() + 1)),
          small_(most_rows() + 1, std::min(most_rows(), loops_->free) + 1, *arena_),
          turn_(std::size_t(shares_.count() + 1)),
          pulls_(levels.size()) {}

    // Kinematics of q; what follows from them is written to the bound arrays.
    Status update(double t) {
        const double* q = bound.q;
        double size = t;
        for (int j = 0; j < m_->n(); j++) size += q[j] * q[j] + bound.v_last[j] * bound.v_last[j];
        if (!std::isfinite(size)) return Status::NotFinite;
        kinematics.place(q);
        kinematics.measure();
        kinematics.differentiate();
        std::copy(kinematics.p_WO, kinematics.p_WO + 3, bound.p_WO);
        std::copy(kinematics.R_WO, kinematics.R_WO + 9, bound.R_WO);
        for (std::size_t i = 0; i < kinematics.loop_error.size(); i++) {
            bound.loop_error[i] = kinematics.loop_error[i];
            bound.drift[i] = kinematics.loop_error[i] - bound.gap[i];
        }
        std::copy(q, q + m_->n(), bound.q_seen);
        return Status::Optimal;
    }

    // Decide v from the kinematics, tasks and limits as they stand, with joints inside their limits.
    Status solve() {
        return s_.outside(bound.q) ? Status::Outside : solve(ahead_.kappa(bound.drift));
    }

    // The same with a drift gain, wherever joints are: limits say how they come back.
    Status solve(double kappa) {
        for (int j = 0; j < m_->n(); j++)
            last_[m_->joints[std::size_t(j)].lane] = bound.v_last[j];
        damping_.begin(last_);
        aim_loops(kappa);
        if (!fault(Fault::StaleFactor) && !loops_->factor()) return Status::Singular;
        if (fault(Fault::WrongDirection)) loops_->Z[0] += 1e-3;
        loops_->particular(b_.data(), v_);
        if (fault(Fault::WrongSide)) v_[0] += 1e-4;
        see_object();
        hierarchy_.forget();
        hierarchy_.begin();
        for (std::size_t l = 0; l < levels.size(); l++) {
            const Status status = solve_level(int(l));
            if (status != Status::Optimal) return status;
        }
        const double share = ahead_.shorten(bound.q, bound.gap, bound.drift, v_);
        if (share == 0.0) return Status::Opens;
        for (int j = 0; j < m_->n(); j++) bound.v[j] = v_[m_->joints[std::size_t(j)].lane];
        for (std::size_t l = 1; l < levels.size(); l++) bound.later_pulls[l - 1] = pulls_[l];
        if (levels[0].exact) bound.hard_pull[0] = pulls_[0];
        for (int k = 0; k < shares_.count(); k++) bound.missing[k] = 1.0 - shares_.share(k);
        return share < 1.0 ? Status::Shortened : Status::Optimal;
    }

    // For tests: e, J over the joints and rate of each row.
    std::vector<double> rows_of(int l) const { return rows_.listed(levels[std::size_t(l)], t_); }

    int stride() const { return m_->blocks * LANES; }
    const Model& model() const { return *m_; }
    const Settings& settings() const { return s_; }
    const Rows& rows() const { return rows_; }
    Check& check() { return check_; }

  private:
    std::unique_ptr<Arena> arena_;
    std::unique_ptr<Model> m_;
    Settings s_;
    std::vector<std::vector<int>> kept_;

  public:
    std::vector<Level> levels;
    Kinematics kinematics;
    Bound bound;

  private:
    int most_rows() const {
        int count = 0;
        for (const Level& level : levels) count += level.rows;
        return count;
    }

    // b = -kappa e
    void aim_loops(double kappa) {
        std::size_t at = 0;
        for (std::size_t i = 0; i < kept_.size(); i++)
            for (int r : kept_[i]) b_[at++] = -kappa * bound.drift[6 * i + std::size_t(r)];
        check_.aim(b_.data());
    }

    // The object's twist along each column of Z. All arms that hold it move it alike there, so arm 0
    // speaks for all.
    void see_object() {
        for (int z = 0; z < loops_->free; z++)
            rows_.twist(0, loops_->Z + std::size_t(z * stride()), W_ + TWIST * z);
    }

    Status solve_level(int l) {
        Level& level = levels[std::size_t(l)];
        const int before = hierarchy_.rows;
        for (std::size_t s = 0; s < std::size_t(level.rows); s++)
            level.wanted[s] = level.rate[s] - level.gain[s] * level.e[s];
        if (l > 0 && !hierarchy_.singular_values() && !leave_noise(l)) return Status::Singular;
        write_rows(level);
        if (fault(Fault::WrongRow) && level.rows) hierarchy_.row(hierarchy_.rows)[0] += 1e-3;
        const int decided = hierarchy_.decided;
        hierarchy_.append(level.rows);
        const double d = s_.damping + damping_.of(l, level, bound);
        copy(before_, v_, m_->blocks);
        miss(l, level);
        const int first = decided + (level.exact ? take_exact(level, d) : 0);
        take_soft(l, before, first, d);
        if (fault(Fault::WrongAnswer)) add(v_, loops_->Z, 1e-4, m_->blocks);
        const Status status = bring_inside(l, first, d + level.joint_weight);
        if (status == Status::Infeasible || fault(Fault::FalseProof))
            return l == 0 && check_.excludes(first, nearest_, lb, ub, G, h) ? Status::Infeasible
                                                                        : Status::Unproven;
        if (status != Status::Optimal) return status;
        if (fault(Fault::WrongMultiplier)) nearest_.spoil();
        if (fault(Fault::ActiveForgotten)) nearest_.active = 0;
        const Outcome outcome = check_.judge(l, first, d, v_, before_, nearest_, lb, ub, G, h);
        pulls_[std::size_t(l)] = outcome.pull;
        return outcome.status;
    }

    // Rows of a level in coordinates of z, appended to those of the levels before.
    void write_rows(const Level& level) {
        for (int s = 0; s < level.rows; s++) {
            double* row = hierarchy_.row(hierarchy_.rows + s);
            if (level.twist[std::size_t(s)])
                multiply(row, W_, TWIST, loops_->free, level.T + TWIST * s, Blocks<2>{});
            else
                multiply(row, loops_->Z, stride(), loops_->free,
                         level.J + std::size_t(s * stride()), m_->blocks);
        }
    }

    // Decide the rows of the levels before l anew without those that, at a singular pose, are
    // noise: these would freeze another motion in each tick. Whether nothing else is left.
    bool leave_noise(int l) {
        for (int left = 0; left < most_rows() && hierarchy_.decided > 0; left++) {
            hierarchy_.leave_out_smallest();
            hierarchy_.begin();
            for (int k = 0; k < l; k++) {
                write_rows(levels[std::size_t(k)]);
                hierarchy_.append(levels[std::size_t(k)].rows);
            }
            if (hierarchy_.singular_values()) return true;
        }
        return false;
    }

    // What v lacks of each row.
    void miss(int l, const Level& level) {
        if (l == 0) rows_.object_twist(v_, check_.V);  // later v is as it was judged
        for (int s = 0; s < level.rows; s++)
            residual_[std::size_t(s)] =
                level.wanted[std::size_t(s)] - rows_.times(level, s, v_, check_.V);
    }

    // Do what exact rows ask for; returns how many coordinates that takes.
    int take_exact(const Level& level, double d) {
        const int count = shares_.take(level, residual_.data(), x_, d);
        for (int k = 0; k < level.shares; k++) {
            clear(shares_.way(k), m_->blocks);
            move(shares_.coordinates(k), shares_.way(k));
        }
        move(x_, v_);
        for (int s = level.exact; s < level.rows; s++)
            for (int k = 0; k < count; k++)
                residual_[std::size_t(s)] -= hierarchy_.row(s)[k] * x_[k];
        return count;
    }

    // The optimum of soft rows, joint objectives and damping where no limit binds.
    void take_soft(int l, int before, int first, double d) {
        const Level& level = levels[std::size_t(l)];
        const int own = hierarchy_.decided - first, soft = level.rows - level.exact;
        const double curvature = d + level.joint_weight;
        const double* c = nullptr;
        if (l > 0 || level.joint_weight > 0.0) {
            for (int b = 0; b < m_->blocks; b++)
                lanes(t_)[b] = -lanes(v_)[b] * curvature;
            if (level.joint_weight > 0.0) add(t_, level.wish, 1.0, m_->blocks);
            reduce(t_, z_);
            c = z_;
        }
        small_.open(soft, own);
        for (int s = 0; s < soft; s++) {
            const double root = std::sqrt(level.weight[std::size_t(level.exact + s)]);
            const double* L = hierarchy_.row(before + level.exact + s) + first;
            for (int k = 0; k < own; k++) small_.A(s, k) = root * L[k];
            small_.b(s) = root * residual_[std::size_t(level.exact + s)];
        }
        small_.solve(curvature, c ? c + first : nullptr);
        clear(x_, hierarchy_.blocks());
        for (int k = 0; k < own; k++) x_[first + k] = small_.x(k);
        if (c)
            for (int i = first + own; i < loops_->free; i++) x_[i] = c[i] / curvature;
        move(x_, v_);
    }

    // v += Z V' y
    void move(const double* y, double* v) const {
        hierarchy_.to_z(y, w_);
        add_rows(v, loops_->Z, stride(), loops_->free, w_, m_->blocks);
    }

    // y = V Z' t
    void reduce(const double* t, double* y) {
        multiply(w_, loops_->Z, stride(), loops_->free, t, m_->blocks);
        hierarchy_.to_y(w_, y);
    }

    // Change v and the shares by as little as limits ask for, in the metric of the level's cost.
    Status bring_inside(int l, int first, double curvature) {
        nearest_.active = 0;
        const bool keeps = inside(), agrees = agree(l);
        if ((keeps && agrees) || fault(Fault::LimitsForgotten)) return Status::Optimal;
        const int shares = l == 0 ? shares_.count() : 0, n = stride(), p = s_.inequalities;
        const int own = hierarchy_.decided - first, K = loops_->free - first;
        for (int b = 0; b < m_->blocks; b++) {
            lanes(nearest_.lower)[b] = lanes(lb)[b] - lanes(v_)[b];
            lanes(nearest_.upper)[b] = lanes(ub)[b] - lanes(v_)[b];
        }
        for (int i = 0; i < p; i++) nearest_.lower[n + i] = -1e300;
        for (int a = 0; a < padded(shares + K); a++)
            clear(nearest_.column(a), nearest_.stride() / LANES);
        for (int a = 0; a < shares; a++) share_column(a);
        for (int a = 0; a < K; a++) {
            level_direction(a, first, own, curvature);
            add_rows(nearest_.column(shares + a), loops_->Z, n, loops_->free,
                     X_ + a * hierarchy_.width(), m_->blocks);
        }
        for (int i = 0; i < p; i++)
            for (int a = 0; a < shares + K; a++)
                nearest_.column(a)[n + i] = dot(G + std::size_t(i) * std::size_t(n),
                                                nearest_.column(a), m_->blocks);
        Status status = nearest_.solve(shares + K);
        if (status == Status::Infeasible && l == 0 && levels[0].exact > first) {
            nearest_.widen(spare_row(0), levels[0].exact, CONSISTENT);
            status = nearest_.solve(shares + K);
        }
        if (status != Status::Optimal) return status;
        add_rows(v_, nearest_.M, nearest_.stride(), shares + K, nearest_.u, m_->blocks);
        for (int k = 0; k < shares; k++)
            for (int a = 0; a < shares; a++)
                shares_.share(k) += nearest_.column(a)[share_row(k)] * nearest_.u[a];
        return status;
    }

    // The a-th direction, in coordinates of z, in which the level's cost bends by one: of its own
    // coordinates from `first` on, then of those that it leaves free.
    void level_direction(int a, int first, int own, double curvature) {
        const int width = hierarchy_.width(), blocks = hierarchy_.blocks();
        double* X = X_ + a * width;
        copy(X, hierarchy_.V(first + a), blocks);
        for (int j = 0; j < a && a < own; j++) add(X, X_ + j * width, -small_.R(j, a), blocks);
        const double scale = 1.0 / (a < own ? small_.R(a, a) : std::sqrt(curvature));
        for (int b = 0; b < blocks; b++) lanes(X)[b] *= scale;
    }

    // Whether all limits hold as it is; what inequalities leave is written for bring_inside.
    bool inside() {
        bool inside = true;
        const v4 *lo = lanes(lb), *hi = lanes(ub), *x = lanes(v_);
        v4 over = v4{};
        for (int b = 0; b < m_->blocks; b++) over = larger(over, larger(lo[b] - x[b], x[b] - hi[b]));
        for (int k = 0; k < LANES; k++) inside &= over[k] <= INSIDE;
        double* slack = nearest_.upper + stride();
        for (int i = 0; i < s_.inequalities; i++) {
            slack[i] = h[std::size_t(i)] -
                       dot(G + std::size_t(i) * std::size_t(stride()), v_, m_->blocks);
            inside &= slack[i] >= -INSIDE;
        }
        for (int k = 0; k < shares_.count(); k++)
            inside &= shares_.share(k) >= 0.0 && shares_.share(k) <= 1.0;
        return inside;
    }

    // What rows of the first level lack that depend on others, and whether that is nothing.
    bool agree(int l) {
        bool agree = true;
        for (int s = 0; s < levels[0].exact; s++) {
            const double lacks = l == 0 ? shares_.lacks(s) : 0.0;
            nearest_.lower[spare_row(s)] = nearest_.upper[spare_row(s)] = -lacks;
            agree &= std::fabs(lacks) <= INSIDE;
        }
        for (int k = 0; l > 0 && k < shares_.count(); k++)
            nearest_.lower[share_row(k)] = nearest_.upper[share_row(k)] = 0.0;
        return agree;
    }

    // Which constraint keeps a share between 0 and 1.
    int share_row(int k) const { return stride() + padded(s_.inequalities) + k; }

    // Which constraint keeps a row that depends on others.
    int spare_row(int s) const { return share_row(0) + padded(shares_.count()) + s; }

    // How all shares, and the joints with them, go along their a-th direction.
    void share_column(int a) {
        double* column = nearest_.column(a);
        shares_.direction(a, turn_.data());
        for (int k = 0; k < shares_.count(); k++) {
            column[share_row(k)] = turn_[std::size_t(k)];
            nearest_.lower[share_row(k)] = -shares_.share(k);
            nearest_.upper[share_row(k)] = 1.0 - shares_.share(k);
            add(column, shares_.way(k), turn_[std::size_t(k)], m_->blocks);
        }
        for (int s = 0; s < levels[0].exact; s++)
            for (int k = 0; k < shares_.count(); k++)
                column[spare_row(s)] += shares_.asks(s, k) * turn_[std::size_t(k)];
    }

    Ahead ahead_;
    Rows rows_;
    std::unique_ptr<Loops> loops_;
    Hierarchy hierarchy_;
    Shares shares_;
    StepDamping damping_;
    LeastDistance nearest_;

  public:
    double *lb, *ub;        // in lanes
    double* G;              // (p, lanes)
    std::vector<double> h;

  private:
    Check check_;
    std::vector<double> b_;
    double *v_, *before_, *last_, *t_, *W_, *w_, *x_, *z_, *X_;
    std::vector<double> residual_;
    SmallLeastSquares small_;
    std::vector<double> turn_, pulls_;
};

}  // namespace coopqp
