// The shortest u with lower <= M u <= upper, by the dual active set method of Goldfarb and Idnani
// (1983) with the unit matrix as Hessian. It starts from nothing, so that a tick depends on its
// state alone. Where there is none, the active constraints and their multipliers say why.
#pragma once
#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "reflections.hpp"
#include "shared.hpp"

namespace coopqp {

constexpr double VIOLATION = 1e-12;       // of a constraint that counts as met [rad/s, m/s]
constexpr double IN_THE_SPAN = 1e-9;      // share of a normal that active ones leave of it
constexpr int MOST_CHANGES = 400;         // of the active set

class LeastDistance {
  public:
    // rows of M in padded lanes, most columns.
    LeastDistance(int rows, int columns, Arena& arena)
        : row_blocks_(blocks_of(rows)), width_(padded(std::max(columns, 1))),
          M(arena.take(std::size_t(columns + LANES) * std::size_t(padded(rows)))),
          lower(arena.take(std::size_t(padded(rows)))),
          upper(arena.take(std::size_t(padded(rows)))),
          values_(arena.take(std::size_t(padded(rows)))), u(arena.take(std::size_t(width_))),
          Q_(arena.take(std::size_t(width_) * std::size_t(width_))),
          R_(std::size_t(columns + 1) * std::size_t(columns + 1)),
          d_(arena.take(std::size_t(width_))), h_(arena.take(std::size_t(width_))),
          normal_(arena.take(std::size_t(width_))), r_(std::size_t(columns + 1)),
          multiplier_(std::size_t(columns + 1)),
          row_(std::size_t(columns + 1)), side_(std::size_t(columns + 1)), most_(columns + 1) {}

    // So many rows from now on, no more than at first.
    void take_rows(int rows) { row_blocks_ = blocks_of(rows); }

    double* column(int a) { return M + a * stride(); }
    int stride() const { return row_blocks_ * LANES; }

  private:
    int row_blocks_, width_;

  public:
    double *M, *lower, *upper;
    int active = 0;
    double violation = VIOLATION;

  private:
    double* values_;

  public:
    double* u;

    int row(int i) const { return row_[std::size_t(i)]; }
    // Multiplier of M u <= upper, positive there, negative at lower.
    double multiplier(int i) const {
        return side_[std::size_t(i)] * multiplier_[std::size_t(i)];
    }

    // Let some constraints give way a little, as solvers let equalities.
    void widen(int first, int count, double by) {
        for (int i = first; i < first + count; i++) {
            lower[i] -= by;
            upper[i] += by;
        }
    }

    // At which of its sides an active row is, 1 or -1.
    double side(int i) const { return side_[std::size_t(i)]; }

    // How far all rows go in the shortest step that moves each active one, the i-th, by lacks(i).
    template <class Lacks>
    const double* restore(Lacks lacks) {
        clear(u, blocks_);
        clear(d_, blocks_);
        approach(lacks);
        evaluate();
        return values_;
    }

    // How far the first lanes may be off because a row at its limit, active or not, may be exceeded or
    // pushed by as much as `violation`: much, where those that are active leave next to nothing of it.
    double unsure(int row, int blocks) {
        int held = active;
        for (int i = 0; i < active; i++)
            if (row_[std::size_t(i)] == row) held = i;
        clear(normal_, blocks_);
        for (int a = 0; a < K_; a++) normal_[a] = column(a)[row];
        if (turned_) multiply(d_, Q_, width_, K_, normal_, blocks_);
        else copy(d_, normal_, blocks_);
        copy_from(h_, d_, held, blocks_);
        const double left2 = dot(h_, h_, blocks_);
        if (!(left2 > SAME_ROW * SAME_ROW * dot(normal_, normal_, blocks_))) return 0.0;
        clear(u, blocks_);
        clear(values_, blocks);
        add_rows(u, Q_, width_, K_, h_, blocks_);
        add_rows(values_, M, stride(), K_, u, blocks);
        return violation / left2 * std::sqrt(dot(values_, values_, blocks));
    }

    // For tests of the check.
    void spoil() {
        if (active) multiplier_[0] = 1.5 * multiplier_[0] + 1e-6;
    }

