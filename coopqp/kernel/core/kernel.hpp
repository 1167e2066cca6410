// One verified tick: kinematics, loops, levels, the look ahead.
#pragma once
#include <algorithm>
#include <cmath>
#include <memory>
#include <stdexcept>
#include <vector>

#include "ahead.hpp"
#include "cascade.hpp"
#include "damping.hpp"
#include "faults.hpp"
#include "loops.hpp"
#include "nearest.hpp"
#include "problem.hpp"
#include "rows.hpp"
#include "way_back.hpp"

namespace coopqp {

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
          damping_(rows_, s_, levels, *arena_),
          limits(stride(), s_.inequalities, *arena_),
          tasks_(*m_, s_, rows_, *loops_, limits, kept_, levels, *arena_),
          nearest_(*m_, s_, rows_, *loops_, limits, kept_, levels[0], *arena_),
          way_back_(*m_, s_, rows_, *loops_, limits, kept_, *arena_),
          b_(std::size_t(6 * std::max(m_->loops(), 1))),
          wanted_(std::size_t(levels[0].exact)), missed_(wanted_.size()),
          missing_(std::size_t(levels[0].shares)),
          set_out_(arena_->take(std::size_t(stride()))),
          v_(arena_->take(std::size_t(stride()))),
          last_(arena_->take(std::size_t(stride()))),
          t_(arena_->take(std::size_t(stride()))) {}

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

    // Decide v from the kinematics, tasks and limits as they stand. Joints that are outside their
    // limits come back first: the limits are tightened by their way.
    //   all_corrected: whether the tick before has done all of the drift correction.
    Status solve(bool all_corrected) {
        for (int j = 0; j < m_->n(); j++)
            last_[m_->joints[std::size_t(j)].lane] = bound.v_last[j];
        damping_.begin(last_, bound.swing[0]);
        aim_loops(ahead_.kappa(bound.drift));
        if (!fault(Fault::StaleFactor) && !loops_->factor()) return Status::Singular;
        if (fault(Fault::WrongDirection)) loops_->Z[0] += 1e-3;
        loops_->particular(b_.data(), set_out_);
        if (fault(Fault::WrongSide)) set_out_[0] += 1e-4;
        comes_back_ = s_.outside(bound.q);
        if (comes_back_) {
            const Status status = all_corrected ? find_way_back() : Status::Outside;
            if (status != Status::Optimal) return status;
        }
        Status status = decide_first();
        if (status != Status::Optimal) return status;
        for (std::size_t l = 1; l < levels.size(); l++) {
            levels[l].want();
            const double damping = s_.damping + damping_.of(int(l), levels[l], bound);
            status = tasks_.decide(int(l), damping);
            if (status != Status::Optimal) return status;
            tasks_.shorten(damping_.step_of(int(l), bound));
        }
        status = command(tasks_.v());
        if (status == Status::Opens) return status;
        for (std::size_t l = 1; l < levels.size(); l++) bound.later_pulls[l - 1] = tasks_.pull(int(l));
        if (comes_back_) bound.recovery[0] = way_back_.pull();
        std::copy(missed_.begin(), missed_.end(), bound.missed);
        std::copy(missing_.begin(), missing_.end(), bound.missing);
        return status;
    }

    // Whether joints were outside their limits when it was decided last.
    bool comes_back() const { return comes_back_; }

    // Whether hard or scaled tasks lacked more than rounding when it was decided last.
    bool relaxed() const {
        double lacks2 = 0.0;
        for (double x : missed_) lacks2 += x * x;
        return lacks2 > s_.budget.equality * s_.budget.equality;
    }

    // The least share of its rate at which a hard or scaled task ran; 1 without such tasks.
    double scale() const {
        double least = 1.0;
        const Level& level = levels[0];
        for (double missing : missing_) least = std::min(least, 1.0 - missing);
        for (std::size_t i = 0; i < level.task.size(); i++) {
            double lacks2 = 0.0, wanted2 = 0.0;
            for (int s = level.task[i]; s < (i + 1 < level.task.size() ? level.task[i + 1] : level.hard); s++) {
                lacks2 += missed_[std::size_t(s)] * missed_[std::size_t(s)];
                wanted2 += wanted_[std::size_t(s)] * wanted_[std::size_t(s)];
            }
            if (lacks2 > 0.0) least = std::min(least, 1.0 - std::sqrt(lacks2 / std::max(lacks2, wanted2)));
        }
        return least;
    }

    // Where tasks leave no answer to joints that are outside: the way back alone. Opens where that
    // is to stand still.
    Status come_back() {
        const Status status = command(way_back_.v());
        if (status == Status::Opens) {
            clear(v_, m_->blocks);
            write();
        }
        bound.recovery[0] = way_back_.pull();
        return status;
    }

    // For tests: e, J over the joints and rate of each row.
    std::vector<double> rows_of(int l) const { return rows_.listed(levels[std::size_t(l)], t_); }

