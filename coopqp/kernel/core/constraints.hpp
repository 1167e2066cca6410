// What keeps a level from its optimum, as rows of a LeastDistance over joints, limits G v <= h, shares
// of scaled tasks, and exact rows that depend on others, in this order.
#pragma once
#include <cmath>
#include <vector>

#include "least_distance.hpp"
#include "problem.hpp"
#include "shared.hpp"
#include "shares.hpp"

namespace coopqp {

// lb <= v <= ub and G v <= h of a tick, for all levels.
struct Limits {
    // most: rows there can be.
    Limits(int lanes, int rows, int most, Arena& arena)
        : lb(arena.take(std::size_t(lanes))), ub(arena.take(std::size_t(lanes))),
          G(arena.take(std::size_t(lanes) * std::size_t(most + 1))), h(std::size_t(rows)), most(most) {
        h.reserve(std::size_t(most));
    }

    double *lb, *ub;        // in lanes
    double* G;              // (p, lanes)
    std::vector<double> h;  // of the rows of a tick
    int most;
};

class Constraints {
  public:
    Constraints(int lanes, const Limits& given, int columns, const Level& first, Shares& shares,
                Arena& arena)
        : limits(given),
          nearest(lanes + padded(given.most) + padded(shares.count()) +
                      padded(first.exact),
                  columns + shares.count(), arena),
          lanes_(lanes), inequalities_(given.most), exact_(first.exact), shares_(shares),
          sizes2_(arena.take(std::size_t(nearest.stride()))),
          turn_(std::size_t(shares.count() + 1)) {}

    const Limits& limits;
    LeastDistance nearest;

    // Whether level l may have v and the shares as they are; sides of all rows but those of joints
    // and shares are written for who may not.
    bool hold(int l, const double* v) {
        if (inequalities_ != int(limits.h.size())) lay_out();
        const bool inside = limits_hold(v), agree = rows_agree(l);
        return inside && agree;
    }

    // Sides of joints and of limits.
    void begin(const double* v) {
        width_ = 0.0;
        for (int b = 0; b < lanes_ / LANES; b++) {
            coopqp::lanes(nearest.lower)[b] = coopqp::lanes(limits.lb)[b] - coopqp::lanes(v)[b];
            coopqp::lanes(nearest.upper)[b] = coopqp::lanes(limits.ub)[b] - coopqp::lanes(v)[b];
        }
        for (int i = 0; i < inequalities_; i++) nearest.lower[lanes_ + i] = -1e300;
    }

    // How all shares, and the joints with them, go along their a-th direction.
    void share_column(int a) {
        double* column = nearest.column(a);
        shares_.direction(a, turn_.data());
        for (int k = 0; k < shares_.count(); k++) {
            column[share_row(k)] = turn_[std::size_t(k)];
            nearest.lower[share_row(k)] = -shares_.share(k);
            nearest.upper[share_row(k)] = 1.0 - shares_.share(k);
            add(column, shares_.way(k), turn_[std::size_t(k)], lanes_ / LANES);
        }
        for (int s = 0; s < exact_; s++)
            for (int k = 0; k < shares_.count(); k++)
                column[spare_row(s)] += shares_.asks(s, k) * turn_[std::size_t(k)];
    }

    // What columns that are known over the joints do to limits.
    void see_limits(int columns) {
        for (int i = 0; i < inequalities_; i++)
            for (int a = 0; a < columns; a++)
                nearest.column(a)[lanes_ + i] =
                    dot(limits.G + std::size_t(i) * std::size_t(lanes_), nearest.column(a), lanes_ / LANES);
    }

