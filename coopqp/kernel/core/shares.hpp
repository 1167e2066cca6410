// Exact rows: hard ones, and scaled ones up to shares that are as large as can be,
//
//     v = v_0 + sum_k s_k V_k,   0 <= s_k <= 1
//
// V_k is the shortest motion that does all of task k and nothing of the other exact ones. In
// orthonormal coordinates the cost is d/2 |x + sum_k s_k x_k|^2 + W/2 sum_k (s_k - 1)^2. The last share
// may be one that is as small as can be, t of coopqp.qp_law.nearest, W/2 (t + ASIDE)^2.
#pragma once
#include <cmath>
#include <vector>

#include "faults.hpp"
#include "hierarchy.hpp"

namespace coopqp {

constexpr double CONSISTENT = 3e-7;  // by which rows that depend on others may differ [rad/s]
constexpr double REPEATED = 1e-9;  // by which such rows may, that ask the same of shares [rad/s]

class Shares {
  public:
    // Of the first level.
    Shares(const Level& level, Hierarchy& hierarchy, int lanes, Arena& arena)
        : level_(level), hierarchy_(hierarchy), count_(level.shares), exact_(level.exact), lanes_(lanes),
          width_(hierarchy.width()), tall_(width_ + padded(count_)), ways_(arena.take(std::size_t((count_ + 1) * lanes))),
          coordinates_(arena.take(std::size_t((count_ + 1) * width_))),
          columns_(arena.take(std::size_t((count_ + 1) * tall_))),
          R_(std::size_t((count_ + 1) * (count_ + 1))), s_(std::size_t(count_ + 1)),
          firm_(std::size_t(count_ + 1)), kept_(std::size_t(count_ + 1)),
          kept_firm_(std::size_t(count_ + 1)), c_(std::size_t(count_ + 1)), spare_(std::size_t(exact_ * (count_ + 1) + 1)),
          rest_(spare_), taken_(std::size_t(exact_ + 1)) {}

    int count() const { return count_; }
    double share(int k) const { return s_[std::size_t(k)]; }
    double& share(int k) { return s_[std::size_t(k)]; }
    // The multiplier that keeps it at a bound, as the check found it; else 0.
    double firm(int k) const { return firm_[std::size_t(k)]; }
    double& firm(int k) { return firm_[std::size_t(k)]; }
    // Remember the shares, and have them again.
    void keep() { kept_ = s_, kept_firm_ = firm_; }
    void take_back() { s_ = kept_, firm_ = kept_firm_; }
    double* way(int k) { return ways_ + k * lanes_; }              // V_k, over the joints
    double* coordinates(int k) { return coordinates_ + k * width_; }  // x_k

    // Coordinates x that do what hard rows ask for, and of scaled ones the share that is best where
    // no limit binds; residual: what is missing in all rows. Returns how many coordinates that
    // takes: one a row, but for rows that depend on others.
    int take(const Level& level, const double* residual, double* x, double d) {
        int rank = 0;
        while (rank < hierarchy_.decided && hierarchy_.pivot_row(rank) < exact_) rank++;
        const auto wanted = [&level](int s) { return level.wanted[std::size_t(s)]; };
        const auto share_of = [&level](int s) { return level.share[std::size_t(s)]; };
        solve(rank, x, &spare_[0],
              [&](int s) { return residual[s] - (share_of(s) < 0 ? 0.0 : wanted(s)); });
        for (int k = 0; k < count_; k++)
            solve(rank, coordinates(k), &spare_[std::size_t((k + 1) * exact_)],
                  [&](int s) { return level.asks(s, k); });
        if (rank < exact_) leave_repeated();
        choose(x, d);
        if (fault(Fault::WrongShare) && count_) share(0) *= 0.999;
        if (fault(Fault::WrongWay) && count_) coordinates(0)[0] += 1e-3;
        for (int k = 0; k < count_; k++)
            add(x, coordinates(k), s_[std::size_t(k)], hierarchy_.blocks());
        return rank;
    }

    // What a row that depends on others asks of a share, and what it lacks; no others ask.
    double asks(int s, int k) const { return spare_[std::size_t((k + 1) * exact_ + s)]; }
    double lacks(int s) const {
        double lacks = spare_[std::size_t(s)], all = 0.0;
        for (int k = 0; k < count_; k++) {
            lacks += asks(s, k) * share(k);
            all += std::fabs(asks(s, k));
        }
        return level_.aside.empty() && all < CONSISTENT && std::fabs(lacks) < CONSISTENT ? 0.0 : lacks;
    }

