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

// Largest errors of position and of orientation of loops that are open by so much.
inline void largest(const Numbers& open, double& apart, double& turned) {
    apart = turned = 0.0;
    const auto take = [](double& most, const double* x) {
        const double size = std::sqrt(coopqp::dot3(x, x));
        if (size > most || std::isnan(size)) most = size;  // no number is larger than NaN
    };
    for (std::size_t k = 0; k + 6 <= open.size(); k += 6) {
        take(apart, open.data() + k);
        take(turned, open.data() + k + 3);
    }
}

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
        largest(open, apart_[i], turned_[i]);
        for (std::size_t j = 0; j < n_; j++) setpoint.data()[j] = q.data()[j] + v.data()[j] * dt;
    }

  private:
    nb::dict columns_;
    double *clock_, *t_, *q_, *v_, *measured_, *position_, *rotation_, *apart_, *turned_;
    std::size_t rows_, n_;
};

// coopqp.online.recording.LiveRecording
class Columns {
  public:
    // table: a row for each number and a column for each tick; part k has sizes[k] rows from first[k] on.
    // open: which part is what the loops are open by; written are its two largest errors.
    Columns(const Written& table, const std::vector<std::size_t>& first,
            const std::vector<std::size_t>& sizes, std::size_t open)
        : table_(table), first_(first), sizes_(sizes), open_(open) {
        bool fits = table.ndim() == 2 && sizes.size() == first.size() && open < sizes.size();
        for (std::size_t k = 0; fits && k < first.size(); k++)
            fits = first[k] <= table.shape(0) && sizes[k] <= table.shape(0) - first[k];
        if (!fits || sizes[open] != 2) throw std::invalid_argument("a part beyond the table");
    }

    // Column i, from a number for all rows of a part or an array, after which rows are zero; whether
    // each part is one of these.
    bool add(std::size_t i, const nb::list& parts) {
        const std::size_t ticks = table_.shape(1);
        if (i >= ticks || parts.size() != first_.size()) return false;
        for (std::size_t k = 0; k < first_.size(); k++) {
            double* to = table_.data() + first_[k] * ticks + i;
            const nb::handle part = parts[k];
            if (PyFloat_Check(part.ptr())) {
                const double value = PyFloat_AsDouble(part.ptr());
                for (std::size_t j = 0; j < sizes_[k]; j++) to[j * ticks] = value;
                continue;
            }
            Numbers from;
            if (!nb::try_cast(part, from)) return false;
            if (k == open_) {
                largest(from, to[0], to[ticks]);
                continue;
            }
            if (from.size() > sizes_[k]) return false;
            for (std::size_t j = 0; j < sizes_[k]; j++)
                to[j * ticks] = j < from.size() ? from.data()[j] : 0.0;
        }
        return true;
    }

  private:
    Written table_;
    std::vector<std::size_t> first_, sizes_;
    std::size_t open_;
};

// coopqp.online.following.JointFollowing
class Samples {
  public:
    // c, m: rings of commanded and measured joints `own`, shape (kept, n); arms: of these which
    // belong to an arm; every: readings in a sample; stuck, spans: samples between which they are
    // compared; compliance: of their servos; h: time between two samples; late, moved: the latest
    // that a joint may follow, in samples, and what it must be commanded to move by for a reading to
    // be asked to change; band: in which it may stay behind.
    Samples(const Written& c, const Written& m, const std::vector<std::size_t>& own,
            const std::vector<std::vector<std::size_t>>& arms, int every, int stuck,
            const std::vector<int>& spans, int long_one, const std::vector<double>& compliance,
            double h, int late, double moved, double band)
        : c_(c), m_(m), own_(own), arms_(arms), spans_(spans), compliance_(compliance), h_(h),
          moved_(moved), band_(band), late_(late), every_(every), stuck_(stuck), long_(long_one),
          kept_(int(c.shape(0))), n_(c.shape(1)), r_(n_), read_(2 * n_) {
        for (std::size_t j : own_) last_ = std::max(last_, j);
    }

    void forget() { readings_ = trusted_until_ = 0; }
    int readings() const { return readings_; }
    bool leapt() const { return leapt_; }

    // Until there are so many samples, all is well whose parity vector by `white` is small.
    void trust(int samples, int lag, const Numbers& white) {
        trusted_until_ = samples, lag_ = lag, white_ = white;
    }

