// What a loop for robots does with numbers in every tick, beside the law. Each class is the quick way
// of one in coopqp.online, which does the same in Python, and all that is out of the ordinary.
#pragma once
#include <algorithm>
#include <cmath>
#include <stdexcept>

#include "core/left_singular.hpp"
#include "reading.hpp"

namespace KERNEL_MODULE {

// coopqp.online.arrivals.Readings
class Reading {
  public:
    // q: the last that was accepted, and where the next goes; own: joints of the robot itself.
    Reading(const Written& q, const std::vector<std::size_t>& own, const std::vector<double>& speed,
            double noise)
        : q_(q), next_(q.size()), speed_(speed), own_(own), noise_(noise) {}

    // Whether a reading is accepted, `elapsed` after the last one [s]. Joints that are not measured
    // are where they are commanded to be.
    bool take(const Numbers& given, const Numbers& commanded, double elapsed) {
        const std::size_t n = next_.size();
        if (given.ndim() != 1 || commanded.size() != n) return false;
        if (given.size() == n) {
            std::copy_n(given.data(), n, next_.data());
        } else {
            if (given.size() != own_.size()) return false;
            std::copy_n(commanded.data(), n, next_.data());
            for (std::size_t i = 0; i < own_.size(); i++) next_[own_[i]] = given.data()[i];
        }
        double size = 0.0;
        bool jumped = false;
        const double *q = q_.data(), time = std::max(0.0, elapsed);
        for (std::size_t j = 0; j < n; j++) {
            size += next_[j] * next_[j];
            jumped |= std::fabs(next_[j] - q[j]) - (noise_ + speed_[j] * time) > 0.0;
        }
        if (jumped || !(std::sqrt(size) < coopqp::ENDLESS)) return false;
        std::copy_n(next_.data(), n, q_.data());
        return true;
    }

  private:
    Written q_;
    std::vector<double> next_, speed_;
    std::vector<std::size_t> own_;
    double noise_;
};

// coopqp.online.loop.History
class Ring {
  public:
    explicit Ring(const nb::dict& columns) : columns_(columns) {
        const auto of = [&](const char* name) { return nb::cast<Written>(columns[name]).data(); };
        clock_ = of("clock"), t_ = of("t"), q_ = of("q"), v_ = of("v");
        measured_ = of("measured"), position_ = of("position"), rotation_ = of("rotation");
        apart_ = of("loop_position"), turned_ = of("loop_orientation");
        rows_ = nb::cast<Written>(columns["q"]).shape(0);
        n_ = nb::cast<Written>(columns["q"]).shape(1);
    }

    // Row i, but for whole numbers; setpoint becomes q + v dt.
    void add(std::size_t i, double clock, double t, const Numbers& q, const Numbers& v,
             const Numbers& measured, const Numbers& p_WO, const Numbers& R_WO,
             const Numbers& open, const Written& setpoint, double dt) {
        if (i >= rows_ || q.size() != n_ || v.size() != n_ || measured.size() != n_ ||
            p_WO.size() != 3 || R_WO.size() != 9 || open.size() % 6 || setpoint.size() != n_)
            throw std::invalid_argument("a tick of another loop");
        clock_[i] = clock, t_[i] = t;
        std::copy_n(q.data(), n_, q_ + i * n_);
        std::copy_n(v.data(), n_, v_ + i * n_);
        std::copy_n(measured.data(), n_, measured_ + i * n_);
        std::copy_n(p_WO.data(), 3, position_ + 3 * i);
        std::copy_n(R_WO.data(), 9, rotation_ + 9 * i);
        double apart = 0.0, turned = 0.0;
        for (std::size_t k = 0; k < open.size(); k += 6) {
            apart = std::max(apart, std::sqrt(coopqp::dot3(open.data() + k, open.data() + k)));
            turned = std::max(turned, std::sqrt(coopqp::dot3(open.data() + k + 3, open.data() + k + 3)));
        }
        apart_[i] = apart, turned_[i] = turned;
        for (std::size_t j = 0; j < n_; j++) setpoint.data()[j] = q.data()[j] + v.data()[j] * dt;
    }