  private:
    // Rows that depend on others and ask the same of shares as some of them, but for rounding, ask for
    // nothing: each of two such rows alone leaves a share free, both hold it at 0.
    void leave_repeated() {
        rest_ = spare_;
        std::fill(taken_.begin(), taken_.end(), false);
        for (;;) {
            int most = 0;
            for (int s = 1; s < exact_; s++)
                if (along(s, s) > along(most, most)) most = s;
            const double size2 = along(most, most);
            if (!(size2 > REPEATED * REPEATED)) break;
            taken_[std::size_t(most)] = true;
            for (int s = 0; s < exact_; s++) {
                const double by = taken_[std::size_t(s)] ? 0.0 : along(s, most) / size2;
                for (int k = 0; by != 0.0 && k <= count_; k++) rest(k, s) -= by * rest(k, most);
            }
            for (int k = 0; k <= count_; k++) rest(k, most) = 0.0;
        }
        for (int s = 0; s < exact_; s++) {
            double left = 0.0;
            for (int k = 0; k <= count_; k++) left = std::max(left, std::fabs(rest(k, s)));
            for (int k = 0; !taken_[std::size_t(s)] && left <= REPEATED && k <= count_; k++)
                spare_[std::size_t(k * exact_ + s)] = 0.0;
        }
    }
    double& rest(int k, int s) { return rest_[std::size_t(k * exact_ + s)]; }
    double along(int s, int other) {
        double all = 0.0;
        for (int k = 1; k <= count_; k++) all += rest(k, s) * rest(k, other);
        return all;
    }

    // The shares that cost least where nothing else binds, by Gram-Schmidt of what the cost squares,
    // rows that nearly depend on each other have ways whose squares have no digits of W left.
    void choose(const double* x, double d) {
        const int blocks = tall_ / LANES;
        const double of_way = std::sqrt(d), of_share = std::sqrt(SCALE_WEIGHT);
        for (int k = 0; k <= count_; k++) {
            const bool right = k == count_;  // the right-hand side
            clear(column(k), blocks);
            add(column(k), right ? x : coordinates(k), right ? -of_way : of_way, width_ / LANES);
            for (int i = 0; i < count_; i++)
                column(k)[width_ + i] = of_share * (right ? level_.best_share(i) : double(i == k));
        }
        for (int i = 0; i < count_; i++) {
            R(i, i) = std::sqrt(dot(column(i), column(i), blocks));
            for (int j = i + 1; j <= count_; j++) {
                const double along = dot(column(i), column(j), blocks) / R(i, i);
                (j < count_ ? R(i, j) : c_[std::size_t(i)]) = along;
                add(column(j), column(i), -along / R(i, i), blocks);
            }
        }
        back(c_.data(), s_.data());
    }

  public:
    // Column a of R^-1: how the shares go with a direction in which the cost bends by one.
    void direction(int a, double* out) {
        for (int i = 0; i < count_; i++) c_[std::size_t(i)] = i == a ? 1.0 : 0.0;
        back(c_.data(), out);
    }

  private:
    template <class Side>
    void solve(int rank, double* x, double* spare, Side side) {
        clear(x, hierarchy_.blocks());
        for (int s = 0; s < exact_; s++) spare[s] = side(s);
        for (int k = 0; k < rank; k++) {
            const int own = hierarchy_.pivot_row(k);
            x[k] = spare[own] / hierarchy_.row(own)[k];
            for (int s = 0; s < exact_; s++) spare[s] -= hierarchy_.row(s)[k] * x[k];
            spare[own] = 0.0;
        }
    }

    double* column(int k) { return columns_ + k * tall_; }
    double& R(int i, int j) { return R_[std::size_t(i * count_ + j)]; }

    void back(const double* c, double* out) {
        for (int i = count_; i-- > 0;) {
            double rest = c[i];
            for (int j = i + 1; j < count_; j++) rest -= R(i, j) * out[j];
            out[i] = rest / R(i, i);
        }
    }

    const Level& level_;
    Hierarchy& hierarchy_;
    int count_, exact_, lanes_, width_, tall_;
    double *ways_, *coordinates_, *columns_;
    std::vector<double> R_, s_, firm_, kept_, kept_firm_, c_, spare_, rest_;
    std::vector<char> taken_;
};

}  // namespace coopqp
