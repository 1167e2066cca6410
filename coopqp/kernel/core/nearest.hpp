// Hard and scaled tasks where limits and loops leave no motion that does all they ask, as
// coopqp.qp_law.nearest: two levels of least squares, above all soft ones.
#pragma once
#include <algorithm>
#include <cmath>
#include <limits>
#include <type_traits>
#include <vector>

#include "cascade.hpp"
#include "damping.hpp"
#include "shared.hpp"

namespace coopqp {

class Nearest {
  public:
    // given: the level of hard and scaled tasks, soft ones not among them.
    Nearest(const Model& model, const Settings& settings, const Rows& rows, const Loops& loops,
            const Limits& limits, const std::vector<std::vector<int>>& kept, const Level& given,
            Arena& arena)
        : s_(settings), given_(given), least_(settings.damping * (given.hard ? LESS * given.most_weight() : 1.0)),
          levels_{part(given, 0, given.hard, rows.stride()),
                  part(given, given.hard, given.exact, rows.stride())},
          beside_{part(given, 0, given.exact, rows.stride())},
          alone_{part(given, 0, given.hard, rows.stride())},
          blocks_(model.blocks), cascade_(model, settings, rows, loops, limits, kept, levels_, arena),
          shares_(model, settings, rows, loops, limits, kept, with_shares(beside_, given), arena),
          held_(model, settings, rows, loops, limits, kept, as_exact(alone_, given), arena) {}

    // The level of the hard tasks.
    //   b, v: as in Cascade::begin.
    Status of_hard(const double* b, const double* v) {
        std::copy_n(given_.wanted.begin(), levels_[0].rows, levels_[0].wanted.begin());
        return of_hard(b, v, 0.0);
    }

    // How far damp may be off as the answer is, which leaves a gradient of d off at most: so
    // |J x|^2 + d |x|^2 <= d off |x| for its distance x from the optimum, and |J x|^2 <= d off^2 / 4.
    double unsure(const double* pulls) const {
        const Outcome& found = cascade_.outcome();
        double squares = 0.0, all = 0.0;
        for (std::size_t s = 0; s < std::size_t(given_.hard); s++) {
            squares += given_.weight[s] * given_.curvature_bound[s] * given_.curvature_bound[s];
            all += given_.weight[s] * pulls[s] * given_.curvature_bound[s];
        }
        const double speed = std::sqrt(dot(v(), v(), blocks_));
        const double off = found.off * std::sqrt(least_ * squares / 4.0) / all * speed;
        return found.astray <= s_.budget.accuracy ? off : std::numeric_limits<double>::infinity();
    }

    // It anew, with the damping of rows that lack, or want, so much.
    Status damp(const StepDamping& damping, const double* pulls, const double* b, const double* v) {
        const Level& level = levels_[0];
        double curvature = 0.0;
        for (int s = 0; s < level.rows; s++)
            curvature += level.weight[std::size_t(s)] * pulls[s] * level.curvature_bound[std::size_t(s)];
        return of_hard(b, v, damping.of(curvature));
    }

    // Hard tasks as they are, without the scaled ones.
    Status hold(const double* b, const double* v) {
        std::copy_n(given_.wanted.begin(), given_.hard, alone_[0].wanted.begin());
        held_.begin(b, v);
        return held_.decide(0, s_.damping);
    }
    const double* held() const { return held_.v(); }  // in lanes

    // The largest shares of scaled tasks, and the least t, beside a motion of hard ones.
    //   got: all exact rows of that motion.
    //   d: damping.
    Status of_shares(const double* got, double d, const double* b, const double* v) {
        Level& level = beside_[0];
        double size2 = 0.0;
        std::copy_n(got, given_.hard, level.wanted.begin());
        for (std::size_t s = std::size_t(given_.hard); s < std::size_t(level.exact); s++) {
            level.wanted[s] = given_.wanted[s];
            level.aside[s] = got[s];
            size2 += got[s] * got[s];
        }
        const double size = std::min(std::max(std::sqrt(size2), MET), SLOW);
        for (double& aside : level.aside) aside *= SLOW / size;
        shares_.begin(b, v);
        return shares_.decide(0, d);
    }
    const Cascade& beside() const { return shares_; }
    int refined() const { return cascade_.refined() + shares_.refined() + held_.refined(); }
    double aside() const { return shares_.shares().share(given_.shares); }  // t

    // Take the hard tasks as decided by a motion v, in lanes, that moves the loops by b.
    void accept_hard(const double* b, const double* v) {
        cascade_.begin(b, v);
        cascade_.accept(v);
    }

    // The level of the scaled tasks, after either.
    //   pulled: by them at the rows of the hard ones, in the last tick.
    Status of_scaled(const StepDamping& damping, double pulled) {
        Level& level = levels_[1];
        std::copy_n(given_.wanted.begin() + given_.hard, level.rows, level.wanted.begin());
        std::copy_n(given_.e.begin() + given_.hard, level.rows, level.e.begin());
        std::copy_n(given_.rate.begin() + given_.hard, level.rows, level.rate.begin());
        const double d = s_.damping + damping.of_soft(level) + damping.of_pull(pulled);
        const Status status = cascade_.decide(1, d);
        cascade_.shorten(damping.step_of(pulled));
        return status;
    }

    // What the scaled tasks pulled at the rows of the hard ones.
    double pull() const { return cascade_.pull(1); }

    const double* v() const { return cascade_.v(); }  // in lanes

  private:
    Status of_hard(const double* b, const double* v, double d) {
        cascade_.begin(b, v);
        return cascade_.decide(0, least_ + d);
    }

    // Some rows of a level, as soft ones.
    static Level part(const Level& given, int from, int to, std::size_t stride) {
        const auto cut = [&](const auto& all) {
            return std::decay_t<decltype(all)>(all.begin() + from, all.begin() + to);
        };
        Level level;
        level.rows = to - from;
        level.e = level.rate = level.wanted = cut(given.wanted);
        level.gain = cut(given.gain);
        level.weight = cut(given.weight);
        level.curvature_bound = cut(given.curvature_bound);
        level.asks_velocity = cut(given.asks_velocity);
        level.twist = cut(given.twist);
        level.share.assign(std::size_t(level.rows), -1);
        level.T = given.T + TWIST * from;
        level.J = given.J + stride * std::size_t(from);
        return level;
    }

    // The same rows as exact ones.
    static std::vector<Level>& with_shares(std::vector<Level>& levels, const Level& given) {
        Level& level = levels[0];
        level.hard = given.hard;
        level.exact = given.exact;
        level.share.assign(given.share.begin(), given.share.begin() + given.exact);
        level.shares = given.shares + 1;
        level.aside.assign(std::size_t(given.exact), 0.0);
        return levels;
    }

    // The hard ones as exact ones.
    static std::vector<Level>& as_exact(std::vector<Level>& levels, const Level& given) {
        levels[0].hard = levels[0].exact = given.hard;
        return levels;
    }

    const Settings& s_;
    const Level& given_;
    double least_;  // damping
    std::vector<Level> levels_, beside_, alone_;
    int blocks_;
    Cascade cascade_, shares_, held_;
};

}  // namespace coopqp
