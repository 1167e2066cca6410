// Damped least squares of a few columns: minimise |A x - b|^2 + d |x|^2 - 2 c'x.
#pragma once
#include <cmath>
#include <vector>

namespace coopqp {

// By Householder reflections of [A; sqrt(d) I], which never squares its condition.
class SmallLeastSquares {
  public:
    SmallLeastSquares(int most_rows, int most_columns)
        : stride_(std::size_t(most_rows + most_columns)),
          A_(std::size_t(most_columns) * stride_), b_(stride_), x_(std::size_t(most_columns)) {}

    void open(int rows, int columns) {
        rows_ = rows;
        columns_ = columns;
    }
    double& A(int row, int column) { return A_[std::size_t(column) * stride_ + std::size_t(row)]; }
    double& b(int row) { return b_[std::size_t(row)]; }
    double x(int column) const { return x_[std::size_t(column)]; }

    // c may be null, for zero.
    void solve(double d, const double* c) {
        const double root = std::sqrt(d);
        const int m = rows_ + columns_;
        for (int k = 0; k < columns_; k++) {
            for (int i = 0; i < columns_; i++) A(rows_ + i, k) = i == k ? root : 0.0;
            b(rows_ + k) = c ? c[k] / root : 0.0;
        }
        for (int k = 0; k < columns_; k++) {
            double* col = &A(0, k);
            const int last = rows_ + k + 1;  // the rows of sqrt(d) below are still zero here
            double size2 = 0.0;
            for (int i = k; i < last && i < m; i++) size2 += col[i] * col[i];
            const double size = std::sqrt(size2), onto = col[k] > 0 ? -size : size;
            col[k] -= onto;
            const double beta = -1.0 / (onto * col[k]);
            for (int j = k + 1; j < columns_; j++) apply(col, beta, k, last, &A(0, j));
            apply(col, beta, k, last, b_.data());
            diagonal(k) = onto;
        }
        for (int k = columns_; k-- > 0;) {
            double rest = b(k);
            for (int j = k + 1; j < columns_; j++) rest -= A(k, j) * x_[std::size_t(j)];
            x_[std::size_t(k)] = rest / diagonal(k);
        }
    }

    // row R^-1, with R the triangular factor: R'R is the curvature.
    void divide(const double* row, double* out) const {
        for (int k = 0; k < columns_; k++) {
            double rest = row[k];
            for (int j = 0; j < k; j++)
                rest -= out[j] * A_[std::size_t(k) * stride_ + std::size_t(j)];
            out[k] = rest / diagonal_[std::size_t(k)];
        }
    }

  private:
    static void apply(const double* h, double beta, int first, int last, double* x) {
        double s = 0.0;
        for (int i = first; i < last; i++) s += h[i] * x[i];
        s *= beta;
        for (int i = first; i < last; i++) x[i] -= s * h[i];
    }
    double& diagonal(int k) {
        if (diagonal_.size() < x_.size()) diagonal_.resize(x_.size());
        return diagonal_[std::size_t(k)];
    }

    std::size_t stride_;
    std::vector<double> A_, b_, x_, diagonal_;
    int rows_ = 0, columns_ = 0;
};

}  // namespace coopqp