    int stride() const { return m_->blocks * LANES; }
    const Model& model() const { return *m_; }
    const Settings& settings() const { return s_; }
    const Rows& rows() const { return rows_; }
    Check& check() { return tasks_.check(); }

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
    // b = -kappa e
    void aim_loops(double kappa) {
        std::size_t at = 0;
        for (std::size_t i = 0; i < kept_.size(); i++)
            for (int r : kept_[i]) b_[at++] = -kappa * bound.drift[6 * i + std::size_t(r)];
    }

    // Hard and scaled tasks as they are, or as nearly as can be; else the first soft ones.
    Status decide_first() {
        Level& level = levels[0];
        level.want();
        std::fill(missed_.begin(), missed_.end(), 0.0);
        Status status = Status::Infeasible;
        if (std::all_of(bound.missed, bound.missed + level.hard, [](double x) { return x == 0.0; })) {
            status = decide_exactly();
            if (status == Status::Optimal) return status;
        }
        const bool left = status == Status::Infeasible || status == Status::Unproven;
        return left && level.exact && s_.relaxes ? come_near() : status;
    }

    Status decide_exactly() {
        Level& level = levels[0];
        tasks_.begin(b_.data(), set_out_);
        const Status status = tasks_.decide(0, s_.damping + damping_.of(0, level, bound));
        for (int k = 0; k < level.shares; k++)
            missing_[std::size_t(k)] = 1.0 - tasks_.shares().share(k);
        return status;
    }

    // The levels of hard and of scaled tasks where not all they ask can be done.
    Status come_near() {
        Level& level = levels[0];
        const auto exact = level.wanted.begin() + level.exact;
        std::copy(level.wanted.begin(), exact, wanted_.begin());
        std::vector<double>& got = nearest_.got;
        Status status = nearest_.of_hard(damping_, bound.missed, b_.data(), set_out_);
        if (status != Status::Optimal) return status;
        bool scales = false;
        if (level.shares) {
            std::copy_n(got.begin(), level.hard, level.wanted.begin());
            scales = decide_exactly() == Status::Optimal;
            std::copy(wanted_.begin(), wanted_.end(), level.wanted.begin());
            if (!scales) status = nearest_.of_scaled(damping_, bound.missed);
            if (status != Status::Optimal) return status;
        }
        for (int s = 0; s < (scales ? level.hard : level.exact); s++) {
            const double lacks = got[std::size_t(s)] - wanted_[std::size_t(s)];
            missed_[std::size_t(s)] = std::fabs(lacks) > MET ? lacks : 0.0;
        }
        if (scales) return status;
        for (int k = 0; k < level.shares; k++) missing_[std::size_t(k)] = 1.0 - share_got(k);
        tasks_.begin(b_.data(), set_out_);
        tasks_.accept(nearest_.v());
        return status;
    }

    // How much of its rate a scaled task has got along its direction.
    double share_got(int k) const {
        double wanted2 = LEAST_SPEED * LEAST_SPEED, along = 0.0;
        for (int s = levels[0].hard; s < levels[0].exact; s++) {
            if (levels[0].share[std::size_t(s)] != k) continue;
            wanted2 += wanted_[std::size_t(s)] * wanted_[std::size_t(s)];
            along += wanted_[std::size_t(s)] * nearest_.got[std::size_t(s)];
        }
        return std::min(std::max(along / wanted2, 0.0), 1.0);
    }

    Status find_way_back() {
        const double damping = damping_.of(s_.reach * bound.recovery[0]);
        const Status status = way_back_.find(bound.q, damping, b_.data(), set_out_);
        if (status == Status::Optimal) way_back_.keep(bound.q, limits);
        return status;
    }

    // v in lanes, or as much of it as leaves the loops within their budget, is what joints do.
    Status command(const double* v) {
        copy(v_, v, m_->blocks);
        const double share = ahead_.shorten(bound.q, bound.gap, bound.drift, v_);
        if (share == 0.0) return Status::Opens;
        write();
        return share < 1.0 ? Status::Shortened : Status::Optimal;
    }

    void write() {
        for (int j = 0; j < m_->n(); j++) bound.v[j] = v_[m_->joints[std::size_t(j)].lane];
        damping_.note_swing(v_, bound.swing, m_->blocks);
    }

    Ahead ahead_;
    Rows rows_;
    std::unique_ptr<Loops> loops_;
    StepDamping damping_;

  public:
    Limits limits;

  private:
    Cascade tasks_;
    Nearest nearest_;
    WayBack way_back_;
    std::vector<double> b_;
    std::vector<double> wanted_, missed_;  // of hard and scaled rows
    std::vector<double> missing_;          // of shares
    double *set_out_, *v_, *last_, *t_;
    bool comes_back_ = false;
};

}  // namespace coopqp