    Status solve(int columns) {
        K_ = columns;
        blocks_ = blocks_of(std::max(columns, 1));
        active = 0;
        turned_ = false;
        clear(u, blocks_);
        clear(values_, row_blocks_);
        for (int s = 0; s < padded(K_); s++)
            s < K_ ? unit(Q_ + s * width_, s, blocks_) : clear(Q_ + s * width_, blocks_);
        for (int change = 0; change < MOST_CHANGES; change++) {
            double side;
            if (change) evaluate();
            const int worst = most_violated(side);
            if (worst < 0) return polish();
            const Status status = bring_in(worst, side, change);
            if (status != Status::Optimal) return status;
        }
        return Status::Iterations;
    }

    // Numbers for the rows, all zero.
    double* zeros() {
        clear(values_, row_blocks_);
        return values_;
    }

    // u: the step to the optimum with the active constraints as they are, from where the rows'
    // gradient, with what these push, is g. Their multipliers take what they have left of it.
    void descend(const double* g) {
        multiply(normal_, M, stride(), K_, g, row_blocks_);
        multiply(d_, Q_, width_, K_, normal_, blocks_);
        solve_triangular();
        for (int i = 0; i < active; i++) multiplier_[std::size_t(i)] += r_[std::size_t(i)];
        copy_from(h_, d_, active, blocks_);
        for (int b = 0; b < blocks_; b++) lanes(h_)[b] = -lanes(h_)[b];
        clear(u, blocks_);
        add_rows(u, Q_, width_, K_, h_, blocks_);
    }

  private:
    double& R(int i, int j) { return R_[std::size_t(i * most_ + j)]; }

    // r = R^-1 d over the active ones.
    void solve_triangular() {
        for (int i = active; i-- > 0;) {
            double rest = d_[i];
            for (int j = i + 1; j < active; j++) rest -= R(i, j) * r_[std::size_t(j)];
            r_[std::size_t(i)] = rest / R(i, i);
        }
    }

    // The constraint that is violated most by values_, or -1.
    int most_violated(double& side) {
        const v4 *lo = lanes(lower), *hi = lanes(upper), *x = lanes(values_);
        v4 most = v4{} + violation;
        for (int b = 0; b < row_blocks_; b++)
            most = larger(most, larger(x[b] - hi[b], lo[b] - x[b]));
        const double worst = largest(most);
        if (!(worst > violation)) return -1;
        for (int i = 0; i < stride(); i++) {
            const bool above = values_[i] - upper[i] >= worst;
            if (!above && !(lower[i] - values_[i] >= worst)) continue;
            for (int a = 0; a < active; a++)
                if (row_[std::size_t(a)] == i) return -1;  // rounding
            side = above ? 1.0 : -1.0;
            return i;
        }
        return -1;
    }

    // M u in values_.
    void evaluate() {
        clear(values_, row_blocks_);
        add_rows(values_, M, stride(), K_, u, row_blocks_);
    }

    double limit(int row, double side) const { return side > 0 ? upper[row] : lower[row]; }

    // Make the constraint hold, by one or more steps; constraints that push no more are dropped.
    Status bring_in(int row, double side, int& change) {
        double pushed = 0.0;  // multiplier of the new one
        for (int a = 0; a < K_; a++) normal_[a] = -side * column(a)[row];
        for (int a = K_; a < blocks_ * LANES; a++) normal_[a] = 0.0;
        const double size2 = dot(normal_, normal_, blocks_);
        for (;; change++) {
            if (change >= MOST_CHANGES) return Status::Iterations;
            if (turned_) multiply(d_, Q_, width_, K_, normal_, blocks_);
            else copy(d_, normal_, blocks_);
            copy_from(h_, d_, active, blocks_);
            const double free2 = dot(h_, h_, blocks_);
            solve_triangular();
            double dual = std::numeric_limits<double>::infinity();
            int leaves = -1;
            for (int i = 0; i < active; i++)
                if (r_[std::size_t(i)] > 0.0) {
                    const double step = multiplier_[std::size_t(i)] / r_[std::size_t(i)];
                    if (step < dual) {
                        dual = step;
                        leaves = i;
                    }
                }
            const bool moves = free2 > IN_THE_SPAN * IN_THE_SPAN * size2;
            double step = dual;
            bool full = false;
            if (moves) {
                const double missing = -side * limit(row, side) - dot(normal_, u, blocks_);
                const double primal = missing / free2;
                if (primal <= dual) {
                    step = primal;
                    full = true;
                }
            }
            if (!(step < std::numeric_limits<double>::infinity())) return contradict(row, side);
            for (int b = 0; moves && b < blocks_; b++) lanes(h_)[b] *= step;
            if (moves && turned_) add_rows(u, Q_, width_, K_, h_, blocks_);
            else if (moves) add(u, h_, 1.0, blocks_);
            for (int i = 0; i < active; i++)
                multiplier_[std::size_t(i)] -= step * r_[std::size_t(i)];
            pushed += step;
            if (full) {
                append(row, side, pushed);
                return Status::Optimal;
            }
            drop(leaves);
        }
    }