  private:
    nb::dict columns_;
    double *clock_, *t_, *q_, *v_, *measured_, *position_, *rotation_, *apart_, *turned_;
    std::size_t rows_, n_;
};

// coopqp.online.following.JointFollowing
class Samples {
  public:
    // c, m: rings of commanded and measured joints `own`, shape (kept, n); arms: of these which
    // belong to an arm; stuck, spans: samples between which they are compared.
    Samples(const Written& c, const Written& m, const std::vector<std::size_t>& own,
            const std::vector<std::vector<std::size_t>>& arms, int stuck,
            const std::vector<int>& spans, int long_one)
        : c_(c), m_(m), own_(own), arms_(arms), spans_(spans), stuck_(stuck), long_(long_one),
          kept_(int(c.shape(0))), n_(c.shape(1)), r_(n_) {
        for (std::size_t j : own_) last_ = std::max(last_, j);
    }

    // A share of sample number k, the first one or a further one.
    void add(int k, bool first, double share, const Numbers& commanded, const Numbers& measured) {
        if (k < 0 || std::min(commanded.size(), measured.size()) <= last_)
            throw std::invalid_argument("joints of another robot");
        double *c = c_.data() + std::size_t(k % kept_) * n_, *m = m_.data() + std::size_t(k % kept_) * n_;
        for (std::size_t i = 0; i < n_; i++) {
            c[i] = (first ? 0.0 : c[i]) + share * commanded.data()[own_[i]];
            m[i] = (first ? 0.0 : m[i]) + share * measured.data()[own_[i]];
        }
    }

    // Whether nothing is to be said of the last of so many samples: the readings of every arm have
    // changed, and the parity vector is below `suspicious` by squares.
    bool quiet(int count, int lag, const Numbers& white, double suspicious) {
        const int last = count - 1;
        count_ = count;
        if (last >= stuck_)
            for (const auto& arm : arms_)
                if (arm.size() > 1 && std::all_of(arm.begin(), arm.end(), [&](std::size_t j) {
                        return of(m_, last)[j] == of(m_, last - stuck_)[j];
                    }))
                    return false;
        if (white.ndim() != 2 || white.shape(0) != n_) return false;
        const std::size_t d = white.shape(1);
        for (std::size_t s = 0; s < spans_.size() - (count % long_ ? 1 : 0); s++) {
            const int first = std::max(0, last - spans_[s]);
            const double *m = of(m_, last), *before = of(m_, first);
            const double *c[4] = {of(c_, first - lag / 2), of(c_, first - (lag + 1) / 2),
                                  of(c_, last - lag / 2), of(c_, last - (lag + 1) / 2)};
            for (std::size_t i = 0; i < n_; i++)
                r_[i] = (m[i] - before[i]) + (0.5 * (c[0][i] + c[1][i]) - 0.5 * (c[2][i] + c[3][i]));
            double size = 0.0;
            for (std::size_t k = 0; k < d; k++) {
                double z = 0.0;
                for (std::size_t i = 0; i < n_; i++) z += r_[i] * white.data()[i * d + k];
                size += z * z;
            }
            if (!(size < suspicious)) return false;
        }
        return true;
    }

    // As coopqp::left_singular, of A (n, m).
    void directions(const Numbers& A, double nothing, const Written& values, const Written& U) const {
        if (A.ndim() != 2 || A.shape(0) != n_ || values.size() != A.shape(1) || U.size() != n_ * n_)
            throw std::invalid_argument("a matrix of another robot");
        coopqp::left_singular(A.data(), int(n_), int(A.shape(1)), nothing, values.data(), U.data());
    }

  private:
    // A sample by its number; the first one before the beginning.
    const double* of(const Written& ring, int at) const {
        return ring.data() + std::size_t(std::max(at, std::max(0, count_ - kept_)) % kept_) * n_;
    }

    Written c_, m_;
    std::vector<std::size_t> own_;
    std::vector<std::vector<std::size_t>> arms_;
    std::vector<int> spans_;
    int stuck_, long_, kept_, count_ = 0;
    std::size_t n_, last_ = 0;
    std::vector<double> r_;
};

}  // namespace KERNEL_MODULE
