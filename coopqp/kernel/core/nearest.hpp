// Hard and scaled tasks where limits and loops leave no motion that does all they ask, as
// coopqp.qp_law.nearest: two levels of least squares, above all soft ones.
#pragma once
#include <algorithm>
#include <cmath>
#include <type_traits>
#include <vector>

#include "cascade.hpp"
#include "damping.hpp"

namespace coopqp {

constexpr double SLOW = 5e-3, LESS = 1e-3;  // as there

class Nearest {
  public:
    // given: the level of hard and scaled tasks, soft ones not among them.
    Nearest(const Model& model, const Settings& settings, const Rows& rows, const Loops& loops,
            const Limits& limits, const std::vector<std::vector<int>>& kept, const Level& given,
            Arena& arena)
        : s_(settings), given_(given),
          levels_{part(given, 0, given.hard, rows.stride()),
                  part(given, given.hard, given.exact, rows.stride())},
          cascade_(model, settings, rows, loops, limits, kept, levels_, arena) {
        cascade_.check().certify(settings.damping);
    }

    // The level of the hard tasks.
    //   missed: what the given level's rows lacked in the last tick.
    //   b, v: as in Cascade::begin.
    Status of_hard(const StepDamping& damping, const double* missed, const double* b, const double* v) {
        cascade_.begin(b, v);
        return decide(0, damping, missed);
    }

    // Take the hard tasks as decided by a motion v, in lanes, that moves the loops by b.
    void accept_hard(const double* b, const double* v) {
        cascade_.begin(b, v);
        cascade_.accept(v);
    }

    // The level of the scaled tasks, after either.
    Status of_scaled(const StepDamping& damping, const double* missed) {
        return decide(1, damping, missed + given_.hard);
    }

    const double* v() const { return cascade_.v(); }  // in lanes

  private:
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
        level.lever = cut(given.lever);
        level.asks_velocity = cut(given.asks_velocity);
        level.twist = cut(given.twist);
        level.share.assign(std::size_t(level.rows), -1);
        level.T = given.T + TWIST * from;
        level.J = given.J + stride * std::size_t(from);
        return level;
    }

    Status decide(int l, const StepDamping& damping, const double* missed) {
        Level& level = levels_[std::size_t(l)];
        const int from = l == 0 ? 0 : given_.hard;
        double bend = 0.0;
        for (int s = 0; s < level.rows; s++) {
            const std::size_t i = std::size_t(s);
            level.wanted[i] = given_.wanted[i + std::size_t(from)];
            bend += level.weight[i] * std::fabs(missed[s]) * level.lever[i];
        }
        return cascade_.decide(l, LESS * s_.damping + damping.of(bend));
    }

    const Settings& s_;
    const Level& given_;
    std::vector<Level> levels_;
    Cascade cascade_;
};

}  // namespace coopqp