    // Add a reading; whether Python has nothing to look at in it.
    bool add(const Numbers& commanded, const Numbers& measured) {
        if (std::min(commanded.size(), measured.size()) <= last_)
            throw std::invalid_argument("joints of another robot");
        const int k = readings_ / every_;
        const bool first = readings_ % every_ == 0;
        const double share = 1.0 / every_;
        double *c = c_.data() + std::size_t(k % kept_) * n_, *m = m_.data() + std::size_t(k % kept_) * n_;
        leapt_ = false;
        for (std::size_t i = 0; i < n_; i++) {
            const double q = measured.data()[own_[i]];
            if (readings_ == 0) read_[i] = read_[n_ + i] = q;
            leapt_ |= std::fabs(q - 2.0 * read_[i] + read_[n_ + i]) > coopqp::LEAP;
            read_[n_ + i] = read_[i], read_[i] = q;
            c[i] = (first ? 0.0 : c[i]) + share * commanded.data()[own_[i]];
            m[i] = (first ? 0.0 : m[i]) + share * q;
        }
        readings_++;
        const int samples = readings_ / every_;
        return !leapt_ && samples < trusted_until_ && (samples == k || (!stands() && quiet(lag_, white_)));
    }

    // Whether the readings of an arm, or of a joint that was commanded to move, do not change.
    bool stands() {
        const int last = (count_ = readings_ / every_) - 1;
        if (last >= stuck_)
            for (const auto& arm : arms_)
                if (arm.size() > 1 && std::all_of(arm.begin(), arm.end(), [&](std::size_t j) {
                        return of(m_, last)[j] == of(m_, last - stuck_)[j];
                    }))
                    return true;
        for (std::size_t j = 0; j < n_; j++)
            if (still(j, last)) return true;
        return false;
    }

