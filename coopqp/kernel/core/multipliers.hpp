// What pushes at a gradient: active limits, and the loops and decided rows that balance them.
//
// Multipliers of loops and decided rows are found from the gradient itself, by the factors; what
// they push is taken from the rows themselves, so that what is left of the gradient tells the truth.
#pragma once
#include <cmath>
#include <vector>

#include "hierarchy.hpp"
#include "least_distance.hpp"
#include "loops.hpp"
#include "rows.hpp"

namespace coopqp {

class Multipliers {
  public:
    Multipliers(const Model& model, const Rows& rows, const Loops& loops, Hierarchy& hierarchy,
                const std::vector<Level>& levels, Arena& arena)
        : g(arena.take(rows.stride())), box(arena.take(rows.stride())),
          lambda(arena.take(std::size_t(hierarchy.width()))),
          of_loops(std::size_t(6 * std::max(model.loops(), 1))),
          of_shares(std::size_t(levels[0].shares)),
          spare(std::size_t(levels[0].exact)),
          m_(model), rows_(rows), loops_(loops), hierarchy_(hierarchy), levels_(levels),
          y_(arena.take(std::size_t(hierarchy.width()))),
          z_(arena.take(std::size_t(hierarchy.width()))),
          of_g_(arena.take(std::size_t(hierarchy.width()))), step_(std::size_t(hierarchy.width())) {}

    double* g;       // the gradient, with all that pushes, over the joints
    double* box;     // of bounds on v, over the joints
    double* lambda;  // of the rows decided before, by coordinate
    std::vector<double> of_loops, of_rows, of_shares;  // of_rows: of G
    std::vector<double> spare;  // of exact rows that depend on others

    // Add what active limits, of so many rows G, push to g; multipliers of others begin at zero.
    void push_limits(const LeastDistance& nearest, const double* G, std::size_t rows) {
        reduced_ = false;
        std::fill(of_loops.begin(), of_loops.end(), 0.0);
        of_rows.assign(rows, 0.0);
        std::fill(of_shares.begin(), of_shares.end(), 0.0);
        std::fill(spare.begin(), spare.end(), 0.0);
        clear(lambda, hierarchy_.blocks());
        clear(box, m_.blocks);
        if (!nearest.active) return;
        const int n = m_.blocks * LANES, shares = n + padded(int(of_rows.size()));
        const int exact = shares + padded(int(of_shares.size()));
        alignas(64) double tau[TWIST] = {};
        bool of_exact_rows = false;
        for (int i = 0; i < nearest.active; i++) {
            const int row = nearest.row(i);
            const double by = nearest.multiplier(i);
            if (row < n) {
                box[row] = by;
            } else if (row < shares) {
                of_rows[std::size_t(row - n)] = by;
                add(g, G + std::size_t(row - n) * rows_.stride(), by, m_.blocks);
            } else if (row < exact) {
                of_shares[std::size_t(row - shares)] = by;
            } else {
                spare[std::size_t(row - exact)] = -by;
                rows_.pull_row(levels_[0], row - exact, -by, tau, g);
                of_exact_rows = true;
            }
        }
        if (of_exact_rows) rows_.pull_object(tau, g);
        add(g, box, 1.0, m_.blocks);
    }

    // Add what directions decided in part hold back of a motion by a level.
    void push_held(const double* moved) {
        of_held_ = 0.0;
        if (!hierarchy_.held) return;
        const int blocks = hierarchy_.blocks();
        multiply(z_, loops_.Z, int(rows_.stride()), loops_.free, moved, m_.blocks);
        clear(y_, blocks);
        for (int i = 0; i < hierarchy_.held; i++) {
            const double by = dot(hierarchy_.held_row(i), z_, blocks);
            add(y_, hierarchy_.held_row(i), by, blocks);
            of_held_ += std::fabs(by) * hierarchy_.held_pull(i);
        }
        add_rows(g, loops_.Z, int(rows_.stride()), loops_.free, y_, m_.blocks);
    }

    // Let the first `first` coordinates' rows and the loops push against g, what is left of it.
    void balance(int first) {
        if (first) balance_decided(first);
        loops_.balance(g, of_loops.data());
    }

    // As coopqp.qp_law.priorities: how much a level, whose gradient is g, pulls at the task rows decided before
    // it, by how fast these turn. Damping is left out, or it would feed itself.
    double pull(int l, int first, double damping, const double* v) {
        double bound = 0.0, all = of_held_;
        for (int k = 0; k < l; k++)
            for (double of_row : levels_[std::size_t(k)].curvature_bound) bound = std::max(bound, of_row);
        if (bound == 0.0 || first == 0) return bound * all;
        const int blocks = hierarchy_.blocks();
        reduce(v, y_);
        reduce(g, of_g_);
        reduced_ = true;
        for (int b = 0; b < blocks; b++)
            lanes(y_)[b] = lanes(of_g_)[b] - lanes(y_)[b] * damping;
        put_end(y_, first - 1, y_[first - 1], blocks);
        for (int s = 0; s < first; s++) {
            const double sigma = hierarchy_.sigma(s);
            if (sigma > NOISE)
                all += std::fabs(dot(hierarchy_.direction(s), y_, blocks)) / (sigma * sigma);
        }
        return bound * all;
    }

    // Multiplier of an exact row, of which the first coordinates are.
    double of_exact(int s) const {
        double by = spare[std::size_t(s)];
        for (int k = 0; k < hierarchy_.decided; k++)
            if (hierarchy_.pivot_row(k) == s) by += lambda[k];
        return by;
    }

    // What multipliers of exact rows push at a share.
    double at_share(int k) const {
        const Level& level = levels_[0];
        double all = 0.0;
        for (int s = level.aside.empty() ? level.hard : 0; s < level.exact; s++)
            if (const double asks = level.asks(s, k); asks != 0.0) all += of_exact(s) * asks;
        return all;
    }

    // Which level a row of the hierarchy belongs to, and which of its rows it is.
    int own_row(int s, int& level) const {
        level = 0;
        while (s >= levels_[std::size_t(level)].rows) s -= levels_[std::size_t(level++)].rows;
        return s;
    }

  private:
    // y = V Z' x
    void reduce(const double* x, double* y) {
        multiply(z_, loops_.Z, int(rows_.stride()), loops_.free, x, m_.blocks);
        hierarchy_.to_y(z_, y);
    }

    void balance_decided(int first) {
        if (!reduced_) reduce(g, of_g_);
        reduced_ = false;
        for (int k = first; k-- > 0;) {
            double rest = -of_g_[k];
            for (int j = k + 1; j < first; j++)
                rest -= hierarchy_.row(hierarchy_.pivot_row(j))[k] * step_[std::size_t(j)];
            step_[std::size_t(k)] = rest / hierarchy_.row(hierarchy_.pivot_row(k))[k];
        }
        alignas(64) double tau[TWIST] = {};
        for (int k = 0; k < first; k++) {
            int at;
            const int s = own_row(hierarchy_.pivot_row(k), at);
            rows_.pull_row(levels_[std::size_t(at)], s, step_[std::size_t(k)], tau, g);
            lambda[k] += step_[std::size_t(k)];
        }
        rows_.pull_object(tau, g);
    }

    const Model& m_;
    const Rows& rows_;
    const Loops& loops_;
    Hierarchy& hierarchy_;
    const std::vector<Level>& levels_;
    double *y_, *z_, *of_g_;
    bool reduced_ = false;  // whether of_g_ is that of g
    double of_held_ = 0.0;  // what they pull, by how fast their rows turn
    std::vector<double> step_;
};

}  // namespace coopqp
