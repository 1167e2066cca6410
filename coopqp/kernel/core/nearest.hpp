// Hard and scaled tasks where limits and loops leave no motion that does all they ask, as
// coopqp.qp_law.nearest: two levels of least squares, above all soft ones.
#pragma once
#include <algorithm>
#include <cmath>
#include <vector>

#include "cascade.hpp"
#include "damping.hpp"

namespace coopqp {

constexpr double ALONG = 1e-3, LESS = 1e-3, MET = 1e-9;  // as there

class Nearest {
  public:
    // given: the level of hard and scaled tasks.
    Nearest(const Model& model, const Settings& settings, const Rows& rows, const Loops& loops,
            const Limits& limits, const std::vector<std::vector<int>>& kept, const Level& given,
            Arena& arena)
        : m_(model), s_(settings), rows_(rows), given_(given),
          levels_{hard(given), across(given, model, arena)},
          cascade_(model, settings, rows, loops, limits, kept, levels_, arena),
          V_(arena.take(TWIST)), got(given.wanted.size()) {
        cascade_.check().certify(settings.damping);
    }

    // The level of the hard tasks.
    //   missed: what the given level's rows lacked in the last tick.
    //   b, v: as in Cascade::begin.
    Status of_hard(const StepDamping& damping, const double* missed, const double* b, const double* v) {
        cascade_.begin(b, v);
        std::copy_n(given_.wanted.begin(), given_.hard, levels_[0].wanted.begin());
        return decide(0, damping, missed, 0, given_.hard);
    }

    // The level of the scaled tasks, after that.
    Status of_scaled(const StepDamping& damping, const double* missed) {
        for (int k = 0; k < given_.shares; k++) mix(k);
        return decide(1, damping, missed, given_.hard, given_.exact);
    }

    const double* v() const { return cascade_.v(); }  // in lanes

  private:
    const Model& m_;
    const Settings& s_;
    const Rows& rows_;
    const Level& given_;
    std::vector<Level> levels_;
    Cascade cascade_;
    double* V_;

  public:
    std::vector<double> got;  // what the motion does of each of the given rows

  private:
    // A level of these rows, as soft ones.
    static Level part(const Level& given, int from, int to) {
        Level level;
        const auto cut = [&](const auto& all) {
            return std::decay_t<decltype(all)>(all.begin() + from, all.begin() + to);
        };
        level.rows = to - from;
        level.e = level.rate = level.wanted = cut(given.wanted);
        level.gain = cut(given.gain);
        level.weight = cut(given.weight);
        level.lever = cut(given.lever);
        level.asks_velocity = cut(given.asks_velocity);
        level.twist = cut(given.twist);
        level.share.assign(std::size_t(level.rows), -1);
        return level;
    }

    static Level hard(const Level& given) {
        Level level = part(given, 0, given.hard);
        level.T = given.T;  // hard rows come first
        level.J = given.J;
        return level;
    }

    static Level across(const Level& given, const Model& m, Arena& arena) {
        Level level = part(given, given.hard, given.exact);
        level.T = arena.take(8 * std::size_t(level.rows + 1));
        level.J = arena.take(std::size_t(m.blocks) * LANES * std::size_t(level.rows + 1));
        return level;
    }

    Status decide(int l, const StepDamping& damping, const double* missed, int from, int to) {
        double bend = 0.0;
        for (int s = from; s < to; s++)
            bend += given_.weight[std::size_t(s)] * std::fabs(missed[s]) * given_.lever[std::size_t(s)];
        const Status status = cascade_.decide(l, LESS * s_.damping + damping.of(bend));
        if (status != Status::Optimal) return status;
        rows_.object_twist(v(), V_);
        for (int s = from; s < to; s++) got[std::size_t(s)] = rows_.times(given_, s, v(), V_);
        return status;
    }

    // Rows of the k-th scaled task, of which what is along the wanted direction counts less.
    void mix(int k) {
        Level& level = levels_[1];
        const std::size_t stride = rows_.stride();
        double size2 = LEAST_SPEED * LEAST_SPEED, along = 0.0;
        int first = -1, last = -1;
        for (int s = given_.hard; s < given_.exact; s++)
            if (given_.share[std::size_t(s)] == k) {
                first = first < 0 ? s : first;
                last = s;
                size2 += given_.wanted[std::size_t(s)] * given_.wanted[std::size_t(s)];
            }
        const double less = (1.0 - std::sqrt(ALONG)) / size2;
        const auto wanted = [&](int s) { return given_.wanted[std::size_t(s)]; };
        for (int s = first; s <= last; s++) along += wanted(s) * wanted(s);
        for (int s = first; s <= last; s++) {
            const int to = s - given_.hard;
            const bool twist = level.twist[std::size_t(to)];
            double* row = twist ? level.T + TWIST * to : level.J + std::size_t(to) * stride;
            const double* of = twist ? given_.T + TWIST * s : given_.J + std::size_t(s) * stride;
            const int blocks = twist ? TWIST / LANES : m_.blocks;
            copy(row, of, blocks);
            for (int r = first; r <= last; r++) {
                const double* other =
                    twist ? given_.T + TWIST * r : given_.J + std::size_t(r) * stride;
                add(row, other, -less * wanted(s) * wanted(r), blocks);
            }
            level.wanted[std::size_t(to)] = wanted(s) - less * wanted(s) * along;
        }
    }
};

}  // namespace coopqp