    // Whether the parity vector is small at the last sample.
    bool quiet(int lag, const Numbers& white) {
        const int count = count_ = readings_ / every_, last = count - 1;
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
            if (!(size < coopqp::SUSPICIOUS)) return false;
        }
        return true;
    }

    // Write W (n, d), as JointFollowing._whitening; returns d. J, before (m, all joints): by whose
    // columns internal wrenches pull the joints, now and earlier; load: its sag, of all joints.
    int whiten(int span, int lag, const Numbers& J, const Numbers& before, const Numbers& load, const Written& W) {
        const std::size_t n = n_, m = J.ndim() == 2 ? J.shape(0) : 0, all = load.size();
        if (J.ndim() != 2 || J.shape(1) != all || before.size() != J.size() || all <= last_ || W.size() != n * n)
            throw std::invalid_argument("matrices of another robot");
        count_ = readings_ / every_;
        const int last = count_ - 1, first = std::max(0, last - span), T = last - first + 1;
        const auto told = [&](int t, std::size_t i) {
            return 0.5 * (of(c_, t - lag / 2)[i] + of(c_, t - (lag + 1) / 2)[i]);
        };
        std::vector<double> A(n * m), U(n * n), values(m + 1), variance(n), sag(n), second_differences;
        for (std::size_t i = 0; i < n; i++)
            for (std::size_t k = 0; k < m; k++)
                A[i * m + k] = compliance_[i] * J.data()[k * all + own_[i]];
        coopqp::left_singular(A.data(), int(n), int(m), coopqp::SINGULAR, values.data(), U.data());
        const double nothing = coopqp::SINGULAR * std::max(values[0], 1e-12);
        std::size_t rank = 0;
        while (rank < std::min(n, m) && values[rank] > nothing) rank++;
        for (int t = first; t <= last; t++) {
            std::vector<double> bent(n);
            for (std::size_t i = 0; i < n; i++)
                r_[i] = of(m_, t)[i] - told(t, i) - (of(m_, first)[i] - told(first, i));
            for (std::size_t k = 0; k < rank; k++) {
                double along = 0.0;
                for (std::size_t i = 0; i < n; i++) along += r_[i] * U[i * n + k];
                for (std::size_t i = 0; i < n; i++) bent[i] += along * U[i * n + k];
            }
            for (std::size_t i = 0; i < n; i++) {
                sag[i] += bent[i] * bent[i] / T;
                if (t > first + 1)
                    second_differences.push_back(
                        std::fabs(of(m_, t)[i] - 2.0 * of(m_, t - 1)[i] + of(m_, t - 2)[i]));
            }
        }
        const double noise = std::max(coopqp::READING_NOISE,
                                      coopqp::OF_SECOND_DIFFERENCES * median(second_differences));
        std::vector<double> turns(n), turn(n * m), M = squared(A, m, nothing);
        for (std::size_t i = 0; i < n; i++)
            for (std::size_t k = 0; k < m; k++) {
                const std::size_t at = k * all + own_[i];
                turn[i * m + k] = J.data()[at] - before.data()[at];
            }
        const int from = span > spans_[1] ? first : last;
        for (int t = from; t <= last; t++) {
            const auto x = pull(M, A, m, [&](std::size_t i) { return of(m_, t)[i] - told(t, i); });
            for (std::size_t i = 0; i < n; i++) {
                double otherwise = 0.0;
                for (std::size_t k = 0; k < m; k++) otherwise += turn[i * m + k] * x[k];
                turns[i] += otherwise * otherwise / (last - from + 1);
            }
        }
        const int half = (T - 1) / 2;
        for (std::size_t i = 0; i < n; i++) {
            double speed = 0.0;
            for (int t = first + 1; t <= last; t++) speed += std::fabs(told(t, i) - told(t - 1, i));
            const double second_difference =
                told(first + 2 * half, i) - 2.0 * told(first + half, i) + told(first, i);
            const double terms[] = {noise, band_, coopqp::LAG_NOISE * speed / (h_ * std::max(1, T - 1)),
                                    coopqp::STIFFNESS_NOISE * std::sqrt(sag[i]), load.data()[own_[i]],
                                    coopqp::INERTIA_NOISE * second_difference / (h_ * h_ * std::max(half * half, 1)),
                                    compliance_[i] * std::sqrt(turns[i] / 3.0)};
            for (double term : terms) variance[i] += term * term;
        }
        const std::size_t d = n - rank;
        const double* P = U.data() + rank;  // P[i * n + k]
        std::vector<double> V(d * d);
        for (std::size_t k = 0; k < d; k++)
            for (std::size_t l = 0; l <= k; l++)
                for (std::size_t i = 0; i < n; i++) V[k * d + l] += variance[i] * P[i * n + k] * P[i * n + l];
        factor(V, d);
        for (std::size_t i = 0; i < n; i++) {
            std::copy_n(P + i * n, d, W.data() + i * d);
            forward(V, d, W.data() + i * d);
        }
        return int(d);
    }

  private:
    // Whether no reading of a joint has changed since commands should have moved it.
    bool still(std::size_t j, int last) const {
        int first = last;
        while (first > std::max(0, last + 1 - kept_) && of(m_, first - 1)[j] == of(m_, last)[j]) first--;
        if (last - first < stuck_) return false;
        double way = 0.0;
        for (int t = first; t <= last - late_; t++)
            way = std::max(way, std::fabs(of(c_, t)[j] - of(c_, first)[j]));
        return way > moved_;
    }

    // The Cholesky factor of A'A + least^2, A (n, m).
    std::vector<double> squared(const std::vector<double>& A, std::size_t m, double least) const {
        std::vector<double> M(m * m);
        for (std::size_t k = 0; k < m; k++) {
            for (std::size_t i = 0; i < n_; i++)
                for (std::size_t l = 0; l <= k; l++) M[k * m + l] += A[i * m + k] * A[i * m + l];
            M[k * m + k] += least * least;
        }
        factor(M, m);
        return M;
    }

    // x with M M' x = A'r.
    template <class Residual>
    std::vector<double> pull(const std::vector<double>& M, const std::vector<double>& A,
                             std::size_t m, const Residual& r) const {
        std::vector<double> x(m);
        for (std::size_t i = 0; i < n_; i++) {
            const double off = r(i);
            for (std::size_t k = 0; k < m; k++) x[k] += A[i * m + k] * off;
        }
        forward(M, m, x.data());
        for (std::size_t k = m; k-- > 0; x[k] /= M[k * m + k])
            for (std::size_t l = k + 1; l < m; l++) x[k] -= M[l * m + k] * x[l];
        return x;
    }

    // By Cholesky: the lower triangle of M (n, n) becomes L, and x becomes L^-1 x.
    static void factor(std::vector<double>& M, std::size_t n) {
        for (std::size_t k = 0; k < n; k++) {
            forward(M, k, &M[k * n], n);
            for (std::size_t l = 0; l < k; l++) M[k * n + k] -= M[k * n + l] * M[k * n + l];
            M[k * n + k] = std::sqrt(M[k * n + k]);
        }
    }
    static void forward(const std::vector<double>& L, std::size_t n, double* x, std::size_t width = 0) {
        if (!width) width = n;
        for (std::size_t k = 0; k < n; x[k] /= L[k * width + k], k++)
            for (std::size_t l = 0; l < k; l++) x[k] -= L[k * width + l] * x[l];
    }

    static double median(std::vector<double>& x) {
        if (x.empty()) return 0.0;
        const auto middle = x.begin() + std::ptrdiff_t(x.size() / 2);
        std::nth_element(x.begin(), middle, x.end());
        return x.size() % 2 ? *middle : 0.5 * (*middle + *std::max_element(x.begin(), middle));
    }

    // A sample by its number; the first one before the beginning.
    const double* of(const Written& ring, int at) const {
        return ring.data() + std::size_t(std::max(at, std::max(0, count_ - kept_)) % kept_) * n_;
    }

    Written c_, m_;
    std::vector<std::size_t> own_;
    std::vector<std::vector<std::size_t>> arms_;
    std::vector<int> spans_;
    std::vector<double> compliance_;
    double h_, moved_, band_;
    int late_, every_, stuck_, long_, kept_, count_ = 0;
    int readings_ = 0, trusted_until_ = 0, lag_ = 0;
    bool leapt_ = false;
    Numbers white_;
    std::size_t n_, last_ = 0;
    std::vector<double> r_, read_;  // read_: the last two readings of `own`
};

}  // namespace KERNEL_MODULE
