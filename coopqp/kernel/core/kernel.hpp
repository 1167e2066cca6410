// One verified tick: kinematics, loops, levels, the look ahead.
#pragma once
#include <algorithm>
#include <cmath>
#include <memory>
#include <stdexcept>
#include <vector>

#include "ahead.hpp"
#include "check.hpp"
#include "constraints.hpp"
#include "damping.hpp"
#include "faults.hpp"
#include "hierarchy.hpp"
#include "loops.hpp"
#include "problem.hpp"
#include "rows.hpp"
#include "shares.hpp"
#include "small.hpp"

namespace coopqp {

// By how much a certificate may be short of zero before the answer is refined: as far as the kernel
// and the plain law agree [rad/s].
constexpr double SHORT_OF_DIGITS = 1e-10;

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
          constraints(stride(), s_.inequalities, loops_->free, levels[0], shares_, *arena_),
          check_(*m_, rows_, *loops_, hierarchy_, shares_, s_, levels, kept_, *arena_),
          b_(std::size_t(6 * std::max(m_->loops(), 1))),
          v_(arena_->take(std::size_t(stride()))),
          before_(arena_->take(std::size_t(stride()))),
          kept_v_(arena_->take(std::size_t(stride()))),
          V_(arena_->take(TWIST)),
          kept_V_(arena_->take(TWIST)),
          last_(arena_->take(std::size_t(stride()))),
          t_(arena_->take(std::size_t(stride()))),
          W_(arena_->take(std::size_t(TWIST * hierarchy_.width()))),
          w_(arena_->take(std::size_t(hierarchy_.width()))),
          x_(arena_->take(std::size_t(hierarchy_.width()))),
          z_(arena_->take(std::size_t(hierarchy_.width()))),
          X_(arena_->take(std::size_t(loops_->free + 1) * std::size_t(hierarchy_.width()))),
          residual_(std::size_t(most_rows() + 1)),
          small_(most_rows() + 1, std::min(most_rows(), loops_->free) + 1, *arena_),
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
        damping_.begin(last_, bound.swing[0]);
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
        bound.swing[0] = damping_.swing_after(v_, bound.swing[0], m_->blocks);
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
            return l == 0 && check_.excludes(first, constraints) ? Status::Infeasible
                                                                 : Status::Unproven;
        if (status != Status::Optimal) return status;
        if (fault(Fault::WrongMultiplier)) constraints.nearest.spoil();
        if (fault(Fault::ActiveForgotten)) constraints.nearest.active = 0;
        copy(V_, check_.V, 2);
        Outcome outcome = check_.judge(l, first, d, v_, before_, constraints);
        if (is_short(outcome)) outcome = refined(l, first, d, outcome);
        pulls_[std::size_t(l)] = outcome.pull;
        shorten_level(damping_.step_of(l, bound));
        return outcome.status;
    }

    // Whether nothing is wrong with an answer but its last digits. Where rows do not hold to the last
    // digit, something else is.
    static bool is_short(const Outcome& found) {
        if (found.status == Status::Optimal) return found.off > SHORT_OF_DIGITS;
        return found.status == Status::Inaccurate && found.gap <= SHORT_OF_DIGITS;
    }

    // The outcome after the rest of the way to the optimum, which the gradient that the check has
    // left tells, judged anew. What is worse than before is taken back.
    Outcome refined(int l, int first, double d, const Outcome& found) {
        copy(kept_v_, v_, m_->blocks);
        copy(kept_V_, check_.V, 2);
        shares_.keep();
        go_on(l, first, d + levels[std::size_t(l)].joint_weight);
        copy(check_.V, V_, 2);
        const Outcome outcome = check_.judge(l, first, d, v_, before_, constraints);
        if (outcome.status == Status::Optimal && outcome.off < found.off) return outcome;
        copy(v_, kept_v_, m_->blocks);
        copy(check_.V, kept_V_, 2);
        shares_.take_back();
        return found;
    }

    // Make a share of a level's step.
    void shorten_level(double share) {
        if (share == 1.0) return;
        for (int b = 0; b < m_->blocks; b++)
            lanes(v_)[b] = lanes(before_)[b] + share * (lanes(v_)[b] - lanes(before_)[b]);
        for (int b = 0; b < 2; b++)
            lanes(check_.V)[b] = lanes(V_)[b] + share * (lanes(check_.V)[b] - lanes(V_)[b]);
    }

    // A Newton step of a level, with the limits active that are.
    void go_on(int l, int first, double curvature) {
        LeastDistance& nearest = constraints.nearest;
        const int shares = l == 0 ? shares_.count() : 0, own = hierarchy_.decided - first;
        if (nearest.active) {
            double* slope = nearest.zeros();
            copy(slope, check_.left(), m_->blocks);
            for (int k = 0; k < shares; k++)
                slope[constraints.share_row(k)] = check_.left_of_share(k);
            nearest.descend(slope);
            return constraints.step(shares + loops_->free - first, shares, v_);
        }
        reduce(check_.left(), z_);
        small_.descend(z_ + first);
        clear(x_, hierarchy_.blocks());
        for (int k = 0; k < own; k++) x_[first + k] = small_.x(k);
        for (int i = first + own; i < loops_->free; i++) x_[i] = -z_[i] / curvature;
        move(x_, v_);
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
        LeastDistance& nearest = constraints.nearest;
        nearest.active = 0;
        if (constraints.hold(l, v_) || fault(Fault::LimitsForgotten)) return Status::Optimal;
        const int shares = l == 0 ? shares_.count() : 0, K = loops_->free - first;
        constraints.begin(v_);
        for (int a = 0; a < padded(shares + K); a++)
            clear(nearest.column(a), nearest.stride() / LANES);
        for (int a = 0; a < shares; a++) constraints.share_column(a);
        for (int a = 0; a < K; a++) {
            level_direction(a, first, hierarchy_.decided - first, curvature);
            add_rows(nearest.column(shares + a), loops_->Z, stride(), loops_->free,
                     X_ + a * hierarchy_.width(), m_->blocks);
        }
        constraints.see_limits(shares + K);
        Status status = nearest.solve(shares + K);
        if (status == Status::Infeasible && l == 0 && levels[0].exact > first) {
            constraints.widen();
            status = nearest.solve(shares + K);
        }
        if (status == Status::Optimal) constraints.step(shares + K, shares, v_);
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

    Ahead ahead_;
    Rows rows_;
    std::unique_ptr<Loops> loops_;
    Hierarchy hierarchy_;
    Shares shares_;
    StepDamping damping_;

  public:
    Constraints constraints;

  private:
    Check check_;
    std::vector<double> b_;
    double *v_, *before_, *kept_v_, *V_, *kept_V_, *last_, *t_, *W_, *w_, *x_, *z_, *X_;
    std::vector<double> residual_;
    SmallLeastSquares small_;
    std::vector<double> pulls_;
};

}  // namespace coopqp
