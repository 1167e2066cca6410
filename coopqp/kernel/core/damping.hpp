// What a step needs that it does not overshoot, as coopqp.qp_law.equations.Damping.
#pragma once
#include <algorithm>
#include <cmath>
#include <vector>

#include "rows.hpp"
#include "shared.hpp"

namespace coopqp {

class StepDamping {
  public:
    StepDamping(const Rows& rows, const Settings& settings, const std::vector<Level>& levels,
                Arena& arena)
        : rows_(rows), error_damping_(settings.error_damping), dt_(settings.dt),
          V_(arena.take(TWIST)), asked2_(std::size_t(levels[0].shares)),
          wanted2_(std::size_t(levels[0].shares)) {
        for (const Level& level : levels)
            for (char asks : level.asks_velocity) asks_ |= asks != 0;
    }

    // At the last velocity, in lanes, which must stay where it is, with how joints oscillate.
    void begin(const double* v_last, double chatter) {
        v_last_ = v_last;
        chatter_ = chatter;
        share_ = error_damping_ * (1.0 + chatter) * dt_;
        if (share_ > 0.0 && asks_) rows_.object_twist(v_last, V_);
    }

    // As coopqp.qp_law.equations.Damping.overreaches.
    double overreaches(double curvature, double moved) const {
        if (!(error_damping_ > 0.0)) return 0.0;
        const double bent = 0.5 * dt_ * curvature;
        return std::min(std::max(bent / (BENDS * std::max(moved, LEAST_SPEED)) - 1.0, 0.0), 1.0);
    }

    // For a curvature.
    double of(double curvature) const { return share_ * curvature; }

    // Of level l.
    double of(int l, const Level& level, const Bound& bound) {
        if (!(share_ > 0.0)) return 0.0;
        double pull = 0.0;
        if (level.shares) pull = SCALE_WEIGHT * of_scaled(level, v_last_, V_, bound.missing);
        if (l > 0) pull = bound.later_pulls[l - 1];
        return of_soft(level) + of_pull(pull);
    }

    // Of the soft tasks of a level.
    double of_soft(const Level& level) const {
        if (!(share_ > 0.0)) return 0.0;
        double curvature = 0.0;
        for (int s = level.exact; s < level.rows; s++)
            curvature += level.weight[std::size_t(s)] * of_row(level, s, v_last_, V_);
        return share_ * curvature + chatter_ * level.joint_weight;
    }

    // For a pull at rows decided before.
    double of_pull(double pull) const { return std::min(share_ * pull, MOST_DAMPING); }

    // What is made of a step that needs more damping than it may have.
    double step_of(double pull) const {
        const double needed = share_ * pull;
        return needed > MOST_DAMPING ? MOST_DAMPING / needed : 1.0;
    }

    // A pull to be remembered, as coopqp.qp_law.equations.held_pull.
    static double held_pull(double pull, double old) {
        const double held = LETS_GO * old;
        return held > FIRM ? std::max(pull, held) : pull;
    }

    // Note how joints chatter in a tick with the velocity v, in lanes, as coopqp.qp_law.equations.
    void note_chatter(const Model& m, const double* v, double* chatter) const {
        double most = 0.0, fastest = 0.0, latest = 0.0;
        for (int j = 0; j < m.n(); j++) {
            double& way = chatter[1 + j];
            const double x = v[m.joints[std::size_t(j)].lane], speed = std::fabs(x), old = std::fabs(way);
            const bool moves = speed > SWINGS_AT;
            latest = std::max(latest, old);
            double times = std::max(FORGETS * old, NO_REVERSAL);
            if (moves && x * way < 0.0) {
                const bool at_once = old == std::round(old);
                times = std::min(1.0 + old, REVERSALS);
                most = std::max(most, at_once ? REVERSALS : times);
            }
            if (moves || way != 0.0) way = std::copysign(times, moves ? x : way);
            fastest = std::max(fastest, speed);
        }
        const double again = most - REVERSALS + 1.0, grown = 1.0 + chatter[0];
        const bool goes_on = fastest > SWINGS_AT && latest < 1.0;
        const double rate = fastest / FADES_IN + (goes_on ? 1.0 / FADES_AFTER : 0.0);
        const double faded = std::max(grown / (1.0 + dt_ * rate), 1.0);
        chatter[0] = (again > 0.0 ? std::min(std::pow(GROWS, again) * grown, MOST_GROWN) : faded) - 1.0;
    }

  private:
    // As coopqp.task.TaskStack.curvatures.
    double of_row(const Level& level, int s, const double* v_last, const double* V) const {
        const std::size_t i = std::size_t(s);
        const double size = level.asks_velocity[i]
                                ? rows_.times(level, s, v_last, V) - level.rate[i]
                                : level.gain[i] * level.e[i];
        return std::fabs(size) * level.curvature_bound[i];
    }

    // Multipliers of scaled tasks are known by what their shares lacked in the last tick.
    double of_scaled(const Level& level, const double* v_last, const double* V,
                     const double* missing) {
        std::fill(asked2_.begin(), asked2_.end(), 0.0);
        std::fill(wanted2_.begin(), wanted2_.end(), 0.0);
        for (int s = level.hard; s < level.exact; s++) {
            const std::size_t k = std::size_t(level.share[std::size_t(s)]);
            const double asked = of_row(level, s, v_last, V), wanted = level.wanted[std::size_t(s)];
            asked2_[k] += asked * asked;
            wanted2_[k] += wanted * wanted;
        }
        constexpr double LEAST2 = LEAST_SPEED * LEAST_SPEED;
        double pull = 0.0;
        for (std::size_t k = 0; k < asked2_.size(); k++)
            pull += missing[k] * std::sqrt(asked2_[k] * std::min(wanted2_[k] / LEAST2, 1.0)) /
                    (wanted2_[k] + LEAST2);
        return pull;
    }

    const Rows& rows_;
    double error_damping_, dt_, chatter_ = 0.0, share_ = 0.0, *V_;
    const double* v_last_ = nullptr;
    bool asks_ = false;  // whether there are rows that ask for a velocity
    std::vector<double> asked2_, wanted2_;
};

}  // namespace coopqp