    // Let limits give way that later levels hardly move, known by the first columns, of orthonormal
    // directions: the levels before have decided them, and what is left of their rows is noise.
    void leave_decided(int columns) {
        const int rows = lanes_ + inequalities_;
        clear(sizes2_, nearest.stride() / LANES);
        for (int a = 0; a < columns; a++)
            for (int b = 0; b < nearest.stride() / LANES; b++)
                coopqp::lanes(sizes2_)[b] += coopqp::lanes(nearest.column(a))[b] * coopqp::lanes(nearest.column(a))[b];
        for (int i = 0; i < rows; i++) {
            const double* G = limits.G + std::size_t(i - lanes_) * std::size_t(lanes_);
            const double of_row2 = i < lanes_ ? 1.0 : dot(G, G, lanes_ / LANES);
            if (sizes2_[i] >= DECIDED * DECIDED * of_row2) continue;
            const double size = std::sqrt(sizes2_[i]), of_row = std::sqrt(of_row2);
            const double seen = size - UNSEEN * of_row, width = DECIDED * of_row;
            const double way = seen > 0.0 ? width * (width - size) / seen : 1e300;
            nearest.lower[i] -= way;
            nearest.upper[i] += way;
        }
    }

    // Let exact rows that depend on others give way a little, as solvers let equalities.
    void widen(double by) {
        nearest.widen(spare_row(0), exact_, by);
        width_ += by;
    }
    double width() const { return width_; }

    // Go along the first columns by nearest.u, with so many of the shares.
    void step(int columns, int shares, double* v) {
        add_rows(v, nearest.M, nearest.stride(), columns, nearest.u, lanes_ / LANES);
        for (int k = 0; k < shares; k++)
            for (int a = 0; a < shares; a++)
                shares_.share(k) += nearest.column(a)[share_row(k)] * nearest.u[a];
    }

    // Which row keeps a share between 0 and 1.
    int share_row(int k) const { return lanes_ + padded(inequalities_) + k; }

    // Which row keeps an exact one that depends on others.
    int spare_row(int s) const { return share_row(0) + padded(shares_.count()) + s; }

  private:
    // Where rows are, as many as there are in this tick; those that only fill lanes hold nothing.
    void lay_out() {
        inequalities_ = int(limits.h.size());
        nearest.take_rows(spare_row(0) + padded(exact_));
        clear(nearest.lower, nearest.stride() / LANES);
        clear(nearest.upper, nearest.stride() / LANES);
    }

    bool limits_hold(const double* v) {
        bool inside = true;
        const v4 *lo = coopqp::lanes(limits.lb), *hi = coopqp::lanes(limits.ub), *x = coopqp::lanes(v);
        v4 over = v4{};
        for (int b = 0; b < lanes_ / LANES; b++)
            over = larger(over, larger(lo[b] - x[b], x[b] - hi[b]));
        for (int k = 0; k < LANES; k++) inside &= over[k] <= nearest.violation;
        double* slack = nearest.upper + lanes_;
        for (int i = 0; i < inequalities_; i++) {
            slack[i] = limits.h[std::size_t(i)] -
                       dot(limits.G + std::size_t(i) * std::size_t(lanes_), v, lanes_ / LANES);
            inside &= slack[i] >= -nearest.violation;
        }
        for (int k = 0; k < shares_.count(); k++)
            inside &= shares_.share(k) >= 0.0 && shares_.share(k) <= 1.0;
        return inside;
    }

    // What rows of the first level lack that depend on others, and whether that is nothing.
    bool rows_agree(int l) {
        bool agree = true;
        for (int s = 0; s < exact_; s++) {
            const double lacks = l == 0 ? shares_.lacks(s) : 0.0;
            nearest.lower[spare_row(s)] = nearest.upper[spare_row(s)] = -lacks;
            agree &= std::fabs(lacks) <= VIOLATION;
        }
        for (int k = 0; l > 0 && k < shares_.count(); k++)
            nearest.lower[share_row(k)] = nearest.upper[share_row(k)] = 0.0;
        return agree;
    }

    int lanes_, inequalities_, exact_;
    double width_ = 0.0;  // by which rows that depend on others give way
    Shares& shares_;
    double* sizes2_;
    std::vector<double> turn_;
};

}  // namespace coopqp
