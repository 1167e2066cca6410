// Damped least squares of a few columns: minimise |A x - b|^2 + d |x|^2 - 2 c'x.
#pragma once
#include <cmath>
#include <vector>

#include "reflections.hpp"

namespace coopqp {

// By Householder reflections of [A; sqrt(d) I], which never squares its condition.
class SmallLeastSquares {
  public:
    SmallLeastSquares(int most_rows, int most_columns, Arena& arena)
        : width_(padded(most_rows + most_columns)),
          A_(arena.take(std::size_t(most_columns + 1 + LANES) * std::size_t(width_))),
          h_(arena.take(std::size_t(width_))), diagonal_(std::size_t(most_columns)),
          x_(std::size_t(most_columns)) {}

    void open(int rows, int columns) {
        rows_ = rows;
        columns_ = columns;
        blocks_ = blocks_of(rows + columns);
        for (int k = 0; k <= columns; k++) clear(column(k), blocks_);
    }
    double& A(int row, int k) { return column(k)[row]; }
    double& b(int row) { return column(columns_)[row]; }
    double x(int k) const { return x_[std::size_t(k)]; }

    // c may be null, for zero.
    void solve(double d, const double* c) {
        const double root = std::sqrt(d);
        for (int k = 0; k < columns_; k++) {
            A(rows_ + k, k) = root;
            if (c) b(rows_ + k) = c[k] / root;
        }
        for (int k = 0; k < columns_; k++) {
            double beta = 0.0;
            diagonal_[std::size_t(k)] =
                reflect_from(column(k), width_, columns_ - k, k, blocks_, 0.0, h_, beta);
        }
        for (int k = 0; k < columns_; k++) x_[std::size_t(k)] = b(k);
        back();
    }

    // The step to the minimum from where half the gradient is g.
    void descend(const double* g) {
        for (int k = 0; k < columns_; k++) {
            double rest = -g[k];
            for (int j = 0; j < k; j++) rest -= R(j, k) * x_[std::size_t(j)];
            x_[std::size_t(k)] = rest / R(k, k);
        }
        back();
    }

    // The triangular factor: R'R is the curvature.
    double R(int j, int k) const {
        return j == k ? diagonal_[std::size_t(k)] : A_[std::size_t(k * width_ + j)];
    }

  private:
    // x becomes R^-1 x.
    void back() {
        for (int k = columns_; k-- > 0;) {
            double rest = x_[std::size_t(k)];
            for (int j = k + 1; j < columns_; j++) rest -= R(k, j) * x_[std::size_t(j)];
            x_[std::size_t(k)] = rest / R(k, k);
        }
    }

    double* column(int k) { return A_ + std::size_t(k) * std::size_t(width_); }

    int width_;
    double *A_, *h_;
    std::vector<double> diagonal_, x_;
    int rows_ = 0, columns_ = 0, blocks_ = 0;
};

}  // namespace coopqp