    // The active constraints and one that they exclude: sum of multipliers times normals is zero.
    Status contradict(int row, double side) {
        for (int i = 0; i < active; i++) multiplier_[std::size_t(i)] = -r_[std::size_t(i)];
        row_[std::size_t(active)] = row;
        side_[std::size_t(active)] = side;
        multiplier_[std::size_t(active)] = 1.0;
        active++;
        return Status::Infeasible;
    }

    // The new normal, whose coordinates are d_, becomes the last active one.
    void append(int row, double side, double pushed) {
        const int q = active;
        double beta = 0.0;
        const double onto = reflection(d_, q, blocks_, 0.0, h_, beta);
        reflect_columns(Q_, width_, K_, h_, beta, blocks_, normal_);
        turned_ = true;
        for (int i = 0; i < q; i++) R(i, q) = d_[i];
        R(q, q) = onto;
        row_[std::size_t(q)] = row;
        side_[std::size_t(q)] = side;
        multiplier_[std::size_t(q)] = pushed;
        active++;
    }

    // Givens rotations make R triangular again without column `at`.
    void drop(int at) {
        for (int j = at; j + 1 < active; j++) {
            const std::size_t to = std::size_t(j), from = std::size_t(j + 1);
            row_[to] = row_[from];
            side_[to] = side_[from];
            multiplier_[to] = multiplier_[from];
            for (int i = 0; i <= j + 1; i++) R(i, j) = R(i, j + 1);
        }
        active--;
        for (int j = at; j < active; j++) {
            const double a = R(j, j), b = R(j + 1, j), size = std::hypot(a, b);
            if (size == 0.0) continue;
            const double c = a / size, s = b / size;
            for (int k = j; k < active; k++) {
                const double x = R(j, k), y = R(j + 1, k);
                R(j, k) = c * x + s * y;
                R(j + 1, k) = c * y - s * x;
            }
            v4 *p = lanes(Q_ + j * width_), *q = lanes(Q_ + (j + 1) * width_);
            for (int i = 0; i < blocks_; i++) {
                const v4 x = p[i], y = q[i];
                p[i] = x * c + y * s;
                q[i] = y * c - x * s;
            }
        }
    }

    // The same step, added to u; d_ has it along the active rows.
    template <class Lacks>
    void approach(Lacks lacks) {
        for (int i = 0; i < active; i++) {
            double rest = -side(i) * lacks(i);
            for (int j = 0; j < i; j++) rest -= R(j, i) * d_[j];
            d_[i] = rest / R(i, i);
        }
        add_rows(u, Q_, width_, active, d_, blocks_);
    }

    // u and multipliers from the active set itself, without the rounding of the steps to it.
    Status polish() {
        if (!active) return Status::Optimal;
        clear(u, blocks_);
        clear(values_, row_blocks_);
        clear(d_, blocks_);
        for (int i = 0; i < active; i++) multiplier_[std::size_t(i)] = 0.0;
        for (int pass = 0; pass < 2; pass++) {
            if (pass) evaluate();
            approach([this](int i) { return limit(row(i), side(i)) - values_[row(i)]; });
            solve_triangular();
            for (int i = 0; i < active; i++) multiplier_[std::size_t(i)] += r_[std::size_t(i)];
        }
        return Status::Optimal;
    }

    double* Q_;
    std::vector<double> R_;
    double *d_, *h_, *normal_;
    std::vector<double> r_, multiplier_;
    std::vector<int> row_;
    std::vector<double> side_;
    int most_, K_ = 0, blocks_ = 0;
    bool turned_ = false;  // whether Q is another than the identity
};

}  // namespace coopqp
