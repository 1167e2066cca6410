// Shares of scaled tasks: v = v_0 + sum_k s_k V_k with 0 <= s_k <= 1, each as large as can be.
//
// V_k is the shortest motion that does all of task k and nothing of the other exact ones. In
// orthonormal coordinates the cost is d/2 |x + sum_k s_k x_k|^2 + W/2 sum_k (s_k - 1)^2.
#pragma once
#include <cmath>
#include <vector>

#include "lanes.hpp"
#include "problem.hpp"

namespace coopqp {

class Shares {
  public:
    Shares(int count, int lanes, int width, Arena& arena)
        : count_(count), lanes_(lanes), width_(width),
          ways_(arena.take(std::size_t((count + 1) * lanes))),
          coordinates_(arena.take(std::size_t((count + 1) * width))),
          R_(std::size_t((count + 1) * (count + 1))), s_(std::size_t(count + 1)),
          c_(std::size_t(count + 1)) {}

    int count() const { return count_; }
    double share(int k) const { return s_[std::size_t(k)]; }
    double& share(int k) { return s_[std::size_t(k)]; }
    double* way(int k) { return ways_ + k * lanes_; }              // V_k, over the joints
    double* coordinates(int k) { return coordinates_ + k * width_; }  // x_k

    // The shares that cost least where nothing else binds.
    void choose(const double* x, double d) {
        const int blocks = width_ / LANES;
        for (int i = 0; i < count_; i++) {
            c_[std::size_t(i)] = SCALE_WEIGHT - d * dot(coordinates(i), x, blocks);
            for (int j = i; j < count_; j++)
                R(i, j) = d * dot(coordinates(i), coordinates(j), blocks);
            R(i, i) += SCALE_WEIGHT;
        }
        for (int i = 0; i < count_; i++) {  // R'R, in place
            for (int k = 0; k < i; k++)
                for (int j = i; j < count_; j++) R(i, j) -= R(k, i) * R(k, j);
            const double root = std::sqrt(R(i, i));
            for (int j = i; j < count_; j++) R(i, j) /= root;
        }
        for (int i = 0; i < count_; i++) {
            for (int k = 0; k < i; k++) c_[std::size_t(i)] -= R(k, i) * c_[std::size_t(k)];
            c_[std::size_t(i)] /= R(i, i);
        }
        back(c_.data(), s_.data());
    }

    // Column a of R^-1: how the shares go with a direction in which the cost bends by one.
    void direction(int a, double* out) {
        for (int i = 0; i < count_; i++) c_[std::size_t(i)] = i == a ? 1.0 : 0.0;
        back(c_.data(), out);
    }

  private:
    double& R(int i, int j) { return R_[std::size_t(i * count_ + j)]; }

    void back(const double* c, double* out) {
        for (int i = count_; i-- > 0;) {
            double rest = c[i];
            for (int j = i + 1; j < count_; j++) rest -= R(i, j) * out[j];
            out[i] = rest / R(i, i);
        }
    }

    int count_, lanes_, width_;
    double *ways_, *coordinates_;
    std::vector<double> R_, s_, c_;
};

}  // namespace coopqp
